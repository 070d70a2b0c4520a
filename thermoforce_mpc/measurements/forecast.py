"""A forecast of weather, prices and comfort bounds from a file, by the map of the measurements it goes on from.

Prices may have a file of their own: stamps of a calendar, or seconds of a year as in simulations.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.boundary.tariffs import Tariff, by_name, tariff_from_file
from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Array, Boundary, Record, steps_in
from thermoforce_mpc.data.clock import in_celsius, in_fahrenheit
from thermoforce_mpc.data.dataframes import clock_s, days_before_s, new_year, seconds_since, stamps
from thermoforce_mpc.data.limits import BRIDGED_GAP_H
from thermoforce_mpc.data.notes import Note, matter_of
from thermoforce_mpc.data.prices import currency_of, price_doubt, price_unit_of
from thermoforce_mpc.data.series import at_instants
from thermoforce_mpc.errors import ConfigError, DataError, InputError, check_kind
from thermoforce_mpc.measurements.load import Measurements, sunlight
from thermoforce_mpc.measurements.map.mapping import (
    MappedMachine,
    MeasurementMap,
    Power,
    Price,
    Signal,
    Temperature,
    units_of,
)
from thermoforce_mpc.measurements.readings import (
    BOUND,
    OUTDOOR,
    POWER,
    SignalReadings,
    durations_s,
    ends_s,
    held,
    held_means,
    longest_s,
)
from thermoforce_mpc.measurements.signals import SignalReader
from thermoforce_mpc.measurements.tables.appended import frame_appended, read_appended
from thermoforce_mpc.measurements.tables.clock import Timed, timed
from thermoforce_mpc.measurements.tables.files import found_files, head_of, read_tables
from thermoforce_mpc.measurements.tables.forms import TableForm, TimeStampRules, Written, each_column
from thermoforce_mpc.measurements.tables.raw_table import NoColumn, as_numbers, tables_of, with_offset
from thermoforce_mpc.measurements.tables.recognition import Recognised, counted_clock, guessed_form, recognised
from thermoforce_mpc.measurements.units import converted
from thermoforce_mpc.scenario.bill import SUFFIXES, Bill, file_beside, read_bill
from thermoforce_mpc.scenario.building import PRICES

# What a column of prices is called.
_PRICE = re.compile(r"price|preis|prix|prijs|tarif|spot|epex|nordpool|day.?ahead", re.IGNORECASE)
_HEAD = 50
_SHARE = 0.5
# A forecast is no sensor: weather that stays is not stuck.
_OUTDOOR_AHEAD = replace(OUTDOOR, stuck_h=0.0)
# Medians of a while and of the next: weather does not move by the first, K; in another unit it goes on within the
# second. By judgement: °F taken for °C is off by 15 K from -21 °C on. A day may be so much warmer than the one before
# (fronts of continents), and its first hours may (foehn); that both are, and fit in °F, is no weather.
_WHILES_S, _OTHER_WEATHER_K, _GOES_ON_K = (3.0 * HOUR_S, DAY_S), 15.0, 8.0


def prices_over_steps(
    path: Path,
    clock: TimeStampRules,
    origin: pd.Timestamp,
    grid_s: Array,
    step_s: float,
    currency: str = "",
    now: pd.Timestamp | None = None,
) -> tuple[Array, str]:
    """Prices per kWh (n,) over the steps that begin at `grid_s` (n,), s from `origin`, and what was read, in words.

    `currency`: of the prices, by default the one that their column names.
    Stamps without an offset are of the zone that the file tells, as in "Time (UTC)", else of `clock`, which the words
    then say; NaN where the file has no price. The name of a tariff of the simulated buildings, where no file has it,
    is that tariff by the building's clock. With the time `now` a file that a machine writes is read: rows of an hour
    that the clock skips, or of which it does not tell which of two it is, are left out, and the words say so.

    Raises `DataError` for a file whose column of prices or unit is not clear.
    """
    if path.name in PRICES and not path.exists():
        words = "of the simulated buildings, per kWh" + (", synthetic" if path.name == "highly_dynamic" else "")
        by_clock_s = clock_s(grid_s, origin)
        return _of_year(by_name()[path.name], str(path), origin, grid_s, by_clock_s), f"tariff {path.name} {words}"
    form = guessed_form(path)
    head = head_of(path, _HEAD, form)
    names = [str(name) for name in head.columns]
    if len(names) < 2:
        raise DataError(f"{path}: has one column; expected a time and a price per kWh")
    if pd.api.types.is_numeric_dtype(head.iloc[:, 0]) and counted_clock(head.iloc[:, 0])[0].unit is None:
        return _of_year(tariff_from_file(path), str(path), origin, grid_s), f"{path}: prices of a year, which repeats"
    numeric = [name for name in names[1:] if as_numbers(head[name], form.decimal).notna().any()]
    named = [name for name in numeric if _PRICE.search(name)] or numeric
    if len(named) != 1:
        raise DataError(
            f"{path}: which column is the price? there are {', '.join(names[1:])}; keep one, or call one 'price'"
        )
    stamped = recognised([path]).clock
    told = stamped.zone
    own = {"zone": told or clock.zone, "order": "sort", "duplicates": "last"}
    stamped = stamped.model_copy(update=own)
    stamped = stamped if now is None else stamped.lenient()
    unit = price_unit_of(named[0]) or "per kWh"
    tables = read_tables([path], named, lambda _: Written(time=stamped, csv=form), [], {named[0]: unit})
    rows = timed(tables, stamped, now)
    taken = "".join(f"; {note}" for note in rows.notes)
    if told is None and clock.zone is not None and not with_offset(tables[0].stamps.astype(str).iloc[:1]).any():
        # Exchanges write the clock of their market, often without a word.
        taken += (
            f"; its stamps name no zone: taken in {clock.zone}, as the map says; call them 'time (CET)' for another"
        )
    values = converted(rows.columns[named[0]], unit)
    known = np.isfinite(values)
    if doubt := price_doubt(values[known], currency or currency_of(named[0])):
        raise DataError(
            f"{path}, column '{named[0]}': {doubt} Say the unit in its name, as 'price per MWh', 'ct/kWh' or 'JPY/kWh'"
        )
    time_s = seconds_since(origin, rows.index[known], str(path))
    ends = ends_s(time_s, longest_s(time_s, step_s, None), np.empty(0))
    readings = SignalReadings(time_s, values[known], ends)
    if time_s.size:
        price = held_means(readings, durations_s(readings, "start"), grid_s, step_s, _SHARE)
    else:
        price = held(readings, grid_s)
    read = f"{path}: column {named[0]}, {unit}"
    return price, Note(f"{read}{taken}", "; ".join([read, *map(matter_of, rows.notes)]))


# Fees of a bill change at quarters of an hour.
_QUARTER_S = 900.0


def billed_over_steps(
    path: Path,
    bill: Bill,
    price: Array,
    clock: TimeStampRules,
    origin: pd.Timestamp,
    grid_s: Array,
    step_s: float,
    now: pd.Timestamp | None = None,
) -> tuple[Array, Array, str]:
    """What a kWh costs by the `bill` at `path` (M, n) and what it earns (n,), and what was read, in words.

    `price` (M, n): those of the map, which count where the bill names no energy. See `prices_over_steps`.
    """
    words = [f"{path}: {bill.source}"]

    def of(source: float | str) -> Array:
        if not isinstance(source, str):
            return np.full(grid_s.size, source)
        found, read = prices_over_steps(file_beside(path, source), clock, origin, grid_s, step_s, bill.currency, now)
        words.append(read)
        return found

    energy = price if bill.energy is None else np.tile(of(bill.energy), (len(price), 1))
    earns = np.zeros(grid_s.size) if bill.export_per_kWh is None else of(bill.export_per_kWh)
    earns = bill.earns(earns, energy.min(axis=0))
    billed_at = np.stack([billed(bill, row, grid_s, origin, step_s) for row in energy])
    if doubt := price_doubt(billed_at, bill.currency):
        raise DataError(f"{path}: with fees and tax {doubt}" + ("" if bill.currency else " Then name its currency"))
    if str(origin.tz) == "UTC" and (bill.grid.windows or bill.dimming):
        words.append("its hours are of UTC (time.zone of the map), not of the building's clock")
    return billed_at, earns, Note("; ".join(words), "; ".join(map(matter_of, words)))


def billed(bill: Bill, energy: Array, time_s: Array, origin: pd.Timestamp, step_s: float) -> Array:
    """What a kWh costs (n,) in the mean of steps that begin at `time_s` (n,), with `energy` (n,) per kWh."""
    parts = np.arange(steps_in(step_s, _QUARTER_S)) * _QUARTER_S
    each = [bill.at(energy, pd.DatetimeIndex(stamps(time_s + part, origin))) for part in parts]
    return np.asarray(np.mean(each, axis=0))


def _of_year(tariff: Tariff, name: str, origin: pd.Timestamp, grid_s: Array, by_clock_s: Array | None = None) -> Array:
    """Prices by seconds since 1 January, at the same time of the year; its 366th day is the first again.

    `by_clock_s` (n,): what a clock on the wall shows at `grid_s`, where the tariff goes by that.
    """
    at = pd.DatetimeIndex(stamps(grid_s, origin))
    begins = {year: new_year(at[at.year == year], name) for year in dict.fromkeys(at.year)}
    of_year_s = np.array([(one - begins[one.year]).total_seconds() for one in at])
    if by_clock_s is not None:
        of_year_s += by_clock_s - grid_s
    try:
        return np.asarray(tariff(np.mod(of_year_s, YEAR_S)))
    except ConfigError:  # it ends within: what it has
        out = np.full(grid_s.size, np.nan)
        for k, one_s in enumerate(np.mod(of_year_s, YEAR_S)):
            try:
                out[k] = float(tariff(np.array([one_s]))[0])
            except ConfigError:
                continue
        if np.isnan(out).all():
            raise
        return out


# Days before now whose hours tell what a price or bound is likely to be.
_DAYS = 7
# A single row of a forecast so far ahead has a wrong stamp.
_LATEST = pd.Timedelta("60D")


def read_forecast(
    file: str | Path | pd.DataFrame | None,
    measured: Measurements,
    *,
    least_steps: int = 0,
    prices: Path | None = None,
    now: pd.Timestamp | None = None,
    left_out: list[str] | None = None,
    before: ReadBefore | None = None,
) -> Boundary:
    """The conditions from the end of `measured` to that of the forecast, at the step of the record.

    Temperatures and irradiance go straight between two rows, bounds hold until the next one, prices are means over a
    step. Columns are those of the map's key `forecast`, where it has one, else of the same keys as for measurements;
    numbers in the map hold throughout. Each column ends where it ends, at `least_steps` at least: a price is then the
    mean of the same hour of the last days that are known, here or in `measured` by the same tariff, a bound that of the
    week or day before (`Boundary.guessed`); weather is NaN (`model.forecast_gaps` bridges it), and what has no such
    hour.

    `prices`: a file of them for all machines (`prices_over_steps`), or of a bill (`scenario.bill`), in the place of
    those of the map; `left_out` says how it was read.

    With the time `now` a file that a machine writes is read: what cannot be read is left out and said in `left_out`,
    as by `read_measurements`. Without a `file` nothing is known (NaN) but what the map and `prices` say. Once
    there was a forecast `before`, a file of prices that cannot be read is said in `left_out`, and prices are NaN; a
    bill is the one that was read last.

    Raises `DataError`, naming file, column and time, for several files, a forecast that begins more than 6 h after the
    end of the record or ends before it, outdoor temperatures that go on from the record in another unit only, and a
    column without any value.
    """
    check_kind(measured, Measurements, "measured", "read_measurements(...).served() gives them")
    notes = [] if left_out is None else left_out
    before = ReadBefore() if before is None else before
    prices_may_lack = before.any
    sources = _Sources.of(measured, prices, before, notes)
    rows, name = _no_rows(sources, measured.record, least_steps) if file is None else _rows(file, sources, now, notes)
    time_s = seconds_since(measured.record.origin, rows.index, name)
    grid_s, back = _grid(rows, time_s, name, measured, least_steps)
    reader = SignalReader(rows, time_s, grid_s, measured.record.step_s, sources.ours, refuse=now is None)
    outdoor = reader.sampled("outdoor", sources.ours.outdoor, _OUTDOOR_AHEAD)
    if doubt := _unit_doubt(outdoor[back:], sources.ours.outdoor, measured.record):
        if now is None:
            raise DataError(f"{name}, {doubt}")
        notes.append(f"{name}, {doubt}")
    solar, _ = sunlight(sources.ours, reader, grid_s, measured.record.origin)
    lower, upper = _bounds(sources, reader, grid_s, measured)
    of_prices = (sources, reader, grid_s, measured, prices, notes, now)
    price, past_price, at_meter = _prices_if_any(*of_prices) if prices_may_lack else _prices(*of_prices)
    price = before.with_prices(price, grid_s, back, measured.record.origin)
    others_W = _others_W(sources, reader, grid_s, measured, back, name, notes)
    values, guessed = {"lower_C": lower, "upper_C": upper, "price_per_kWh": price}, {}
    # What the map says of prices that were is of another tariff where it is one number, or a file has those ahead.
    by_file = prices is not None and (sources.bill is None or sources.bill.energy is not None)
    of_map = [measured.map.machines.get(name) for name in measured.record.names.machines]
    of_another = [by_file or one is None or not isinstance(one.price, Price) for one in of_map]
    for signal, rows_of in values.items():
        past = past_price if signal == "price_per_kWh" else getattr(measured.conditions, signal)
        apart = of_another if signal == "price_per_kWh" else [False] * len(rows_of)
        values[signal], guessed[signal] = _as_days_before(
            grid_s, rows_of, measured.conditions.time_s, past, signal, back, measured.record.origin, apart
        )
    names, n = measured.record.names, grid_s.size - back
    boundary = Boundary(
        grid_s[back:], outdoor[back:], solar[back:], np.zeros((len(names.zones), n)),
        values["lower_C"], values["upper_C"], values["price_per_kWh"], np.zeros((len(names.machines), n)), names=names,
        guessed={signal: rows_of for signal, rows_of in guessed.items() if rows_of.any()},
        others_W=others_W,
        **{key: of_meter[back:] for key, of_meter in at_meter.items()},
    )  # fmt: skip
    if file is not None:
        _check_known(boundary, measured, name, ("price_per_kWh",) if prices_may_lack else ())
        before.any = True
    return boundary


@dataclass
class ReadBefore:
    """What earlier forecasts of a loop found: whether there was `any`, and the last `bill` that could be read.

    `prices` (M,) by the time of what was paid, s since 1970: a table that begins with now has those of today no more.
    """

    any: bool = False
    bill: Bill | None = None
    prices: dict[int, Array] = field(default_factory=dict)

    def with_prices(self, price: Array, grid_s: Array, back: int, origin: pd.Timestamp) -> Array:
        """Prices (M, n) at `grid_s` (n,), those before place `back` as they were read then where they are not now."""
        since_s = round(origin.timestamp())
        times = [since_s + round(one_s) for one_s in grid_s.tolist()]
        price = price.copy()
        for k in range(back):
            if (read := self.prices.get(times[k])) is not None:
                price[:, k] = np.where(np.isfinite(price[:, k]), price[:, k], read)
        here = {times[k]: price[:, k] for k in range(back + 1) if np.isfinite(price[:, k]).all()}
        self.prices = {at: one for at, one in self.prices.items() if at >= times[0]} | here
        return price


@dataclass(frozen=True)
class _Sources:
    """What the map says of a forecast, its own key before those of the measurements.

    `ours`: the map with the forecast's own columns of time and weather; `bounds`: of each zone, `tariffs`: of each
    machine, `at_meter`: of other loads and generation, a column, a number or None; `bill`: of a file of prices.
    """

    ours: MeasurementMap
    bounds: Mapping[str, Sequence[float | Signal | None]]
    tariffs: Sequence[float | Signal | None]
    at_meter: Sequence[Power | None]
    bill: Bill | None
    given: frozenset[str]

    @classmethod
    def of(cls, measured: Measurements, prices: Path | None, before: ReadBefore, notes: list[str]) -> _Sources:
        """`notes` say why a bill is that of `before`, which keeps it; where there was no forecast that is an error."""
        rules, names = measured.map, measured.record.names
        own = {key: value for key, value in rules.forecast if value is not None}
        weather = {"outdoor": rules.outdoor.model_copy(update={"stuck_h": None}), "sun": rules.sun} | own
        if weather["sun"] is not None and ("sun" not in own or weather["sun"].stuck_h is None):
            weather["sun"] = weather["sun"].model_copy(update={"stuck_h": 0.0})  # see `_OUTDOOR_AHEAD`
        ours = rules.model_copy(update={key: weather[key] for key in ("time", "outdoor", "sun") if key in weather})
        zones = [rules.zones[name] for name in names.zones]
        bounds = {key: [own.get(key, getattr(zone, key)) for zone in zones] for key in ("lower", "upper")}
        machines = [rules.machines.get(name, MappedMachine()) for name in names.machines]
        try:
            bill = read_bill(prices) if prices is not None and prices.suffix in SUFFIXES else None
        except InputError as error:
            if not before.any:
                raise
            bill = before.bill
            notes.append(f"{error}: the bill is that which was read before")
        before.bill = bill
        by_file = prices is not None and (bill is None or bill.energy is not None)
        tariffs = [0.0 if by_file else own.get("price", machine.price) for machine in machines]
        at_meter = [rules.forecast.load, rules.forecast.generation]
        return cls(ours, bounds, tariffs, at_meter, bill, frozenset(own))

    @property
    def signals(self) -> list[Signal]:
        """Signals of a forecast's table."""
        weather: list[Signal] = [self.ours.outdoor]
        if self.ours.sun is not None:
            weather += [signal for signal in (self.ours.sun.signal, self.ours.sun.humidity) if signal]
        every = (*weather, *self.bounds["lower"], *self.bounds["upper"], *self.tariffs, *self.at_meter)
        return [signal for signal in every if isinstance(signal, Signal)]


