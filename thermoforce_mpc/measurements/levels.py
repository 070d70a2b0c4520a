"""Levels of actuators, measured or from metered heat or power."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.mapping import MappedActuator, MeasurementMap
from thermoforce_mpc.measurements.signals import SignalReader

# Full level of metered heat or power: this percentile of the steps in which the machine ran, which are those above a
# share of the same percentile of all in which it took anything. Single peaks (a start, a wrong reading) do not count.
_FULL, _RUNNING = 99.0, 0.05


def full_load_W(power_W: Array) -> float:
    """Robust largest value of `power_W` (n,), W: the 99th percentile of the steps in which it ran; 0 if it never did.

    It ran where it took more than 5 % of the 99th percentile of all steps in which it took anything.
    """
    positive = power_W[np.isfinite(power_W) & (power_W > 0.0)]
    if not positive.size:
        return 0.0
    running = positive[positive > _RUNNING * np.percentile(positive, _FULL, method="lower")]
    return float(np.percentile(running, _FULL, method="lower")) if running.size else 0.0


def actuator_levels(rules: MeasurementMap, reader: SignalReader, heat: Array, power: Array) -> tuple[Array, list[str]]:
    """Levels (A, n) in [0, 1], or [−1, 1] with mode both, and what was decided by rule.

    Args:
        rules: the map.
        reader: reads the columns.
        heat: heat of the actuators as mapped (A, n), W.
        power: power of the machines (M, n), W.
    """
    notes: list[str] = []
    if not rules.actuators:
        return np.full((1, reader.grid_s.size - 1), np.nan), notes
    machine_of = rules.layout.machine_of
    actuators: Mapping[str, MappedActuator] = rules.actuators
    rows = []
    for a, (name, actuator) in enumerate(actuators.items()):
        if actuator.level is not None:
            signed = actuator.mode == "both"
            level = reader.level(f"actuators.{name}.level", actuator.level, signed=signed)
            rows.append(np.clip(level, -1.0 if signed else 0.0, 1.0))
            continue
        what, load = ("heat", heat[a]) if actuator.heat is not None else ("power", power[machine_of[a]])
        used = np.abs(load) if actuator.mode == "both" else load
        full = actuator.full_W or full_load_W(used - actuator.off_W)
        if full <= 0.0:
            raise DataError(
                f"actuators.{name}: its metered {what} is never above {actuator.off_W:g} W: check column and unit, or "
                "give a longer record"
            )
        span = full - actuator.off_W if actuator.full_W else full
        if span <= 0.0:
            raise DataError(f"actuators.{name}: full_W of {full:g} W is not above off_W of {actuator.off_W:g} W")
        level = (used - actuator.off_W) / span * (np.sign(load) if actuator.mode == "both" else 1.0)
        cut = int((level > 1.0).sum())
        lowest = -1.0 if actuator.mode == "both" else 0.0
        rows.append(np.clip(level, lowest, 1.0))
        how = "as given" if actuator.full_W else "the 99th percentile of the steps in which it ran"
        less = f" above {actuator.off_W:g} W" if actuator.off_W else ""
        notes.append(
            f"level of {name}: metered {what}{less} over {span:.0f} W ({how}); {cut} steps above that are cut to 1"
        )
    return np.array(rows), notes
