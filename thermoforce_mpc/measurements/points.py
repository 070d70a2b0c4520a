"""The points that a map names, one by one: what came last, how old it is, and whether it can be what it should."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thermoforce_mpc.commands.command import TemperatureCommand
from thermoforce_mpc.commands.kinds import AnyCommand
from thermoforce_mpc.commands.tank import TANK_NAME, AnyTankCommand
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array
from thermoforce_mpc.data.limits import SignalRule
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.progress import duration, figure
from thermoforce_mpc.measurements import readings
from thermoforce_mpc.measurements.map.mapping import MeasurementMap, Signal, likelier
from thermoforce_mpc.measurements.tables.appended import frame_appended, read_appended
from thermoforce_mpc.measurements.tables.clock import timed
from thermoforce_mpc.measurements.tables.files import MOST_BYTES, found_files
from thermoforce_mpc.measurements.tables.forms import TableForm
from thermoforce_mpc.measurements.tables.raw_table import tables_of
from thermoforce_mpc.measurements.units import COUNTER, PER_STEP, converted

# What is logged for longer than a day after the clock has a wrong stamp (as `measurements.load`).
_LATEST = pd.Timedelta("2D")
# Readings of the last day are kept. One is old after so long, s, and after so many of the usual distances: battery
# sensors report once in an hour at least; what holds until it changes (a set-point, a level, a price) has no age.
_KEPT_S, _OLD_S, _TIMES_USUAL = DAY_S, 2.0 * HOUR_S, 3.0
# Rows without a value for so long, s, and for so many of its usual distances, say that it is not available.
_GONE_S = 600.0
# Names of one or two letters stand in many others.
_LEAST_NAME = 3
_RULES = {
    "outdoor": readings.OUTDOOR, "sun": readings.SOLAR, "humidity": readings.HUMIDITY, "temperature": readings.ZONE,
    "lower": readings.BOUND, "upper": readings.BOUND, "level": readings.LEVEL, "flow": readings.WATER,
    "heat": readings.POWER, "power": readings.POWER, "return_water": readings.WATER, "price": readings.PRICE,
    "command": readings.COMMAND, "usual": readings.COMMAND, "hot_water": readings.LEVEL, "charging": readings.LEVEL,
}  # fmt: skip
_HELD = ("level", "command", "price", "irradiance")


@dataclass(frozen=True, eq=False)
class LivePoint:
    """One column of a map at a time: `key` in the map, and its readings of the last day.

    Attributes:
        key, column: of the map; `zone`: the room that it is of, '' without one.
        unit: of `values`, that of the inside (°C, W, share), kWh of a counter; `declared`: what the map says of the
            column.
        at_s: instants (n,), s before now, below 0; `values` (n,): in `unit`.
        age_s: of the last reading, s; NaN where none came.
        every_s: usual time between two, s.
        problem: why it cannot be used, '' where it can; `doubts`: what is odd about it.
    """

    key: str
    column: str
    zone: str
    unit: str
    declared: str
    at_s: Array
    values: Array
    age_s: float
    every_s: float
    problem: str = ""
    doubts: tuple[str, ...] = field(default=())

    @property
    def counts(self) -> bool:
        """Whether it counts energy."""
        return self.declared.endswith(COUNTER)

    @property
    def last(self) -> float:
        """The last reading, NaN without one."""
        return float(self.values[-1]) if self.values.size else float("nan")

    def mean(self, begin_s: float, end_s: float) -> float:
        """Mean between two instants, s before now, of readings that hold until the next, W of a counter; else NaN."""
        at_s, values = self.at_s, self.values
        if not values.size or at_s[0] > end_s or end_s <= begin_s:
            return float("nan")
        if self.counts:
            rise_kWh = np.diff(np.interp([begin_s, end_s], at_s, values))
            return float(J_PER_KWH * rise_kWh[0] / (end_s - begin_s))
        edges = np.unique(np.clip(np.concatenate([[begin_s], at_s, [end_s]]), max(begin_s, at_s[0]), end_s))
        if edges.size < 2:
            return float(values[np.searchsorted(at_s, end_s, side="right") - 1])
        held = values[np.searchsorted(at_s, edges[:-1], side="right") - 1]
        return float(np.average(held, weights=np.diff(edges)))


def read_points(files: str | Path | pd.DataFrame, rules: MeasurementMap, now: pd.Timestamp) -> tuple[LivePoint, ...]:
    """The points of a map in a table that a machine writes, as they are at `now`; a missing one is said, not refused.

    Raises:
        ConfigError: the stamps have no zone, and the map names none.
        DataError: the table cannot be read at all.
    """
    signals = dict(rules.signals())
    columns = list(dict.fromkeys(column for signal in signals.values() for column in signal.columns))
    notes, clock = list[str](), rules.time.lenient()
    if isinstance(files, pd.DataFrame):
        of_one = rules.table == TableForm()
        known = {str(column) for column in files.columns}
        there = [column for column in columns if not of_one or column in known]
        if of_one:
            tables = [frame_appended(files, there, clock, now + _LATEST, notes, rules.units())] if there else []
        else:
            tables = tables_of(files, clock.column, columns, rules.table, "table", units=rules.units())
    else:
        paths = found_files([files], MOST_BYTES)
        latest = now + _LATEST
        tables = read_appended(paths, columns, rules.written, latest, notes, columns, rules.units(), now)
    rows = timed(tables, clock, now) if tables else None
    if rows is not None and rows.index.tz is None:
        raise ConfigError("time.zone: the time stamps have no zone: name the building's, as Europe/Berlin, in the map")
    out = []
    for key, signal in signals.items():
        readings_of = [
            (rows.at(column), rows.columns[column])
            for column in signal.columns
            if rows is not None and column in rows.columns
        ]
        out.append(_point(key, signal, rules, readings_of, now, notes))
    return tuple(_beside_one_another(out, rules))


def _point(
    key: str,
    signal: Signal,
    rules: MeasurementMap,
    readings_of: Sequence[tuple[pd.DatetimeIndex, Array]],
    now: pd.Timestamp,
    notes: Sequence[str],
) -> LivePoint:
    usual_rule = readings.TANK if key == f"{TANK_NAME}.temperature" else _RULES[key.rpartition(".")[2]]
    rule, declared = readings.with_map(usual_rule, signal), getattr(signal, "unit", "")
    command = _command(key, rules)
    counts = declared.endswith(COUNTER)
    unit = "kWh" if counts else rule.unit
    if command is not None:
        unit = "°C" if isinstance(command, TemperatureCommand) else command.told_in
    base = LivePoint(
        key, " + ".join(signal.columns), _zone_of(key, rules), unit, declared, np.empty(0), np.empty(0), np.nan, np.nan
    )
    if len(readings_of) < len(signal.columns):
        return replace(base, problem="nothing came of it: check the name, and whether its device reports")
    at_s, raw = _summed([((index - now).total_seconds().to_numpy(), values) for index, values in readings_of])
    if not np.isfinite(raw).any():
        of_cells = [note for note in notes if any(f"column '{column}' " in note for column in signal.columns)]
        hint = "check column and unit, and csv.words where it says words"
        return replace(base, problem=": ".join(("never a number", *of_cells[:1])) + f"; {hint}")
    known = np.isfinite(raw)
    gone_s = float(at_s[-1] - at_s[known][-1])  # empty since: not available, or a table whose columns have rows apart
    at_s, raw = at_s[known], raw[known]
    every_s = float(np.median(np.diff(at_s))) if at_s.size > 1 else np.nan
    age_s = abs(min(float(at_s[-1]), 0.0))
    recent = at_s >= min(-_KEPT_S, float(at_s[-1]))
    at_s, raw = at_s[recent], raw[recent] * signal.factor
    values = converted(raw, declared) if declared else np.asarray(raw)
    if counts:
        values = values / J_PER_KWH
    if declared.endswith(PER_STEP):
        values = values / (every_s if every_s > 0.0 else np.nan)
    point = replace(base, at_s=at_s, values=values, age_s=age_s, every_s=every_s)
    if gone_s > max(_GONE_S, _TIMES_USUAL * np.nan_to_num(every_s)):
        return replace(point, problem=f"not available, for {duration(age_s)}")
    problem = _problem(point, rule, raw, command)
    return replace(point, problem=problem, doubts=() if problem else _doubts(point, rule, command))


def _summed(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Instants and values of columns that are added, each holding until its next reading."""
    if len(parts) == 1:
        return parts[0]
    every = np.unique(np.concatenate([at_s for at_s, _ in parts]))
    total = np.zeros(every.size)
    for at_s, values in parts:
        place = np.searchsorted(at_s, every, side="right") - 1
        total += np.where(place >= 0, values[np.maximum(place, 0)], np.nan)
    return every, total


