"""A forecast of weather, prices and comfort bounds from a file, by the map of the measurements it goes on from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.data import Array, Boundary
from thermoforce_mpc.data.dataframes import seconds_since
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.load import Measurements, sunlight
from thermoforce_mpc.measurements.map.entries import Signal
from thermoforce_mpc.measurements.map.mapping import MappedMachine
from thermoforce_mpc.measurements.signals import SignalReader
from thermoforce_mpc.measurements.tables.clock import timed
from thermoforce_mpc.measurements.tables.files import found_files, read_tables
from thermoforce_mpc.measurements.tables.forms import TableForm
from thermoforce_mpc.measurements.tables.raw_table import tables_of
from thermoforce_mpc.measurements.readings import BOUND, OUTDOOR, PRICE, Rules


def read_forecast(file: str | Path | pd.DataFrame, measured: Measurements) -> Boundary:
    """The conditions from the end of `measured` to that of the forecast, at the step of the record.

    Temperatures and irradiance go straight between two rows, bounds and prices hold until the next one. Columns are
    those of the map's key `forecast`, where it has one, else of the same keys as for measurements; numbers in the map
    hold throughout. Raises `DataError`, naming file, column and time, for several files, a forecast that does not begin
    at or before the end of the record, and one that lacks something.
    """
    rules, record = measured.map, measured.record
    names = record.names
    overrides = {key: value for key, value in rules.forecast if value is not None}
    ours = rules.model_copy(update={key: overrides[key] for key in ("time", "outdoor", "sun") if key in overrides})
    zones = [rules.zones[name] for name in names.zones]
    bounds = {name: [overrides.get(name, getattr(zone, name)) for zone in zones] for name in ("lower", "upper")}
    machines = [rules.machines.get(name, MappedMachine()) for name in names.machines]
    prices = [overrides.get("price", machine.price) for machine in machines]
    weather = [ours.outdoor, *([s for s in (ours.sun.signal, ours.sun.humidity) if s] if ours.sun else [])]
    signals = [s for s in (*weather, *bounds["lower"], *bounds["upper"], *prices) if isinstance(s, Signal)]
    columns = [column for signal in signals for column in signal.columns]
    if isinstance(file, pd.DataFrame):
        tables = tables_of(file, ours.time.column, columns, rules.forecast.table or TableForm(), "forecast")
    else:
        paths = found_files([file])
        if len(paths) > 1:
            raise DataError(f"{file}: names {len(paths)} files, a forecast is one: name the latest")
        form, csv = rules.forecast.table or TableForm(), rules.forecast.csv or rules.csv
        tables = read_tables(paths, ours.time.column, columns, csv, form, [])
    table, rows = tables[0], timed(tables, ours.time)
    time_s = seconds_since(record.origin, rows.index, table.name)
    now_s, step_s = float(record.time_s[-1]), record.step_s
    if not time_s[0] <= now_s + 1.0 or not time_s[-1] >= now_s + step_s:
        raise DataError(
            f"{table.name}: goes from {rows.index[0]} to {rows.index[-1]}, the measurements end at "
            f"{record.stamps()[-1]}: the forecast must begin there (or before) and go on"
        )
    grid_s = now_s + np.arange(np.floor((time_s[-1] - now_s) / step_s + 1e-6) + 1.0) * step_s
    reader = SignalReader(rows, time_s, grid_s, step_s, ours)
    outdoor = reader.sampled("outdoor", ours.outdoor, OUTDOOR)
    solar, _ = sunlight(ours, reader, grid_s, record.origin)

    def scheduled(what: str, source: float | Signal | None, where: str, of: Rules) -> Array:
        if source is None:
            raise DataError(f"forecast: no {what}: name a number or a column in the map ({where})")
        return reader.scheduled(what, source, of)

    lower, upper = (
        [
            scheduled(f"{name} of {zone}", source, "zones, or forecast for all zones", BOUND)
            for zone, source in zip(names.zones, sources, strict=True)
        ]
        for name, sources in bounds.items()
    )
    price = [
        scheduled(f"price of {machine}", tariff, "machines or forecast", PRICE)
        for machine, tariff in zip(names.machines, prices, strict=True)
    ]
    nothing = np.zeros((len(names.machines), grid_s.size))
    boundary = Boundary(
        grid_s, outdoor, solar, np.zeros((len(names.zones), grid_s.size)), np.array(lower), np.array(upper),
        np.array(price), nothing, names=names,
    )  # fmt: skip
    _check_complete(boundary, measured, table.name)
    return boundary


def _check_complete(boundary: Boundary, measured: Measurements, name: str) -> None:
    """Refuse a forecast with gaps; raises `DataError` with signal and time."""
    stamps = pd.DatetimeIndex(measured.record.origin + pd.to_timedelta(boundary.time_s, unit="s"))
    for signal in ("T_out_C", "solar_W_m2", "lower_C", "upper_C", "price_per_kWh"):
        missing = np.flatnonzero(~np.isfinite(np.atleast_2d(getattr(boundary, signal))).all(axis=0))
        if missing.size:
            raise DataError(
                f"{name}: {signal} is missing at {missing.size} of {boundary.time_s.size} instants, first at "
                f"{stamps[missing[0]]}: fill the gap, or end the file before it"
            )
    if (boundary.lower_C > boundary.upper_C).any():
        row = int(np.argmax((boundary.lower_C > boundary.upper_C).any(axis=0)))
        raise DataError(f"{name}: at {stamps[row]} the lower bound is above the upper one (lower and upper of the map)")
