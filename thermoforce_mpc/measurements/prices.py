"""A file of prices for plans of an own building: stamps of a calendar, or seconds of a year as in simulations."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary.tariffs import Tariff, by_name, price_doubt, tariff_from_file
from thermoforce_mpc.data import YEAR_S, Array
from thermoforce_mpc.data.dataframes import clock_s, new_year, seconds_since, stamps
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.readings import SignalReadings, durations_s, ends_s, held, held_means, longest_s
from thermoforce_mpc.measurements.tables.clock import timed
from thermoforce_mpc.measurements.tables.files import head_of, read_tables
from thermoforce_mpc.measurements.tables.forms import TableForm, TimeStampRules
from thermoforce_mpc.measurements.tables.raw_table import as_numbers
from thermoforce_mpc.measurements.tables.recognition import guessed_form, recognised
from thermoforce_mpc.scenario.bill import Bill, file_beside
from thermoforce_mpc.scenario.building import PRICES

# What a column of prices is called, and what its name says of the unit: prices are divided by this.
_PRICE = re.compile(r"price|preis|prix|prijs|tarif|spot|epex|nordpool|day.?ahead", re.IGNORECASE)
_UNITS = ((re.compile(r"mwh", re.IGNORECASE), 1000.0), (re.compile(r"\bct\b|cent|ct/", re.IGNORECASE), 100.0))
_HEAD = 50
_SHARE = 0.5


def prices_over_steps(
    path: Path, clock: TimeStampRules, origin: pd.Timestamp, grid_s: Array, step_s: float
) -> tuple[Array, str]:
    """Prices per kWh (n,) over the steps that begin at `grid_s` (n,), s from `origin`, and what was read, in words.

    Stamps without an offset are of the zone of `clock`; NaN where the file has no price. The name of a tariff of the
    simulated buildings, where no file has it, is that tariff by the building's clock. Raises `DataError` for a file
    whose column of prices or unit is not clear.
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
    if pd.api.types.is_numeric_dtype(head.iloc[:, 0]):
        return _of_year(tariff_from_file(path), str(path), origin, grid_s), f"{path}: prices of a year, which repeats"
    numeric = [name for name in names[1:] if as_numbers(head[name], form.decimal).notna().any()]
    named = [name for name in numeric if _PRICE.search(name)] or numeric
    if len(named) != 1:
        raise DataError(
            f"{path}: which column is the price? there are {', '.join(names[1:])}; keep one, or call one 'price'"
        )
    stamped = recognised([path]).clock
    own = {"zone": clock.zone or stamped.zone, "order": "sort", "duplicates": "last"}
    tables = read_tables([path], stamped.column, named, form, TableForm(), [])
    rows = timed(tables, stamped.model_copy(update=own))
    values = rows.columns[named[0]]
    known = np.isfinite(values)
    factor, unit = next(
        ((by, f"{named[0]}, divided by {by:g}") for form, by in _UNITS if form.search(named[0])), (1.0, named[0])
    )
    if doubt := price_doubt(values[known] / factor):
        raise DataError(
            f"{path}, column '{named[0]}': {doubt} Say the unit in its name, as 'price per MWh' or 'ct/kWh'"
        )
    time_s = seconds_since(origin, rows.index[known], str(path))
    ends = ends_s(time_s, longest_s(time_s, step_s, None), np.empty(0))
    readings = SignalReadings(time_s, values[known] / factor, ends)
    if time_s.size > 1:
        price = held_means(readings, durations_s(readings, "start"), grid_s, step_s, _SHARE)
    else:
        price = held(readings, grid_s)
    return price, f"{path}: column {unit}, per kWh"


# Fees of a bill change at quarters of an hour.
_QUARTER_S = 900.0


def billed_over_steps(
    path: Path, bill: Bill, price: Array, clock: TimeStampRules, origin: pd.Timestamp, grid_s: Array, step_s: float
) -> tuple[Array, Array, str]:
    """What a kWh costs by the `bill` at `path` (M, n) and what it earns (n,), and what was read, in words.

    `price` (M, n): those of the map, which count where the bill names no energy. See `prices_over_steps`.
    """
    words = [f"{path}: {bill.source}"]

    def of(source: float | str) -> Array:
        if not isinstance(source, str):
            return np.full(grid_s.size, source)
        found, read = prices_over_steps(file_beside(path, source), clock, origin, grid_s, step_s)
        words.append(read)
        return found

    energy = price if bill.energy is None else np.tile(of(bill.energy), (len(price), 1))
    earns = np.zeros(grid_s.size) if bill.export_per_kWh is None else of(bill.export_per_kWh)
    billed_at = np.stack([billed(bill, row, grid_s, origin, step_s) for row in energy])
    if doubt := price_doubt(billed_at):
        raise DataError(f"{path}: with fees and tax {doubt}")
    return billed_at, earns, "; ".join(words)


def billed(bill: Bill, energy: Array, time_s: Array, origin: pd.Timestamp, step_s: float) -> Array:
    """What a kWh costs (n,) in the mean of steps that begin at `time_s` (n,), with `energy` (n,) per kWh."""
    parts = np.arange(max(1, round(step_s / _QUARTER_S))) * _QUARTER_S
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
