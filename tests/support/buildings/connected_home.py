"""The house of `home_by_setpoint` behind a connection, in step with its clock: its sensors, its thermostat, its faults.

What is set holds until it says; then the people's own set-point is back, as with a gateway that looks after it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from home_by_setpoint import RULES, START, HomeBySetpoint

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

HOUR = pd.Timedelta("1h")
SENSORS = ("T", "out", "P", "u", "set")


class TimedHome(HomeBySetpoint):
    """The house with a thermostat that goes back by itself when what was set has ended."""

    def __init__(self, days: int = 14) -> None:
        self.ends, self.on_row, self.deaf = None, lambda row: None, False
        super().__init__(days)

    def wait_until(self, at: pd.Timestamp) -> None:
        while self.at < at:
            if self.ends is not None and self.at >= self.ends:
                self.told, self.ends = None, None
            count = len(self.rows)
            super().wait_until(min(at, self.at + pd.Timedelta("5min")))
            for row in self.rows[count:]:
                self.on_row(row)

    def set_by(self, value: float | None, ends: pd.Timestamp | None) -> None:
        """What the thermostat was told, in this order of events."""
        self.told, self.ends = value, ends
        self.written.append((self.at, value))

    def write(self, levels, seconds) -> None:
        (value,) = levels.values()
        self.set_by(value, None if value is None else self.at + pd.Timedelta(seconds=seconds))

    def scores(self) -> tuple[float, float]:
        """Cost, and discomfort in K·h below 20 °C by more than 0.5 K or above 23 °C, since the start."""
        rows = [row for row in self.rows if row["time"] >= START]
        cost = sum(row["P"] * row["price"] for row in rows) / 12.0 / 1000.0
        return cost, sum(max(19.5 - row["T"], row["T"] - 23.5, 0.0) for row in rows) / 12.0


def rules_of(columns: dict[str, str], **more) -> dict:
    """The map of the house, with names of columns as the connection has them."""
    weather = {"lower": 20.0, "upper": 23.0, "floor_area_m2": 100.0}
    command = RULES["actuators"]["actuator"]["command"] | {"column": columns["set"], "minimum": 16.0, "maximum": 26.0}
    return {
        "time": {"zone": "UTC"}, "step": "1h", "outdoor": columns["out"],
        "zones": {"zone": {"temperature": columns["T"], **weather}},
        "actuators": {"actuator": {"level": columns["u"], "command": command}},
        "machines": {"machine": {"power": columns["P"], "price": 0.25}},
        "forecast": {"outdoor": "out", "price": "price"},
    } | more  # fmt: skip


def controlled(home: TimedHome, connection, rules: dict, steps: int, people=None, **settings) -> list:
    """Decisions of `steps` hours by `connection`, with the commands learned of what the house was before."""
    from simple_house import simple_model

    off = {"enabled": False}
    base = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    columns = {"T": "T", "out": "out", "P": "P", "u": "u", "set": "set"}
    measured = read_measurements(pd.DataFrame(home.rows), rules_of(columns), step_s=3600.0).served()
    controller = ThermoForceMPC(simple_model(), MPCConfig.model_validate(base), commands=learned_commands(measured))
    decisions: list = []
    building = LiveBuilding(connection, MeasurementMap.model_validate(rules), 3600.0, people=people)
    control(building, controller, clock=home, steps=steps, delay_s=0.0, told=decisions.append, **settings)
    return decisions


def in_process(steps: int) -> tuple[TimedHome, list]:
    """The same without anything between controller and house."""
    home = TimedHome()
    return home, controlled(home, home, rules_of({name: name for name in SENSORS}), steps)


def check_commands(home: TimedHome) -> None:
    """Nothing out of range, not finite, or between two steps of its resolution; and given back at the end."""
    values = [value for _, value in home.written if value is not None]
    assert values
    assert all(np.isfinite(value) and 16.0 <= value <= 26.0 for value in values)
    assert all(abs(value * 2.0 - round(value * 2.0)) < 1e-6 for value in values)
    assert home.told is None


def same_as(home: TimedHome, other: TimedHome) -> tuple[float, float]:
    """How much dearer than another run, as a share, and how much more discomfort, K·h."""
    (cost, discomfort), (usual, less) = home.scores(), other.scores()
    return cost / usual - 1.0, discomfort - less


def at_hours(events: dict[float, Callable[[], None]]) -> Callable[[dict], None]:
    """A function of rows that calls each event once, when its hour since the start has come."""
    left = dict(sorted(events.items()))

    def happen(row: dict) -> None:
        while left and (row["time"] - START) / HOUR >= next(iter(left)):
            left.pop(next(iter(left)))()

    return happen