def _rows(
    file: str | Path | pd.DataFrame, sources: _Sources, now: pd.Timestamp | None, notes: list[str]
) -> tuple[Timed, str]:
    """Rows of a forecast in the order of time, and the name of its table; of one that a machine writes at `now`."""
    rules, clock, units = sources.ours, sources.ours.time, units_of(sources.signals)
    columns = [column for signal in sources.signals for column in signal.columns]
    form, csv = rules.forecast.table or TableForm(), rules.forecast.csv or rules.csv
    clock = clock if now is None else clock.lenient()
    with _own_columns():
        if isinstance(file, pd.DataFrame):
            if now is None:
                tables = tables_of(file, clock.column, columns, form, "forecast", units=units)
            else:
                tables = [frame_appended(file, columns, clock, now + _LATEST, notes, units)]
        else:
            paths = found_files([file])
            if len(paths) > 1:
                raise DataError(f"{file}: names {len(paths)} files, a forecast is one: name the latest")
            # A forecast is a table of another form than the measurements, or written by another program.
            if (taken := _taken_for(paths, rules)) is not None:
                form, csv = rules.forecast.table or taken.table, rules.forecast.csv or taken.csv
                if rules.forecast.time is None:
                    zone = taken.clock.zone or rules.time.zone
                    clock = taken.clock.model_copy(update={"zone": zone, "marks": rules.time.marks})
                    clock = clock if now is None else clock.lenient()
            written = Written(time=clock, csv=csv, table=form)
            if now is None:
                tables = read_tables(paths, columns, lambda _: written, [], units)
            else:
                tables = read_appended(paths, columns, lambda _: written, now + _LATEST, notes, units=units)
    rows = timed(tables, clock, now)
    if now is not None:
        notes += rows.notes
    return rows, tables[0].name


