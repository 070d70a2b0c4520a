"""A forecast of weather, prices and comfort bounds from a file, by the map of the measurements it goes on from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary
from thermoforce_mpc.data.dataframes import seconds_since, stamps
from thermoforce_mpc.data.limits import BRIDGED_GAP_H
from thermoforce_mpc.data.series import at_instants
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.load import Measurements, sunlight
from thermoforce_mpc.measurements.map.entries import Signal
from thermoforce_mpc.measurements.map.mapping import MappedMachine
from thermoforce_mpc.measurements.prices import billed, billed_over_steps, prices_over_steps
from thermoforce_mpc.measurements.readings import BOUND, OUTDOOR, POWER
from thermoforce_mpc.measurements.signals import SignalReader
from thermoforce_mpc.measurements.tables.appended import frame_appended, read_appended
from thermoforce_mpc.measurements.tables.clock import timed
from thermoforce_mpc.measurements.tables.files import found_files, read_tables
from thermoforce_mpc.measurements.tables.forms import TableForm
from thermoforce_mpc.measurements.tables.raw_table import NoColumn, tables_of
from thermoforce_mpc.measurements.tables.recognition import recognised
from thermoforce_mpc.scenario.bill import SUFFIXES, read_bill

# Days before now whose hours tell what a price or bound is likely to be.
_DAYS = 7
# A single row of a forecast so far ahead has a wrong stamp.
_LATEST = pd.Timedelta("60D")


def read_forecast(
    file: str | Path | pd.DataFrame,
    measured: Measurements,
    *,
    least_steps: int = 0,
    prices: Path | None = None,
    now: pd.Timestamp | None = None,
    left_out: list[str] | None = None,
) -> Boundary:
    """The conditions from the end of `measured` to that of the forecast, at the step of the record.

    Temperatures and irradiance go straight between two rows, bounds hold until the next one, prices are means over a
    step. Columns are those of the map's key `forecast`, where it has one, else of the same keys as for measurements;
    numbers in the map hold throughout. Each column ends where it ends, at `least_steps` at least: a price is then the
    mean of the same hour of the last days that are known, here or in `measured`, a bound that of the week or day before
    (`Boundary.guessed`); weather is NaN (`model.forecast_gaps` bridges it), and what has no such hour.

    `prices`: a file of them for all machines (`measurements.prices`), or of a bill (`scenario.bill`), in the place of
    those of the map; `left_out` says how it was read.

    With the time `now` a file that a machine writes is read: what cannot be read is left out and said in `left_out`,
    as by `read_measurements`.

    Raises `DataError`, naming file, column and time, for several files, a forecast that begins more than 6 h after the
    end of the record or ends before it, and a column without any value.
    """
    rules, record = measured.map, measured.record
    names = record.names
    overrides = {key: value for key, value in rules.forecast if value is not None}
    ours = rules.model_copy(update={key: overrides[key] for key in ("time", "outdoor", "sun") if key in overrides})
    zones = [rules.zones[name] for name in names.zones]
    bounds = {name: [overrides.get(name, getattr(zone, name)) for zone in zones] for name in ("lower", "upper")}
    machines = [rules.machines.get(name, MappedMachine()) for name in names.machines]
    bill = read_bill(prices) if prices is not None and prices.suffix in SUFFIXES else None
    by_file = prices is not None and (bill is None or bill.energy is not None)
    tariffs = [0.0 if by_file else overrides.get("price", machine.price) for machine in machines]
    weather = [ours.outdoor, *([s for s in (ours.sun.signal, ours.sun.humidity) if s] if ours.sun else [])]
    at_meter = [rules.forecast.load, rules.forecast.generation]
    given = (*weather, *bounds["lower"], *bounds["upper"], *tariffs, *at_meter)
    signals = [s for s in given if isinstance(s, Signal)]
    columns = [column for signal in signals for column in signal.columns]
    clock, notes = ours.time, [] if left_out is None else left_out
    if now is not None:
        clock, latest = clock.lenient(), now + _LATEST
    with _own_columns():
        if isinstance(file, pd.DataFrame):
            if now is None:
                tables = tables_of(file, clock.column, columns, rules.forecast.table or TableForm(), "forecast")
            else:
                tables = [frame_appended(file, columns, clock, latest, notes)]
        else:
            paths = found_files([file])
            if len(paths) > 1:
                raise DataError(f"{file}: names {len(paths)} files, a forecast is one: name the latest")
            form, csv = rules.forecast.table or TableForm(), rules.forecast.csv or rules.csv
            if rules.table != TableForm():  # a forecast is a table of another form than the measurements
                taken = recognised(paths)
                form, csv = rules.forecast.table or taken.table, rules.forecast.csv or taken.csv
                if rules.forecast.time is None:
                    zone = taken.clock.zone or rules.time.zone
                    clock = taken.clock.model_copy(update={"zone": zone})
                    clock = clock if now is None else clock.lenient()
            if now is None:
                tables = read_tables(paths, clock.column, columns, csv, form, [])
            else:
                tables = read_appended(paths, columns, clock, csv, form, latest, notes)
    table, rows = tables[0], timed(tables, clock, now)
    if now is not None:
        notes += rows.notes
    time_s = seconds_since(record.origin, rows.index, table.name)
    now_s, step_s = float(record.time_s[-1]), record.step_s
    if time_s[0] > now_s + BRIDGED_GAP_H * HOUR_S or time_s[-1] < now_s + step_s:
        raise DataError(
            f"{table.name}: goes from {rows.index[0]} to {rows.index[-1]}, the measurements end at "
            f"{record.stamps()[-1]}: the forecast must begin there (or before, or up to {BRIDGED_GAP_H:g} h later) and "
            "go on"
        )
    ahead = max(np.floor((time_s[-1] - now_s) / step_s + 1e-6), least_steps)
    back = min(round(_DAYS * DAY_S / step_s), int((now_s - time_s[0]) / step_s) if time_s[0] < now_s else 0)
    back = max(back, min(round(_DAYS * DAY_S / step_s), record.n_steps))
    grid_s = now_s + np.arange(-back, ahead + 1.0) * step_s
    reader = SignalReader(rows, time_s, grid_s, step_s, ours, refuse=now is None)
    outdoor = reader.sampled("outdoor", ours.outdoor, OUTDOOR)
    solar, _ = sunlight(ours, reader, grid_s, record.origin)

    def found(what: str, source: float | Signal | None, where: str) -> float | Signal:
        if source is None:
            raise DataError(f"forecast: no {what}: name a number or a column in the map ({where})")
        return source

    of_zones, of_machines = "zones, or forecast for all zones", "machines or forecast"
    by_schedule: dict[str, Array] = {}
    if rules.comfort is not None:
        mapped, at = list(rules.zones), pd.DatetimeIndex(stamps(grid_s, record.origin))
        rows_of_zones = [mapped.index(zone) for zone in names.zones]
        for name, of_all in zip(("lower", "upper"), rules.comfort.bounds_at(at, mapped), strict=True):
            if name not in overrides:
                by_schedule[name] = of_all[rows_of_zones]
    lower, upper = (
        by_schedule[name]
        if name in by_schedule
        else np.array(
            [
                reader.scheduled(f"{name} of {zone}", found(f"{name} of {zone}", source, of_zones), BOUND)
                for zone, source in zip(names.zones, sources, strict=True)
            ]
        )
        for name, sources in bounds.items()
    )
    price = np.array(
        [
            reader.price(f"price of {machine}", found(f"price of {machine}", tariff, of_machines))
            for machine, tariff in zip(names.machines, tariffs, strict=True)
        ]
    )
    past_price, earns, limit_W = measured.conditions.price_per_kWh, np.empty(0), np.empty(0)
    if bill is not None and prices is not None:
        price, earns, read = billed_over_steps(prices, bill, price, ours.time, record.origin, grid_s, step_s)
        limit_W = 1000.0 * bill.limit_kW(pd.DatetimeIndex(stamps(grid_s, record.origin)))
        past_s = measured.conditions.time_s
        past_price = np.stack([billed(bill, row, past_s, record.origin, step_s) for row in past_price])
        notes.append(read)
    elif prices is not None:
        of_file, read = prices_over_steps(prices, ours.time, record.origin, grid_s, step_s)
        price = np.tile(of_file, (len(names.machines), 1))
        notes.append(read)
    others_W = np.zeros(grid_s.size) if any(at_meter) else np.empty(0)
    for key, signal, sign in zip(("load", "generation"), at_meter, (1.0, -1.0), strict=True):
        if signal is not None:
            over_steps = reader.mean(f"forecast.{key}", signal, POWER)
            others_W += sign * np.append(over_steps, over_steps[-1:])
    values, guessed = {"lower_C": lower, "upper_C": upper, "price_per_kWh": price}, {}
    for name, rows_of in values.items():
        past = past_price if name == "price_per_kWh" else getattr(measured.conditions, name)
        values[name], guessed[name] = _as_days_before(grid_s, rows_of, measured.conditions.time_s, past, name, back)
    nothing = np.zeros((len(names.machines), grid_s.size - back))
    boundary = Boundary(
        grid_s[back:], outdoor[back:], solar[back:], np.zeros((len(names.zones), grid_s.size - back)),
        values["lower_C"], values["upper_C"], values["price_per_kWh"], nothing, names=names,
        guessed={name: rows_of for name, rows_of in guessed.items() if rows_of.any()},
        others_W=others_W[back:] if others_W.size else others_W,
        export_per_kWh=earns[back:] if earns.size else earns, limit_W=limit_W[back:] if limit_W.size else limit_W,
    )  # fmt: skip
    _check_known(boundary, measured, table.name)
    return boundary


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
    grid_s: Array, values: Array, past_s: Array, past: Array, name: str, back: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Values (k, n + 1) from place `back` of `grid_s` on, what is not known as on days before, and which those are.

    `values` (k, back + n + 1): of the forecast; `past` (k, m): of the measurements at `past_s`.
    """
    known = values.copy()
    for row, measured in zip(known, past, strict=True):
        row[:] = np.where(np.isfinite(row), row, at_instants(grid_s, past_s, measured, 1.0))
    time_s = grid_s[back:]
    out = known[:, back:].copy()
    missing = ~np.isfinite(out)
    for row, gaps, source in zip(out, missing, known, strict=True):
        if gaps.any():
            days = np.stack([at_instants(time_s - day * DAY_S, grid_s, source, 1.0) for day in range(1, _DAYS + 1)])
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


def _check_known(boundary: Boundary, measured: Measurements, name: str) -> None:
    """Refuse a forecast in which a column has no value at all, or bounds leave no band; raises `DataError`."""
    at = stamps(boundary.time_s, measured.record.origin)
    for signal in ("T_out_C", "solar_W_m2", "lower_C", "upper_C", "price_per_kWh"):
        if not np.isfinite(np.atleast_2d(getattr(boundary, signal))).any(axis=1).all():
            raise DataError(
                f"{name}: {signal} has no value from {at[0]} to {at[-1]}: fill its column, or name another one"
            )
    crossed = (boundary.lower_C > boundary.upper_C).any(axis=0)
    if crossed.any():
        row = int(np.argmax(crossed))
        raise DataError(f"{name}: at {at[row]} the lower bound is above the upper one (lower and upper of the map)")
