"""The simple house behind a valve with a P band: what is set is the room's set-point, as in many homes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from simple_house import GAIN_K, POLE, outdoor_C

from thermoforce_mpc.data import HOUR_S

START = pd.Timestamp("2025-01-29", tz="UTC")
DAY_C, NIGHT_C, P_BAND_K = 21.5, 19.0, 1.0
RULES = {
    "time": {"zone": "UTC"},
    "step": "1h",
    "outdoor": "out",
    "sun": "sun",
    "zones": {"zone": {"temperature": "T", "lower": "low", "upper": "high", "floor_area_m2": 100.0}},
    "actuators": {"actuator": {"level": "u", "command": {"kind": "setpoint", "column": "set"}}},
    "machines": {"machine": {"power": "P", "price": "price"}},
}


def own_setpoint_C(at: pd.Timestamp) -> float:
    """What the people set."""
    return DAY_C if 6 <= at.hour < 22 else NIGHT_C


def price(at: pd.Timestamp) -> float:
    """Cheap at night and at noon."""
    return 0.40 if at.hour in (7, 8, 17, 18, 19, 20) else 0.20


class HomeBySetpoint:
    """`Connection` and `Clock`; a minute a row. None written: the people's own set-point."""

    def __init__(self, days: int = 21) -> None:
        self.at, self.T, self.rows, self.told, self.written = START - pd.Timedelta(days=days), 21.0, [], None, []
        self.wait_until(START)

    def now(self) -> pd.Timestamp:
        return self.at

    def wait_until(self, at: pd.Timestamp) -> None:
        origin = pd.Timestamp("2025-01-01", tz="UTC")
        while (left_s := (at - self.at).total_seconds()) > 1e-6:
            part_s = min(300.0, left_s)
            setpoint = own_setpoint_C(self.at) if self.told is None else self.told
            level = float(np.clip((setpoint - self.T) / P_BAND_K + 0.5, 0.0, 1.0))
            out = float(outdoor_C((self.at - origin).total_seconds()))
            row = {"time": self.at, "T": self.T, "out": out, "sun": 0.0, "low": 20.0, "high": 23.0}
            row |= {"price": price(self.at), "P": 4300.0 * level, "u": level, "set": setpoint}
            self.rows.append(row)
            pole = POLE ** (part_s / HOUR_S)
            self.T = pole * self.T + (1 - pole) * (out + GAIN_K / (1 - POLE) * level)
            self.at += pd.Timedelta(seconds=part_s)

    def measurements(self) -> pd.DataFrame:
        last = {"time": self.at, "T": self.T, "out": self.rows[-1]["out"], "sun": 0.0}
        return pd.DataFrame([*self.rows, last])

    def forecast(self) -> pd.DataFrame:
        index = pd.date_range(self.at.floor("1h"), periods=49, freq="1h", name="time")
        out = outdoor_C((index - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds().to_numpy())
        return pd.DataFrame(
            {"out": out, "sun": 0.0, "low": 20.0, "high": 23.0, "price": [price(at) for at in index]}, index=index
        )

    def write(self, levels, seconds) -> None:
        (self.told,) = levels.values()
        self.written.append((self.at, self.told))

    def close(self) -> None:
        """Nothing is open."""