def _no_rows(sources: _Sources, record: Record, n_steps: int) -> tuple[Timed, str]:
    """As `_rows`, of a forecast of `n_steps` of which nothing is known."""
    at = pd.DatetimeIndex(stamps(record.time_s[-1] + record.step_s * np.arange(n_steps + 1), record.origin))
    columns = [column for signal in sources.signals for column in signal.columns]
    return Timed(at, {column: np.full(len(at), np.nan) for column in columns}), "forecast"


def _taken_for(paths: Sequence[Path], rules: MeasurementMap) -> Recognised | None:
    """How a forecast is written, where that is not as the map says of the measurements; None where it may be."""
    if rules.table != TableForm():
        return recognised(paths)
    if rules.forecast.time is not None or rules.time.column is None:
        return None
    taken = recognised(paths)
    ours, theirs = each_column(rules.time.column), each_column(taken.clock.column)
    return None if not theirs or ours == theirs else taken


def _grid(rows: Timed, time_s: Array, name: str, measured: Measurements, least_steps: int) -> tuple[Array, int]:
    """Instants from a week before the end of the record to that of the forecast, s, and the place of that end.

    `time_s` (n,): of the rows, s.

    Raises `DataError` for a forecast that does not go on from there.
    """
    record = measured.record
    now_s, step_s = float(record.time_s[-1]), record.step_s
    if time_s[0] > now_s + BRIDGED_GAP_H * HOUR_S or time_s[-1] < now_s + step_s:
        raise DataError(
            f"{name}: goes from {rows.index[0]} to {rows.index[-1]}, the measurements end at "
            f"{record.stamps()[-1]}: the forecast must begin there (or before, or up to {BRIDGED_GAP_H:g} h later) and "
            "go on"
        )
    ahead = max(np.floor((time_s[-1] - now_s) / step_s + 1e-6), least_steps)
    week = round(_DAYS * DAY_S / step_s)
    back = min(week, int((now_s - time_s[0]) / step_s) if time_s[0] < now_s else 0)
    back = max(back, min(week, record.n_steps))
    return now_s + np.arange(-back, ahead + 1.0) * step_s, back


