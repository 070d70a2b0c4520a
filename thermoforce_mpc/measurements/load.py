"""From files or a data frame and their map to a record, with what was understood of them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from thermoforce_mpc.commands.command import Command, TemperatureCommand
from thermoforce_mpc.commands.loop import CommandRecord, LearnedCommand, check_told, learn_command, on_one_water
from thermoforce_mpc.commands.tank import CHARGED, LearnedTank, TankRecord, learn_tank
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Layout, Names, Record
from thermoforce_mpc.data.dataframes import clock_s, new_year, seconds_at, seconds_since, stamps
from thermoforce_mpc.data.limits import SignalRule
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.errors import ConfigError, DataError, check_kind, check_path, counted
from thermoforce_mpc.measurements import readings
from thermoforce_mpc.measurements.map.guesses import rooms_beside
from thermoforce_mpc.measurements.map.mapping import (
    LEAST_STEP_S,
    MOST_STEP_S,
    Level,
    MappedActuator,
    MeasurementMap,
    Signal,
    WindowContact,
    load_map,
    signal_of,
)
from thermoforce_mpc.measurements.signals import SignalReader, SignalSummary, Understood, missing, of_changes, of_clock
from thermoforce_mpc.measurements.tables.ahead import without_ahead
from thermoforce_mpc.measurements.tables.appended import away, frame_appended, read_appended
from thermoforce_mpc.measurements.tables.clock import Timed, timed
from thermoforce_mpc.measurements.tables.earlier import Earlier
from thermoforce_mpc.measurements.tables.files import MOST_BYTES, found_files, head_of, read_tables
from thermoforce_mpc.measurements.tables.forms import TableForm
from thermoforce_mpc.measurements.tables.raw_table import RawTable, as_numbers, tables_of
from thermoforce_mpc.scenario.settings import validate

if TYPE_CHECKING:  # pvlib is loaded only where an estimate is needed
    from thermoforce_mpc.boundary.weather.solar import SunPosition

# Full level of metered heat or power: this percentile of the steps in which the machine ran, which are those above a
# share of the same percentile of all in which it took anything. Single peaks (a start, a wrong reading) do not count.
_FULL, _RUNNING = 99.0, 0.05
# Step of a record where the map has none: the usual distance of the rows, within these, s.
_STEPS_S = (900.0, 3600.0)
_LEAST_STEPS = 2
# Rows that are looked at for rooms outside the map.
_ROWS = 2000
# Steps of a tank of hot water, s, and of how many days it is learned: habits of a season.
_TANK_STEPS_S, _TANK_DAYS = (60.0, 900.0), 42.0
# A command that is not logged anew holds for so long, h.
_COMMAND_HOLDS_H = 14 * 24.0
# A single reading so long after the clock has a wrong stamp.
_LATEST = pd.Timedelta("2D")
# A stamp is beside a minute by this share of the usual distance of rows at most; rows are dense from so many steps on
# apart; of rows denser than this the last boundary is a whole multiple of it, s.
_BESIDE, _DENSE, _WHOLE_S = 0.05, 0.5, 300.0


def sunlight(
    rules: MeasurementMap, reader: SignalReader, grid_s: Array, origin: pd.Timestamp
) -> tuple[Array, tuple[str, ...]]:
    """Global horizontal irradiance at `grid_s` (n,), W/m², and what was decided by rule; 0 where there is no sun."""
    if rules.sun is None:
        return np.zeros(grid_s.size), ()
    if rules.sun.signal is not None:
        return reader.irradiance(rules.sun.signal), ()
    from thermoforce_mpc.boundary.weather.solar import sunlight_from_humidity

    clear, sun = clear_sky(rules, grid_s, origin)
    if rules.sun.humidity is None:
        return clear, ("irradiance: that of a clear sky, every day; clouds count as a disturbance",)
    humidity = np.clip(reader.sampled("sun.humidity", rules.sun.humidity, readings.HUMIDITY), 0.0, 1.0)
    note = "irradiance: clear sky times one clearness per day, from the relative humidity; RMSE of a day about 0.16"
    return sunlight_from_humidity(grid_s, humidity, sun), (note,)


def clear_sky(rules: MeasurementMap, time_s: Array, origin: pd.Timestamp) -> tuple[Array, SunPosition]:
    """Clear-sky irradiance (n,), W/m², at the place of the map, and the sun's position."""
    from thermoforce_mpc.boundary.weather.solar import clear_sky_W_m2, sun_position

    site, offset = rules.site, origin.utcoffset()
    assert site is not None  # checked by the map
    assert offset is not None
    sun = sun_position(time_s, site.latitude, site.longitude, offset.total_seconds() / HOUR_S)
    return clear_sky_W_m2(sun), sun


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

    `heat` (A, n), W: of the actuators as mapped; `power` (M, n), W: of the machines.
    """
    notes: list[str] = []
    if not rules.actuators:
        return np.full((1, reader.grid_s.size - 1), np.nan), notes
    machine_of = rules.layout.machine_of
    actuators: Mapping[str, MappedActuator] = rules.actuators
    rows = []
    for a, (name, actuator) in enumerate(actuators.items()):
        if actuator.flow is not None:
            rows.append(_emission(actuator, name, reader, rules, notes))
            continue
        if actuator.level is not None:
            signed = actuator.mode == "both"
            level = reader.mean(
                f"actuators.{name}.level", actuator.level, readings.SIGNED_LEVEL if signed else readings.LEVEL
            )
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
        u_min = -1.0 if actuator.mode == "both" else 0.0
        rows.append(np.clip(level, u_min, 1.0))
        how = "as given" if actuator.full_W else "the 99th percentile of the steps in which it ran"
        less = f" above {actuator.off_W:g} W" if actuator.off_W else ""
        notes.append(
            f"level of {name}: metered {what}{less} over {span:.0f} W ({how}); {cut} steps above that are cut to 1"
        )
    return np.array(rows), notes


def _over_K(actuator: MappedActuator, name: str, reader: SignalReader, rules: MeasurementMap) -> Array | None:
    """What the water of an emitter is above its room (n,), K; None where the map does not name its water."""
    if actuator.flow is None:
        return None
    zone = rules.zones[actuator.zone or next(iter(rules.zones))]
    T_zone_C = reader.sampled(f"zones.{name}.temperature", zone.temperature, readings.ZONE)
    flow_C = reader.mean(f"actuators.{name}.flow", actuator.flow, readings.WATER)
    return np.asarray(np.maximum(flow_C - step_means(T_zone_C), 0.0))


def _emission(
    actuator: MappedActuator, name: str, reader: SignalReader, rules: MeasurementMap, notes: list[str]
) -> Array:
    """Level (n,) of an emitter by its open valve and what its water is above the room."""
    over_K = _over_K(actuator, name, reader, rules)
    assert over_K is not None  # it has a flow
    valve = np.ones(over_K.size)
    if actuator.level is not None:
        valve = np.clip(reader.mean(f"actuators.{name}.level", actuator.level, readings.LEVEL), 0.0, 1.0)
    runs = over_K[(valve > 0.0) & np.isfinite(over_K)]
    full_K = float(np.percentile(runs, 99.0)) if runs.size else 0.0
    if full_K <= 0.0:
        raise DataError(f"actuators.{name}.flow: its water is never above the room: check column and unit")
    notes.append(f"level of {name}: the valve times flow over room temperature, 1 at {full_K:.3g} K (99th percentile)")
    return np.asarray(np.clip(valve * over_K / full_K, 0.0, 1.0))


@dataclass(frozen=True)
class Measurements:
    """Measurements of a building: the record, what acts where, the conditions of the time, and what was understood.

    `conditions`: measured weather with the bounds and prices of the map, NaN where it names none. `left_out`: what was
    left out of a table that a machine appends to, in words. `commands`: what was set, by actuator, of those with a
    command. `windows`: by zone with a contact, 1 where one was open at the boundaries (n + 1,). `tank`: of
    hot water, None where the map has none; the power of its machine in `record` is then that of steps without charging.
    """

    record: Record
    layout: Layout
    conditions: Boundary
    understood: Understood
    map: MeasurementMap
    left_out: tuple[str, ...] = ()
    commands: Mapping[str, CommandRecord] = field(default_factory=dict)
    windows: Mapping[str, Array] = field(default_factory=dict)
    tank: TankRecord | None = None

    def newest_s(self) -> float:
        """Time of the newest temperature of a zone, s; NaN without one."""
        keys = {f"zones.{zone}.temperature" for zone in self.record.names.zones}
        times = [signal.newest_s for signal in self.understood.signals if signal.key in keys]
        return float(np.nanmax(times)) if np.isfinite(times).any() else float("nan")

    def served(self) -> Measurements:
        """The zones that an actuator serves, as `identify` needs them; `DataError` where no level was measured."""
        if not np.isfinite(self.record.u).any():
            raise DataError("no level, heat or power was measured: name an actuator in the map with one of them")
        served = zip(self.layout.names.zones, self.layout.actuators_of_zones, strict=True)
        return self.of_zones([zone for zone, own in served if own])

    def of_zones(self, zones: Sequence[str]) -> Measurements:
        """The zones `zones` with all machines and those actuators that serve one of them (all, where none does)."""
        names, layout, r = self.layout.names, self.layout, self.record
        if unknown := [zone for zone in zones if zone not in names.zones]:
            raise DataError(f"there is no zone '{unknown[0]}'; there are {', '.join(names.zones)}")
        kept = [names.zones.index(zone) for zone in zones]
        if kept == list(range(len(names.zones))):
            return self
        acting = [a for a, home in enumerate(layout.home) if home in kept] or list(range(len(layout.home)))
        fewer = Names(tuple(zones), tuple(names.actuators[a] for a in acting), names.machines)
        ours = Layout(
            fewer,
            tuple(layout.signs[a] for a in acting),
            tuple(kept.index(layout.home[a]) if layout.home[a] in kept else 0 for a in acting),
            tuple(layout.machine_of[a] for a in acting),
            tuple(layout.u_min[a] for a in acting),
            tuple(layout.shares[a] for a in acting),
            tuple(layout.floor_area_m2[z] for z in kept),
        )
        record = replace(r, T_zone_C=r.T_zone_C[kept], u=r.u[acting], heat_W=r.heat_W[acting], names=fewer)
        b = self.conditions
        conditions = replace(
            b, occupancy=b.occupancy[kept], lower_C=b.lower_C[kept], upper_C=b.upper_C[kept], names=fewer
        )
        return replace(self, record=record, layout=ours, conditions=conditions)


def read_measurements(
    files: str | Path | pd.DataFrame | Sequence[str | Path],
    map: str | Path | Mapping[str, Any] | MeasurementMap,
    *,
    step_s: float | None = None,
    at: pd.Timestamp | Literal["begin", "end"] = "begin",
    now: pd.Timestamp | None = None,
    most_bytes: int = MOST_BYTES,
    before: Earlier | None = None,
) -> Measurements:
    """Measurements of a building from CSV or Parquet files, or a data frame, as the map says.

    Args:
        files: a file, a pattern such as 'data/*.csv', several of them, or a data frame.
        map: the map, its keys and values, or its YAML file.
        step_s: step of the record, s; default: that of the map.
        at: where a step begins: at the first reading (with several rows in a step of whole minutes of the hour, on the
            hours of the clock), at the last one, from where a plan goes on, or at this instant.
        now: the time, with a zone, for tables that a machine appends to: lines, cells and stamps that cannot be read
            are left out, rows that come late or twice are put in order, a signal out of range is not measured, and the
            hour that comes twice is told apart; `Measurements.left_out` says it.
        most_bytes: size from which files are refused.
        before: what earlier looks found, at the time `now`: what the tables have no more, or cannot be read of them, is
            as it was then; what this one finds is added.

    Raises:
        ConfigError: the map is wrong, or without a zone for `at`; names the key.
        DataError: the table cannot be used; names file, line or column, and what to do.
    """
    rules, left_out, notes = _rules(map), list[str](), list[str]()
    check_kind(now, (pd.Timestamp, NoneType), "now", "give pd.Timestamp(..., tz=...)")
    columns = [column for _, signal in rules.signals() for column in signal.columns]
    head, decimal = None, rules.csv.decimal
    if isinstance(files, pd.DataFrame):
        head = files.iloc[:_ROWS]
        if now is None:
            tables = tables_of(files, rules.time.column, columns, rules.table, "table", units=rules.units())
    elif now is None:
        paths = found_files(_patterns(files), most_bytes)
        tables = read_tables(paths, columns, rules.written, notes, rules.units())
        first = rules.written(paths[0])
        head = head_of(paths[0], _ROWS, first.csv) if first.table == TableForm() else None
        decimal = first.csv.decimal
    if now is None:
        rows = timed(tables, rules.time)
        rows = replace(rows, notes=(*notes, *rows.notes))
    else:
        tables, rows = _written_until(files, rules, columns, now, most_bytes, before or Earlier(0.0), left_out)
    found = _from_table(tables, rows, rules, step_s, at, refuse=now is None)
    if now is not None:
        left_out += [*rows.notes, *_refused(found, now)]
    beside = dict(rows.beside)
    if head is not None and rules.table.point is None:
        named = head.columns.drop_duplicates(keep=False)
        beside = {str(name): as_numbers(head[name], decimal).to_numpy() for name in named}
    understood = replace(found.understood, beside=rooms_beside(beside, rules))
    return replace(found, understood=understood, left_out=tuple(left_out))


def _written_until(
    files: str | Path | pd.DataFrame | Sequence[str | Path],
    rules: MeasurementMap,
    columns: Sequence[str],
    now: pd.Timestamp,
    most_bytes: int,
    before: Earlier,
    left_out: list[str],
) -> tuple[list[RawTable], Timed]:
    """Tables that a machine appends to, and their rows until `now`; see `read_measurements`."""
    clock, latest, units = rules.time.lenient(), now + _LATEST, rules.units()
    try:
        if not isinstance(files, pd.DataFrame):
            paths = found_files(_patterns(files), most_bytes)
            tables = read_appended(paths, columns, rules.written, latest, left_out, before.columns, units, now)
            if not tables:
                raise DataError(f"{paths[0]}: has none of the columns that were read before")
        elif rules.table == TableForm():
            names = [str(name) for name in files.columns]
            gone = [one for one in dict.fromkeys(columns) if one in before.columns and one not in names]
            left_out += [away(one, names, "table") for one in gone]
            there = [one for one in columns if one not in gone]
            tables = [frame_appended(files, there, clock, latest, left_out, units, now)]
        else:
            tables = tables_of(files, clock.column, columns, rules.table, "table", units=units)
        rows = before.joined(timed(tables, clock, now), list(dict.fromkeys(columns)), now, tables[0].name, left_out)
    except DataError as error:
        if before.last is None:
            raise
        left_out.append(f"{error}: what was read before stands")
        tables, rows = [RawTable("what was read before", pd.Series(dtype=object), {})], before.last
    rooms = [name for zone in rules.zones.values() for name in zone.temperature.columns]
    return tables, without_ahead(rows, rooms, now, left_out, before.ahead)


def _refused(found: Measurements, now: pd.Timestamp) -> list[str]:
    """Which readings of the last day rules refused, in words."""
    since_s = seconds_at(found.record.origin, now, "now") - DAY_S
    return [
        Note(
            f"{signal.key} (column {signal.source}): {counted(flag.count, 'reading')} refused ({flag.rule}), first "
            f"{flag.first}: taken as not measured",
            f"{signal.key}: refused ({flag.rule})",
            flag.count,
        )
        for signal in found.understood.signals
        for flag in signal.flags
        if flag.last_s >= since_s
    ]


def _rules(map: str | Path | Mapping[str, Any] | MeasurementMap) -> MeasurementMap:
    if isinstance(map, MeasurementMap):
        return map
    if isinstance(map, Mapping):
        return validate(MeasurementMap, map, "map")
    check_path(map, "map", "give its file, or its keys and values; `tf-mpc data map FILE` writes one to start from")
    return load_map(Path(map))


def _patterns(files: object) -> list[str | Path]:
    """Paths and patterns that a program gives; raises `DataError` for what is none."""
    instead = "give paths or patterns, or one data frame (of several pd.concat([...]), of a Series .to_frame(name))"
    if isinstance(files, str | os.PathLike):
        return [Path(files)]
    check_kind(files, Iterable, "files", instead)
    several: list[Any] = list(files) if isinstance(files, Iterable) and not isinstance(files, pd.Series) else [files]
    for one in several:
        check_path(one, "files: one of them", instead)
    return several


def _from_table(
    tables: Sequence[RawTable],
    table: Timed,
    rules: MeasurementMap,
    step_s: float | None,
    at: pd.Timestamp | Literal["begin", "end"],
    *,
    refuse: bool,
) -> Measurements:
    names, layout = rules.names, rules.layout
    rows_every_s = table.every_s
    origin, time_s, grid_s, step_s = _grid_of(table, tables[0].name, rules, rows_every_s, step_s, at)
    reader = SignalReader(table, time_s, grid_s, step_s, rules, refuse=refuse)
    zones, actuators, machines = rules.zones.items(), rules.actuators.items(), rules.machines.items()
    T_zone = np.array([reader.sampled(f"zones.{name}.temperature", z.temperature, readings.ZONE) for name, z in zones])
    T_out = reader.sampled("outdoor", rules.outdoor, readings.OUTDOOR)
    solar, of_sun = sunlight(rules, reader, grid_s, origin)
    unknown = np.full((1, grid_s.size - 1), np.nan)  # where there is no machine or actuator
    power = np.array(
        [reader.mean(f"machines.{name}.power", m.power, readings.POWER) for name, m in machines] or unknown
    )
    water = [
        reader.mean(f"machines.{name}.return_water", m.return_water, readings.WATER) for name, m in machines
    ] or unknown
    heat = np.array([reader.mean(f"actuators.{name}.heat", a.heat, readings.POWER) for name, a in actuators] or unknown)
    tank, of_tank = _tank_record(rules, table, time_s, grid_s, rows_every_s, step_s, origin, refuse=refuse)
    # What a machine takes for hot water says nothing of the rooms.
    modes = {f"machines.{name}.hot_water": m.hot_water and _held(m.hot_water) for name, m in machines}
    for_water = np.array([reader.mean(key, mode, readings.LEVEL) for key, mode in modes.items()] or unknown)
    for_water = np.clip(np.nan_to_num(for_water), 0.0, 1.0)
    if tank is not None:
        for_water[names.machines.index(rules.tank_machine)] = tank.share_of(grid_s)
    meter_W, ahead = np.empty(0), rules.forecast
    if rules.meter is not None:
        meter_W = reader.mean("meter", rules.meter, readings.POWER)
    elif for_water.any() and ahead.load is None and ahead.generation is None:
        meter_W = power.sum(axis=0)  # hot water is in peaks so far, though not in the power for rooms
    rooms_W, power = power * (1.0 - for_water), np.where(for_water > CHARGED, np.nan, power)
    u, of_levels = actuator_levels(rules, reader, heat, rooms_W)
    set_by = {name: found for name, _ in actuators if (found := rules.command_of(name)) is not None}
    commands = {
        name: replace(_commanded(reader, where, command), over_K=_over_K(rules.actuators[name], name, reader, rules))
        for name, (where, command) in set_by.items()
    }
    windows = {name: _opened(reader, f"zones.{name}.window", z.window) for name, z in zones if z.window}
    record = Record(
        grid_s, T_zone, T_out, solar, u, power, heat * np.array(layout.signs)[:, None],
        np.array(water), meter_W, origin, names,
    )  # fmt: skip
    none = np.zeros((len(names.machines), grid_s.size))
    conditions = Boundary(
        grid_s,
        T_out,
        solar,
        np.zeros(T_zone.shape),
        *_bounds_C(rules, reader, origin),
        np.array([reader.price(f"machines.{name}.price", m.price) for name, m in machines] or none * np.nan),
        none,
        names=names,
    )
    if refuse:
        _check_bounds(set_by, layout, conditions, tables[0].name)
    zone = "" if table.index.tz is None else str(table.index.tz)
    notes = (
        *table.notes,
        *of_clock(zone, rows_every_s, step_s, by_hour=rules.comfort is not None and rules.comfort.by_hour),
        *of_sun,
        *of_levels,
        *of_changes(reader.on_change),
        *dict.fromkeys(reader.coarse),
    )
    instants = stamps(grid_s, origin)
    understood = Understood(
        tuple(dict.fromkeys(t.name for t in tables)),
        sum(len(t.stamps) for t in tables) if table.own else len(time_s),
        str(instants[0]),
        str(instants[-1]),
        float(grid_s[-1] - grid_s[0]) / DAY_S,
        zone,
        rows_every_s,
        step_s,
        (*reader.summaries, *of_tank),
        notes,
        missing(rules, record, conditions),
    )
    return Measurements(record, layout, conditions, understood, rules, commands=commands, windows=windows, tank=tank)


def _grid_of(
    table: Timed,
    name: str,
    rules: MeasurementMap,
    rows_every_s: float,
    step_s: float | None,
    at: pd.Timestamp | Literal["begin", "end"],
) -> tuple[pd.Timestamp, Array, Array, float]:
    """The origin of a record of a table called `name`, seconds since it of the rows (n,) and of the boundaries of the
    record's steps (N + 1,), and its step, s; `step_s` and `at` as of `read_measurements`, rows `rows_every_s` apart.

    Raises:
        ConfigError: `at` names an instant, and the map no zone.
        DataError: the step is not between 1 min and 1 h, or too few steps are there.
    """
    origin = new_year(table.index, name)
    if isinstance(at, pd.Timestamp) and origin.tz is None:
        raise ConfigError("map: time.zone: name the zone of the time stamps; the clock has one")
    time_s = seconds_since(origin, table.index, name)
    if step_s is None:
        step_s = pd.Timedelta(rules.step).total_seconds() if rules.step else _step_s(rows_every_s)
    if not LEAST_STEP_S <= step_s <= MOST_STEP_S:
        raise DataError(f"step_s: {step_s:g} s; the step of a record lies between 1 min and 1 h")
    if isinstance(at, pd.Timestamp):
        at_s = seconds_at(origin, at, "at")
        grid_s = _grid_s(time_s, rows_every_s, step_s, at_s, until_s=at_s)
    else:
        grid_s = _grid_s(time_s, rows_every_s, step_s, _at_s(time_s, rows_every_s, step_s, at))
    if grid_s.size < _LEAST_STEPS + 1:
        raise DataError(
            f"{name}: {counted(len(time_s), 'row')} from {table.index[0]} to {table.index[-1]} make "
            f"fewer than {_LEAST_STEPS} steps of {step_s:g} s; give more rows, or a shorter step"
        )
    return origin, time_s, grid_s, step_s


def _tank_record(
    rules: MeasurementMap,
    table: Timed,
    time_s: Array,
    grid_s: Array,
    rows_every_s: float,
    step_s: float,
    origin: pd.Timestamp,
    *,
    refuse: bool,
) -> tuple[TankRecord | None, list[SignalSummary]]:
    """The tank of hot water in steps of its own, as a charge is shorter than one of the rooms, and its signals."""
    tank = rules.hot_water
    if tank is None:
        return None, []
    own_s = rows_every_s if np.isfinite(rows_every_s) else _TANK_STEPS_S[0]
    own_s = min(step_s, float(np.clip(round(own_s / 60.0) * 60.0, *_TANK_STEPS_S)))
    at_s = grid_s[0] + own_s * np.arange(round((grid_s[-1] - grid_s[0]) / own_s) + 1)
    reader = SignalReader(table, time_s, at_s, own_s, rules, refuse=refuse)
    machine = rules.machines[rules.tank_machine]
    power_W = reader.mean(f"machines.{rules.tank_machine}.power", machine.power, readings.POWER)
    every_s = reader.summaries[-1].usual_s if machine.power is not None else 0.0
    command = CommandRecord(np.full(at_s.size, np.nan), np.full(at_s.size - 1, np.nan))
    if tank.command is not None:
        command = _commanded(reader, "hot_water", tank.command)
    found = TankRecord(
        time_s=at_s,
        T_C=reader.sampled("hot_water.temperature", tank.temperature, readings.TANK),
        T_out_C=reader.sampled("outdoor", rules.outdoor, readings.OUTDOOR),
        command=command.at,
        power_W=power_W,
        charging=np.clip(reader.mean("hot_water.charging", tank.charging, readings.LEVEL), 0.0, 1.0),
        clock_s=clock_s(at_s, origin),
        usual=command.usual,
        power_every_s=every_s,
    )
    return found, [one for one in reader.summaries if one.key.startswith("hot_water.")]


def learned_tank(measured: Measurements) -> LearnedTank | None:
    """What the measurements tell of the tank, None without one; raises `DataError` where they do not tell it."""
    rules, tank = measured.map.hot_water, measured.tank
    if rules is None or tank is None:
        return None
    where = f"hot_water (column {' + '.join(rules.temperature.columns)})"
    learned = learn_tank(tank.last(_TANK_DAYS), rules.command, measured.map.tank_machine, where)
    return replace(learned, origin=measured.record.origin, comfort=rules.comfort)


def learned_commands(measured: Measurements) -> dict[str, LearnedCommand]:
    """The commands of the actuators with their maps, by name; raises `DataError` where the record does not tell one."""
    record, out = measured.record, {}
    names, together, each = record.names.actuators, dict[str, dict[str, Array]](), dict[str, CommandRecord]()
    commands = {name: measured.map.command_of(name) for name in names if name in measured.commands}
    for a, name in enumerate(names):
        if (found := commands.get(name)) is not None:
            together.setdefault(found[0], {})[name] = record.u[a]
    for u in together.values():
        each |= on_one_water({name: measured.commands[name] for name in u}, u)
    for a, name in enumerate(names):
        if (found := commands.get(name)) is not None:
            (where, command), was = found, each[name]
            kind, _, machine = where.partition(".")
            own, shared = record.names.zones[measured.layout.home[a]], kind == "machines"
            room = command.reference_of(own)
            if room not in record.names.zones:
                raise DataError(f"{where}.command: reference: the room '{room}' is not among those that are looked at")
            T_zone_C = record.T_zone_C[record.names.zones.index(room)]
            where = f"{where}.command (column {command.column})" + (f" for {name}" if shared else "")
            signals = T_zone_C, record.T_out_C, record.u[a], record.time_s
            habits_s = clock_s(record.time_s, record.origin)
            learned = learn_command(command, was, *signals, where, clock_s=habits_s, may_be_untold=True)
            out[name] = replace(learned, origin=record.origin, reference="" if room == own else room)
            if shared:
                out[name] = replace(out[name], machine=machine, record=record, set_to=was.mean)
    check_told(out.values())
    return out


def _held(state: Level) -> Level:
    """A state that holds until the next reading, however long that is."""
    return state.model_copy(update={"hold_h": _COMMAND_HOLDS_H})


def _opened(reader: SignalReader, key: str, contact: WindowContact) -> Array:
    """Above 0.5 where a window was open, by its contact, at the boundaries (n + 1,)."""
    says = reader.scheduled(key, _held(contact), readings.COMMAND)
    return says if contact.open else len(contact.columns) - says


def _rule_of(command: Command) -> SignalRule:
    """The rule of readings of a command: what it cannot be was not set, or is in another unit."""
    if isinstance(command, TemperatureCommand):
        return SignalRule("set temperature", "°C", command.reads, command.possible_C)
    return replace(readings.COMMAND, range=command.reads)


def _commanded(reader: SignalReader, where: str, command: Command) -> CommandRecord:
    """What was set: a command holds until the next reading."""
    signal = signal_of(command, command.column, _COMMAND_HOLDS_H)
    rules = _rule_of(command)
    at = reader.scheduled(f"{where}.command", signal, rules)
    usual = None
    if command.usual is not None:
        own: Signal | float = (
            signal_of(command, command.usual, _COMMAND_HOLDS_H)
            if isinstance(command.usual, str)
            else command.from_told(command.usual)
        )
        usual = reader.scheduled(f"{where}.command.usual", own, rules)
    return CommandRecord(at, reader.again(signal, rules), usual)


def _bounds_C(rules: MeasurementMap, reader: SignalReader, origin: pd.Timestamp) -> tuple[Array, Array]:
    """Lower and upper comfort bounds of the zones (Z, n + 1), °C; NaN where the map has none."""
    if rules.comfort is not None:
        return rules.comfort.bounds_at(pd.DatetimeIndex(stamps(reader.grid_s, origin)), tuple(rules.zones))
    lower, upper = (
        np.array(
            [
                reader.scheduled(f"zones.{name}.{bound}", getattr(zone, bound), readings.BOUND)
                for name, zone in rules.zones.items()
            ]
        )
        for bound in ("lower", "upper")
    )
    return lower, upper


def _check_bounds(set_by: Mapping[str, tuple[str, Command]], layout: Layout, conditions: Boundary, file: str) -> None:
    """Raise `DataError` where limits of a command leave no way to keep bounds at any time."""
    rooms = layout.names.zones
    for a, name in enumerate(layout.names.actuators):
        if name not in set_by:
            continue
        where, command = set_by[name]
        room = command.reference_of(rooms[layout.home[a]])
        z = rooms.index(room)
        lower_C, upper_C = (one[z][np.isfinite(one[z])] for one in (conditions.lower_C, conditions.upper_C))
        try:
            command.check_bounds(
                room,
                float(lower_C.min()) if lower_C.size else -np.inf,
                float(upper_C.max()) if upper_C.size else np.inf,
            )
        except ValueError as error:
            raise DataError(f"{file}: {where}.command.{error}") from error


def _at_s(time_s: Array, rows_every_s: float, step_s: float, at: Literal["begin", "end"]) -> float:
    """Where a step begins, s: at the first or last of the rows at `time_s` (n,), or on the clock where rows are dense.

    A stamp a little beside a whole minute means that minute.
    """
    row_s = float(time_s[0] if at == "begin" else time_s[-1])
    beside_s = _BESIDE * min(rows_every_s, step_s) if np.isfinite(rows_every_s) else 0.0
    minute_s = round(row_s / 60.0) * 60.0
    row_s = minute_s if abs(row_s - minute_s) <= beside_s else row_s
    if at == "begin":
        dense = rows_every_s <= _DENSE * step_s and HOUR_S % step_s == 0.0
        return 0.0 if dense else row_s
    return np.floor(row_s / _WHOLE_S) * _WHOLE_S if rows_every_s < _WHOLE_S else row_s


def _grid_s(time_s: Array, rows_every_s: float, step_s: float, at_s: float, *, until_s: float = -np.inf) -> Array:
    """Boundaries of steps, one of them at `at_s`, within the rows at `time_s` (n,), s.

    They go on to `until_s` where rows end not much earlier: the next row is still to come.
    """
    usual_s = rows_every_s if np.isfinite(rows_every_s) else step_s
    beside_s = _BESIDE * min(usual_s, step_s) + 1e-6 * step_s
    last_s = max(time_s[-1] + beside_s, min(until_s, time_s[-1] + readings.LOOSE * max(usual_s, step_s)))
    first, last = (time_s[0] - beside_s - at_s) / step_s, (last_s - at_s) / step_s
    return np.asarray(at_s + step_s * np.arange(np.ceil(first), np.floor(last) + 1.0))


def _step_s(rows_every_s: float) -> float:
    return float(np.clip(round(rows_every_s / 60.0) * 60.0, *_STEPS_S)) if np.isfinite(rows_every_s) else _STEPS_S[0]
