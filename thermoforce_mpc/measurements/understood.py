"""What was understood of a table of measurements: period, step, signals with gaps and flags, assumptions."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, Boundary, Record
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.tables.readings import Flag

# About three days: a table of three has a step less.
_ABOUT_THREE_DAYS_H = 70.0


@dataclass(frozen=True)
class SignalSummary:
    """One signal: `name` as in the record, map `key`, `source` (columns or estimate) and declared unit.

    `readings`: how many; `usual_s`: usual time between them, s; `measured`: share of the record's values that are
    known; `longest_gap_h`: longest stretch of unknown ones, h; `least`, `median`, `most` in `unit`; `flags`: what the
    rules refused; `doubt`: what looks odd, '' if nothing; `newest_s`: time of the newest reading that holds, s.
    """

    name: str
    key: str
    source: str
    unit: str
    readings: int
    usual_s: float
    measured: float
    longest_gap_h: float
    least: float
    median: float
    most: float
    flags: tuple[Flag, ...] = ()
    doubt: str = ""
    newest_s: float = float("nan")


@dataclass(frozen=True)
class Understood:
    """Report on a table: files and rows read, period, time zone ('' for none), distance of rows and step, signals.

    `assumed`: what was decided by rule, in words. `missing`: what the table does not hold, and what follows. `beside`:
    rooms that it holds and the map does not name.
    """

    files: tuple[str, ...]
    rows: int
    begins: str
    ends: str
    days: float
    zone: str
    rows_every_s: float
    step_s: float
    signals: tuple[SignalSummary, ...]
    assumed: tuple[str, ...]
    missing: tuple[str, ...]
    beside: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values; None for what is not known."""
        content: dict[str, Any] = _finite(asdict(self))
        return content


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def of_clock(zone: str, rows_every_s: float, step_s: float) -> list[str]:
    """What is assumed about clock and step, in words."""
    notes = [] if zone else ["the time stamps have no time zone (time.zone): every day is taken to have 24 h"]
    if rows_every_s > step_s * 1.01:
        notes.append(
            f"rows come every {rows_every_s / 60.0:g} min, the step is {step_s / 60.0:g} min: fast effects are not seen"
        )
    return notes


def missing(rules: MeasurementMap, record: Record, conditions: Boundary) -> tuple[str, ...]:
    """What the table does not hold, and what follows."""
    notes = []
    if not rules.actuators:
        notes.append("no actuator: nothing can be said about the effect of acting")
    if rules.sun is None:
        notes.append("no irradiance (sun): the sun counts as a disturbance; sun.estimate makes one from the clear sky")
    for m, machine in enumerate(record.names.machines):
        if not np.isfinite(record.power_W[m]).any():
            notes.append(f"no power of {machine} (machines.{machine}.power): nothing can be planned for it")
        if not np.isfinite(conditions.price_per_kWh[m]).any():
            notes.append(f"no price of {machine} (machines.{machine}.price): a plan needs one, here or in the forecast")
    for z, zone in enumerate(record.names.zones):
        if not np.isfinite(conditions.lower_C[z]).any() or not np.isfinite(conditions.upper_C[z]).any():
            notes.append(f"no comfort bounds of {zone} (lower, upper): a plan needs them, here or in the forecast")
    hours = record.n_steps * record.step_s / HOUR_S
    if hours < _ABOUT_THREE_DAYS_H:
        notes.append(f"only {hours:.0f} h: a model needs about three days of probing or weeks of operation")
    return tuple(notes)