def _unit_doubt(outdoor_C: Array, signal: Temperature, record: Record) -> str:
    """That a forecast (n,) from the end of the record on goes on from it in another unit only, in words; else ''."""
    if signal.unit == "K":
        return ""
    fahrenheit = signal.unit.endswith("F")
    unit, past, ahead, otherwise = ("°C" if fahrenheit else "°F"), np.nan, np.nan, np.nan
    for while_s in _WHILES_S:
        n = steps_in(while_s, record.step_s)
        past_C, ahead_C = (values[np.isfinite(values)] for values in (record.T_out_C[-n:], outdoor_C[:n]))
        if not past_C.size or not ahead_C.size:
            return ""
        past, ahead = float(np.median(past_C)), float(np.median(ahead_C))
        otherwise = float(in_fahrenheit(ahead) if fahrenheit else in_celsius(ahead))
        if abs(ahead - past) < _OTHER_WEATHER_K or abs(otherwise - past) > _GOES_ON_K:
            return ""
    return (
        f"column '{signal.columns[0]}': a median of {ahead:.0f} °C in the next day after {past:.0f} °C in the last; in "
        f"{unit} it would be {otherwise:.0f} °C: set unit: '{unit}' of forecast.outdoor in the map, or of outdoor"
    )


def _needed(what: str, source: float | Signal | None, where: str) -> float | Signal:
    if source is None:
        raise DataError(f"forecast: no {what}: name a number or a column in the map ({where})")
    return source