def _problem(point: LivePoint, rule: SignalRule, raw: Array, command: AnyCommand | AnyTankCommand | None) -> str:
    """Why a point that came cannot be used now."""
    if point.age_s > DAY_S:
        return f"the last reading is {duration(point.age_s)} old: does its device report, and the logger run?"
    if command is not None:
        return _problem_of_command(point, command)
    low, high = rule.range
    if point.counts:
        mean_W = point.mean(float(point.at_s[0]), float(point.at_s[-1]))
        if not np.isfinite(mean_W) or max(low, 0.0) <= mean_W <= high:
            return ""
        return f"its rise of a day is a power of {figure(mean_W)} W: check whether it is a counter, and its unit"
    if point.declared.endswith(PER_STEP) or low <= point.last <= high:
        return ""
    unit = likelier(raw[-1:], point.declared, rule.kind, rule.usual)
    hint = f"in {unit} it were usual: unit: '{unit}'" if unit else "check column, unit and factor"
    value = f"{point.last:.4g} {point.unit}".strip()
    return f"{value} is no {rule.kind} from {low:g} to {high:g}; {hint}"


def _problem_of_command(point: LivePoint, command: AnyCommand | AnyTankCommand) -> str:
    (least, most), sent = command.reads, float(command.as_told(point.last))
    if least <= point.last <= most:
        return ""
    if isinstance(command, TemperatureCommand):
        unit = likelier(np.array([sent]), command.unit, "temperature", command.possible_C)
        hint = f"in {unit} it were one: unit: '{unit}'" if unit else "check column and unit"
        return f"{sent:.4g} {command.unit} cannot be {command.name_in_words}; {hint}"
    return f"{sent:.4g} cannot be {command.name_in_words}, from {least:g} to {most:g}: check column and csv.words"


