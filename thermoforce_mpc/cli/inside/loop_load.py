"""What the loop at a real building takes, for `tf-mpc doctor`: some steps of a small house, in a process of its own."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.data import Array

_STEPS, _DAYS, _STEP_S = 5, 14.0, 900.0
_RULES = {
    "time": {"zone": "UTC"},
    "step": "15min",
    "outdoor": "out",
    "zones": {"zone": {"temperature": "T", "lower": 20.0, "upper": 23.0}},
    "actuators": {"actuator": {"level": "u"}},
    "machines": {"machine": {"power": "P", "price": 0.25}},
}


class _House:
    """`Connection` and `Clock`: a table that is there, and time that passes when it is waited for."""

    def __init__(self) -> None:
        self._at = pd.Timestamp("2026-01-12", tz="UTC")
        hours = np.arange(-_DAYS * 24.0, 24.0, 0.25)
        out = _outdoor_C(hours)
        level = np.where((hours % 24.0) < 8.0, 0.8, 0.2)
        index = pd.DatetimeIndex(self._at + pd.to_timedelta(hours, unit="h"), name="time")
        T = 21.0 + 0.8 * np.sin(2.0 * np.pi * (hours - 14.0) / 24.0)
        self._table = pd.DataFrame({"T": T, "out": out, "u": level, "P": 4000.0 * level}, index=index)

    def now(self) -> pd.Timestamp:
        return self._at

    def wait_until(self, at: pd.Timestamp) -> None:
        self._at = max(self._at, at)

    def measurements(self) -> pd.DataFrame:
        return self._table.loc[: self._at]

    def forecast(self) -> pd.DataFrame:
        index = pd.date_range(self._at.floor("1h"), periods=37, freq="1h", name="time")
        hours = np.asarray((index - pd.Timestamp("2026-01-12", tz="UTC")) / pd.Timedelta("1h"))
        return pd.DataFrame({"out": _outdoor_C(hours)}, index=index)

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """Nothing is set."""

    def close(self) -> None:
        """Nothing is open."""


def _outdoor_C(hours: Array) -> Array:
    return np.asarray(2.0 + 4.0 * np.sin(2.0 * np.pi * (hours - 9.0) / 24.0))


def _peak_MB() -> float:
    """Peak memory of this process, MB; what `getrusage` tells counts that of who started it."""
    try:
        told = Path("/proc/self/status").read_text(encoding="ascii")
        return next(float(line.split()[1]) for line in told.splitlines() if line.startswith("VmHWM:")) / 1024.0
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Print peak memory, MB, and CPU time of a step after the first, s, as JSON."""
    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from thermoforce_mpc.live import Decision, LiveBuilding, control
    from thermoforce_mpc.measurements.map.mapping import MeasurementMap
    from thermoforce_mpc.model.machine.load import MachineLoad
    from thermoforce_mpc.model.machine.power import PowerModel
    from thermoforce_mpc.model.operator.parameters import linear_operator
    from thermoforce_mpc.model.thermal_model import ThermalModel

    rules = MeasurementMap.model_validate(_RULES)
    power = PowerModel(MachineLoad((0.0, 0.0, 4000.0, 0.0), (-20.0, 30.0), lowest_level=0.2))
    operator = linear_operator(np.array([0.9975]), np.array([0.075]), step_s=_STEP_S)
    model = ThermalModel.single(operator, power)
    controller = ThermoForceMPC(model, MPCConfig(step_s=_STEP_S))
    at: list[float] = []
    house, decisions = _House(), list[Decision]()

    def told(decision: Decision) -> None:
        at.append(time.process_time())
        decisions.append(decision)

    control(LiveBuilding(house, rules, _STEP_S), controller, clock=house, steps=_STEPS, told=told)
    planned = sum(bool(decision.plan.u.size) for decision in decisions)
    json.dump({"MB": _peak_MB(), "step_s": (at[-1] - at[0]) / (len(at) - 1), "planned": planned}, sys.stdout)


if __name__ == "__main__":
    main()