def _bounds(sources: _Sources, reader: SignalReader, grid_s: Array, measured: Measurements) -> tuple[Array, Array]:
    """Comfort bounds (Z, n), °C: by columns of the forecast, the schedule of the map, or its zones, in this order."""
    rules, record = measured.map, measured.record
    by_schedule: dict[str, Array] = {}
    if rules.comfort is not None:
        mapped, at = list(rules.zones), pd.DatetimeIndex(stamps(grid_s, record.origin))
        rows_of_zones = [mapped.index(zone) for zone in record.names.zones]
        for key, of_all in zip(("lower", "upper"), rules.comfort.bounds_at(at, mapped), strict=True):
            if key not in sources.given:
                by_schedule[key] = of_all[rows_of_zones]

    def bound(key: str) -> Array:
        if key in by_schedule:
            return by_schedule[key]
        where = "zones, or forecast for all zones"
        pairs = zip(record.names.zones, sources.bounds[key], strict=True)
        return np.array(
            [
                reader.scheduled(f"{key} of {zone}", _needed(f"{key} of {zone}", source, where), BOUND)
                for zone, source in pairs
            ]
        )

    return bound("lower"), bound("upper")


def _prices_if_any(
    sources: _Sources, reader: SignalReader, grid_s: Array, measured: Measurements, prices: Path | None,
    notes: list[str], now: pd.Timestamp | None,
) -> tuple[Array, Array, dict[str, Array]]:  # fmt: skip
    """As `_prices`; NaN with a note where the file `prices` cannot be read."""
    past_price = measured.conditions.price_per_kWh
    unknown, at_meter = np.full((len(past_price), grid_s.size), np.nan), dict[str, Array]()
    try:
        return _prices(sources, reader, grid_s, measured, prices, notes, now)
    except InputError as error:
        if prices is None:
            raise
        notes.append(f"{error}: prices are those that were read before")
    if (bill := sources.bill) is not None:
        at_meter["limit_W"] = 1000.0 * bill.limit_kW(pd.DatetimeIndex(stamps(grid_s, measured.record.origin)))
        if isinstance(bill.export_per_kWh, float):
            at_meter["export_per_kWh"] = np.full(grid_s.size, bill.export_per_kWh)
    return unknown, np.full(past_price.shape, np.nan), at_meter