def _doubts(point: LivePoint, rule: SignalRule, command: AnyCommand | AnyTankCommand | None) -> tuple[str, ...]:
    out = []
    old_s = max(_OLD_S, _TIMES_USUAL * np.nan_to_num(point.every_s))
    if rule.kind not in _HELD and point.age_s > old_s:
        out.append(f"the last reading is {duration(point.age_s)} old")
    middle = float(np.median(point.values))
    if rule.kind == "temperature" and not rule.usual[0] <= middle <= rule.usual[1]:
        out.append(f"a median of {middle:.4g} {point.unit} is unusual: check the unit")
    if command is not None and not command.allows(point.last):
        out.append(f"it is {command.in_words(point.last)} now, which its command in the map does not allow")
    return tuple(out)


def _beside_one_another(points: Sequence[LivePoint], rules: MeasurementMap) -> list[LivePoint]:
    """Points with what the others say of them: one column for two things, and columns named as another room."""
    told = {point.key: list(point.doubts) for point in points}
    first: dict[str, str] = {}
    for point in points:
        if not point.key.endswith((".temperature", ".command", ".level")) and point.key != "outdoor":
            continue
        if (other := first.setdefault(point.column, point.key)) != point.key:
            told[point.key].append(f"the same column as {other}: one of the two is wrong")
    for point in points:
        if point.zone and (named := _named_as(point, tuple(rules.zones))):
            told[point.key].append(f"its column is named as room '{named}': are rooms swapped?")
    return [replace(point, doubts=tuple(told[point.key])) for point in points]


def _named_as(point: LivePoint, zones: Sequence[str]) -> str:
    """The other room whose name stands in the column of a point, and not its own; '' for none."""
    column = _letters(point.column)
    has = [zone for zone in zones if len(_letters(zone)) >= _LEAST_NAME and _letters(zone) in column]
    if not has or point.zone in has or any(_letters(point.zone) in _letters(zone) for zone in has):
        return ""
    return max(has, key=len)


def _letters(text: str) -> str:
    return re.sub(r"[\W_]+", "", text.lower())


def _zone_of(key: str, rules: MeasurementMap) -> str:
    kind, _, rest = key.partition(".")
    name = rest.partition(".")[0]
    if kind == "zones":
        return name
    if kind == "actuators":
        own: Mapping[str, Any] = rules.actuators
        return own[name].zone or next(iter(rules.zones))
    return ""


def _command(key: str, rules: MeasurementMap) -> AnyCommand | AnyTankCommand | None:
    """The command whose column a key names, of an actuator, a machine or the tank; None for other keys."""
    at = key.removesuffix(".usual")
    if not at.endswith(".command"):
        return None
    kind, _, name = at.removesuffix(".command").partition(".")
    owner = getattr(rules, kind)
    command: AnyCommand | AnyTankCommand | None = (owner[name] if name else owner).command
    return command
