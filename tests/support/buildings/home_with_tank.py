"""The simple house whose heat pump heats a tank of hot water too, in the place of the room."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from home_by_setpoint import RULES, START, HomeBySetpoint, own_setpoint_C, price
from simple_house import GAIN_K, POLE, outdoor_C

from thermoforce_mpc.data import HOUR_S

BAND_K, TARGET_C, RISE_K_H, POWER_W = 6.0, 50.0, 18.0, 1500.0
DRAWN_K = {7: 7.0, 12: 1.5, 18: 3.0, 21: 6.0}
TANK = {
    "temperature": "tank",
    "comfort": "6:00-9:00 42-58, 17:00-22:00 40-58, else 36-58",
    "command": {"kind": "tank_target", "column": "target", "maximum": 56},
}
MAP = RULES | {"actuators": {"actuator": {"level": "u"}}, "hot_water": TANK}


class HomeWithTank(HomeBySetpoint):
    """Told a level of the room and a target of the tank; None: thermostat, and the device's own target."""

    def __init__(self, days: int = 21) -> None:
        rng = np.random.default_rng(5)
        self.drawn = rng.gamma(8.0, 1.0 / 8.0, (days + 60, 24))
        self.tank_C, self.charges, self.tank_told, self.begin = 47.0, False, None, START - pd.Timedelta(days=days)
        super().__init__(days)

    def wait_until(self, at: pd.Timestamp) -> None:
        origin = pd.Timestamp("2025-01-01", tz="UTC")
        while (left_s := (at - self.at).total_seconds()) > 1e-6:
            part_s = min(300.0, left_s)
            own = float(np.clip(own_setpoint_C(self.at) - self.T + 0.5, 0.0, 1.0))
            target = TARGET_C if self.tank_told is None else self.tank_told
            self.charges = (self.charges and self.tank_C < target) or self.tank_C < target - BAND_K
            level = 0.0 if self.charges else own if self.told is None else self.told
            out = float(outdoor_C((self.at - origin).total_seconds()))
            row = {"time": self.at, "T": self.T, "out": out, "sun": 0.0, "low": 20.0, "high": 23.0}
            row |= {"price": price(self.at), "P": POWER_W if self.charges else 4300.0 * level, "u": level}
            self.rows.append(row | {"tank": self.tank_C, "target": target})
            pole = POLE ** (part_s / HOUR_S)
            self.T = pole * self.T + (1 - pole) * (out + GAIN_K / (1 - POLE) * level)
            drawn = DRAWN_K.get(self.at.hour, 0.0) * self.drawn[(self.at - self.begin).days, self.at.hour]
            rise = RISE_K_H if self.charges else 0.0
            self.tank_C += part_s / HOUR_S * (rise - drawn - 0.008 * (self.tank_C - 18.0))
            self.at += pd.Timedelta(seconds=part_s)

    def measurements(self) -> pd.DataFrame:
        """See `Connection`."""
        rows = super().measurements()
        rows.loc[rows.index[-1], ["tank", "target"]] = [self.tank_C, self.rows[-1]["target"]]
        return rows

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection`."""
        self.told, self.tank_told = levels["actuator"], levels.get("hot_water")
        self.written.append((self.at, dict(levels)))