def _prices(
    sources: _Sources, reader: SignalReader, grid_s: Array, measured: Measurements, prices: Path | None,
    notes: list[str], now: pd.Timestamp | None,
) -> tuple[Array, Array, dict[str, Array]]:  # fmt: skip
    """Prices (M, n) of the forecast and (M, m) of the measurements, and what a bill says of the meter (n,), by name."""
    record, past = measured.record, measured.conditions
    machines = record.names.machines
    price = np.array(
        [
            reader.price(f"price of {machine}", _needed(f"price of {machine}", tariff, "machines or forecast"))
            for machine, tariff in zip(machines, sources.tariffs, strict=True)
        ]
    )
    bill, clock, step_s = sources.bill, sources.ours.time, record.step_s
    if prices is None:
        priced = list(dict.fromkeys(tariff for tariff in sources.tariffs if isinstance(tariff, Price)))
        named = [name for tariff in priced for name in tariff.columns]
        notes += [f"column '{' + '.join(one.columns)}': {one.unit}" for one in priced if one.unit != "per kWh"]
        currency = next(filter(None, map(currency_of, named)), "")
        # What a machine writes is looked at by its loop, once a day.
        if now is None and (doubt := price_doubt(price, currency)):
            of = f"column '{named[0]}': " if named else ""
            notes.append(f"{of}{doubt} Set unit: per MWh or cent per kWh, or a factor, in the map")
        return price, past.price_per_kWh, {}
    if bill is None:
        of_file, read = prices_over_steps(prices, clock, record.origin, grid_s, step_s, now=now)
        notes.append(read)
        return np.tile(of_file, (len(machines), 1)), past.price_per_kWh, {}
    price, earns, read = billed_over_steps(prices, bill, price, clock, record.origin, grid_s, step_s, now)
    notes.append(read)
    limit_W = 1000.0 * bill.limit_kW(pd.DatetimeIndex(stamps(grid_s, record.origin)))
    past_price = np.stack([billed(bill, row, past.time_s, record.origin, step_s) for row in past.price_per_kWh])
    at_meter = {"export_per_kWh": earns, "limit_W": limit_W}
    return price, past_price, {key: values for key, values in at_meter.items() if values.size}


