"""Plausibility check of readings: implausible ones are set to NaN (not measured), each with a note.

A single heat meter reading that is 10,000 times too large would stay in the forced state for the time constant of the
slowest mode, days, and all plans of that time would overestimate the heat in the building.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Measurement, Record, limits
from thermoforce_mpc.data.names import AXIS
from thermoforce_mpc.data.notes import Note

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.model.thermal_model import ThermalModel

_INFINITE = (-np.inf, np.inf)
_NOT_MEASURED = "taken as not measured"


@dataclass(frozen=True)
class ReadingLimits:
    """Plausible ranges of readings of one building; most are common to all (`thermoforce_mpc.data.limits`).

    `power_W` and `heat_W` are (lowest, highest) in W of any machine and actuator, as measured: heat of a cooling
    machine is negative. `u_min`: the lowest level, below 0 where levels are signed.
    """

    power_W: tuple[float, float] = _INFINITE
    heat_W: tuple[float, float] = _INFINITE
    u_min: float = 0.0

    @classmethod
    def of(cls, model: ThermalModel | None, floor_area_m2: float | None = None, u_min: float = 0.0) -> ReadingLimits:
        """Limits as multiples of the identified machine's largest heat and power.

        Without a heat or power model: 500 W per m² of floor area; without a floor area, no limit.
        """
        most_W = limits.LOAD_W_PER_M2 * (floor_area_m2 or np.inf)
        allowed = cls((-most_W, most_W), (-most_W, most_W), u_min)
        if model is None:
            return allowed
        heads = model.operator.of_actuators
        allowed = replace(allowed, u_min=min(head.heat_input.u_min for head in heads))
        if all(head.heat_input.law is not None for head in heads):
            full_W = [head.sign * head.heat_input.largest_W() for head in heads]
            ends = [share * each for share in limits.LOAD_RANGE for each in full_W]
            allowed = replace(allowed, heat_W=(min(ends), max(ends)))
        if all(power is not None for power in model.power):
            most_W = max(
                float(load(np.ones(2), np.array(load.T_out_range_C)).max())
                for power in model.power
                for load in (power.load, power.cooling)  # type: ignore[union-attr]
                if load is not None
            )
            allowed = replace(allowed, power_W=(limits.POWER_RANGE[0] * most_W, limits.POWER_RANGE[1] * most_W))
        return allowed

    def range(self, name: str) -> tuple[float, float]:
        """Return the lowest and highest value of the signal `name` of a `Record` or `Measurement`, in its unit."""
        of_building = {
            "u": (self.u_min + limits.LEVEL[0], limits.LEVEL[1]),
            "power_W": self.power_W,
            "heat_W": self.heat_W,
        }
        return of_building.get(name, limits.RULES[name].range)


def limits_of(controller: object, floor_area_m2: float | None = None, u_min: float = 0.0) -> ReadingLimits:
    """Return limits by the model of `controller`, else by the floor area, m², and the lowest level `u_min`, see
    `ReadingLimits.of`.
    """
    model = getattr(controller, "model", None)
    if model is None:
        return ReadingLimits.of(None, floor_area_m2, u_min)
    from thermoforce_mpc.model.thermal_model import ThermalModel

    return ReadingLimits.of(model if isinstance(model, ThermalModel) else None, floor_area_m2, u_min)


def screened(measurement: Measurement, allowed: ReadingLimits, history: Record) -> tuple[Measurement, tuple[str, ...]]:
    """Return `measurement` with implausible readings set to NaN, and one note per reading.

    `history`: accepted readings so far, which limit the change of the zone temperature.
    """
    cleaned: dict[str, Any] = {}
    notes: list[str] = []
    names = measurement.names
    for name in limits.RULES:
        reading = getattr(measurement, name)
        readings: list[float] = reading.tolist() if name in AXIS else [float(reading)]
        refused = []
        for row, value in enumerate(readings):
            label = names.label(name, row) if name in AXIS else name
            note = _refusal(measurement, name, row, value, label, allowed, history)
            refused.append(note is not None)
            if note is not None:
                notes.append(note)
            elif limits.RULES[name].always and math.isnan(value):
                notes.append(f"{label} was not measured")
        if any(refused):
            kept = np.where(refused, np.nan, readings)
            cleaned[name] = kept if name in AXIS else float(kept[0])
    return replace(measurement, **cleaned) if cleaned else measurement, tuple(notes)


def _refusal(
    measurement: Measurement, name: str, row: int, value: float, label: str, allowed: ReadingLimits, history: Record
) -> str | None:
    if limits.outside(value, allowed.range(name)):
        return f"{label} of {value:.6g}{_unit(name)} is not {_words(allowed, name)}: {_NOT_MEASURED}"
    rule = limits.RULES[name]
    if math.isnan(value) or math.isinf(rule.jump[0]):
        return None
    values = getattr(history, name)
    before = values[row] if name in AXIS else values
    accepted = np.flatnonzero(np.isfinite(before))
    if not accepted.size:
        return None
    last, since_s = float(before[accepted[-1]]), measurement.time_s - float(history.time_s[accepted[-1]])
    if abs(value - last) <= rule.reach(since_s):
        return None
    return (
        f"{label} of {value:.6g}{_unit(name)} is more than {rule.reach(since_s):.3g} K from {last:.2f}{_unit(name)} "
        f"{since_s:g} s before: {_NOT_MEASURED}"
    )


def screened_history(history: Record, allowed: ReadingLimits) -> tuple[Record, tuple[str, ...]]:
    """Return a record with implausible readings set to NaN, and one note per signal."""
    refused: dict[str, Any] = {}
    notes: list[str] = []
    for name in limits.RULES:
        rows, rule = np.atleast_2d(getattr(history, name)), limits.RULES[name]
        wrong = np.zeros(rows.shape, dtype=bool)
        for row, values in enumerate(rows):
            outside = limits.outside(values, allowed.range(name))
            jumps = frozen = np.zeros(values.size, dtype=bool)
            if values.size == history.time_s.size:
                jumps = limits.jumps(history.time_s, np.where(outside, np.nan, values), rule)
                frozen = _frozen(history.time_s, np.where(outside | jumps, np.nan, values), rule)
            label = history.names.label(name, row) if name in AXIS else name
            for of_rule, what in (
                (outside | jumps, f"is not {_words(allowed, name)}" + (f", or {rule.in_words}" if jumps.any() else "")),
                (frozen, f"does not move for more than {rule.stuck_h:g} h"),
            ):
                if of_rule.any():
                    first = int(np.argmax(of_rule))
                    text = (
                        f"{label} at {of_rule.sum()} of {values.size} places of the record {what} "
                        f"(first {values[first]:.6g}{_unit(name)} at {history.time_s[first]:.10g} s): {_NOT_MEASURED}"
                    )
                    notes.append(Note(text, f"{label} {what}", int(of_rule.sum())))
            wrong[row] = outside | jumps | frozen
        if wrong.any():
            refused[name] = np.where(wrong, np.nan, rows).reshape(np.shape(getattr(history, name)))
    return (replace(history, **refused), tuple(notes)) if refused else (history, ())


def _frozen(time_s: Array, values: Array, rule: limits.SignalRule) -> NDArray[np.bool_]:
    """Which readings (n,) are frozen; none of a point that never moved in the record, since nothing measures it."""
    out, known = np.zeros(values.size, dtype=bool), np.isfinite(values)
    if known.any() and np.ptp(values[known]) > 0.0:
        out[known] = limits.frozen(time_s[known], values[known], rule)
    return out


def implausible_zone(values: Array, time_s: Array, allowed: tuple[float, float]) -> NDArray[np.bool_]:
    """Which temperatures (n,) of one zone are outside the range, °C, or too far from the last one that is not."""
    outside = limits.outside(values, allowed)
    rule = limits.RULES["T_zone_C"]
    return np.asarray(outside | limits.jumps(time_s, np.where(outside, np.nan, values), rule))


def _unit(name: str) -> str:
    unit = limits.RULES[name].unit
    return f" {unit}" if unit else ""


def _words(allowed: ReadingLimits, name: str) -> str:
    low, high = allowed.range(name)
    return f"a number between {low:.4g} and {high:.4g}{_unit(name)}"