def _others_W(
    sources: _Sources, reader: SignalReader, grid_s: Array, measured: Measurements, back: int, name: str,
    notes: list[str],
) -> Array:  # fmt: skip
    """Other loads at the meter less generation from place `back` of `grid_s` on (N + 1,), W; empty where the map names
    none. What is not known is as on days before, here or by the meter, else NaN; `notes` say from when on."""
    if not any(sources.at_meter):
        return np.empty(0)
    record = measured.record
    others_W = np.zeros(grid_s.size)
    for key, signal, sign in zip(("load", "generation"), sources.at_meter, (1.0, -1.0), strict=True):
        if signal is not None:
            over_steps = reader.mean(f"forecast.{key}", signal, POWER)
            others_W += sign * np.append(over_steps, over_steps[-1:])
    past_W = np.full(record.n_steps + 1, np.nan)
    if record.meter_W.size:
        past_W[:-1] = record.meter_W - record.power_W.sum(axis=0)
    told = grid_s, others_W[None], record.time_s, past_W[None], "others_W", back, record.origin, [False]
    (ahead_W,), (guessed,) = _as_days_before(*told)
    for where, how in ((guessed, "as on days before"), (np.isnan(ahead_W), "taken as 0 W")):
        if where.any():
            since = stamps(grid_s[back:][where][:1], record.origin)[0]
            text = f"{name}: load and generation are not known from {since} on: {how}"
            notes.append(Note(text, f"{name}: load and generation: {how}"))
    return ahead_W


@contextmanager
def _own_columns() -> Iterator[None]:
    """Say how columns of a forecast are named where one is missing."""
    try:
        yield
    except NoColumn as error:
        raise DataError(
            f"{error}. Columns of a forecast with other names stand in the key forecast of the map, "
            "as forecast: {outdoor: NAME, sun: NAME}"
        ) from error


def _as_days_before(
    grid_s: Array,
    values: Array,
    past_s: Array,
    past: Array,
    name: str,
    back: int,
    origin: pd.Timestamp,
    apart: Sequence[bool],
) -> tuple[Array, NDArray[np.bool_]]:
    """Values (k, n + 1) from place `back` of `grid_s` on, what is not known as on days before, and which those are.

    `values` (k, back + n + 1): of the forecast; `past` (k, m): of the measurements at `past_s`. Days are those of the
    clock of `origin`, of 23 and 25 hours too. Rows of `past` that are `apart`, of another tariff, count only where the
    forecast has no value at all.
    """
    known = values.copy()
    for k, measured in enumerate(past):
        if not (apart[k] and np.isfinite(known[k]).any()):
            known[k] = np.where(np.isfinite(known[k]), known[k], at_instants(grid_s, past_s, measured, 1.0))
    time_s = grid_s[back:]
    out = known[:, back:].copy()
    missing = ~np.isfinite(out)
    for row, gaps, source in zip(out, missing, known, strict=True):
        if gaps.any():
            days = np.stack(
                [at_instants(days_before_s(time_s, day, origin), grid_s, source, 1.0) for day in range(1, _DAYS + 1)]
            )
            there = np.isfinite(days)
            if name == "price_per_kWh":
                same_hour = np.where(there, days, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
            else:  # as a week before, else as on the last day
                same_hour = days[-1]
                for day in days[:-1]:
                    same_hour = np.where(np.isfinite(same_hour), same_hour, day)
            fill = gaps & there.any(axis=0)
            row[fill] = same_hour[fill]
    return out, missing & np.isfinite(out)


def _check_known(boundary: Boundary, measured: Measurements, name: str, lacking: Sequence[str]) -> None:
    """Refuse a forecast in which a column, but for those `lacking`, has no value at all, or bounds leave no band.

    Raises `DataError`.
    """
    at = stamps(boundary.time_s, measured.record.origin)
    for signal in ("T_out_C", "solar_W_m2", "lower_C", "upper_C", "price_per_kWh"):
        if signal not in lacking and not np.isfinite(np.atleast_2d(getattr(boundary, signal))).any(axis=1).all():
            raise DataError(
                f"{name}: {signal} has no value from {at[0]} to {at[-1]}: fill its column, or name another one"
            )
    crossed = (boundary.lower_C > boundary.upper_C).any(axis=0)
    if crossed.any():
        row = int(np.argmax(crossed))
        raise DataError(f"{name}: at {at[row]} the lower bound is above the upper one (lower and upper of the map)")
