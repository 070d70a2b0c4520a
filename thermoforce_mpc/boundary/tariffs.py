"""Electricity tariffs of the test cases (EUR/kWh, USD/kWh), prices of gas, and emission factors (kg CO2/kWh)."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Array
from thermoforce_mpc.data.clock import hour_of_day
from thermoforce_mpc.data.prices import price_doubt
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import DoubtfulInput, plain_number, read_bounded, read_pieces

EMISSION_KG_PER_KWH = 0.167
CONSTANT = 0.2535
DYNAMIC_DAY, DYNAMIC_NIGHT = 0.2666, 0.2383
# Gas in Belgium, of our own houses and offices: the same price in all three tariffs.
GAS, GAS_EMISSION_KG_PER_KWH = 0.07, 0.181
# A price for each minute of a year has 10 MB.
_MOST_BYTES = 20_000_000
_MOST_PRICES = 600_000
# Per kWh in any currency.
_MOST_PRICE = 1e5
_PRICE_COLUMNS = (
    "price",
    "PriceElectricPowerHighlyDynamic",
    "preis",
    "strompreis",
    "prix",
    "prijs",
    "tarif",
    "tariff",
    "spot",
)
_TIME_COLUMNS = (
    "time", "timestamp", "date", "datetime", "datum", "zeit", "zeitpunkt", "von", "start", "from", "heure", "tijd",
    "date/time",
    "horodatage",
)  # fmt: skip

Tariff = Callable[[Array], Array]


def constant(time_s: Array) -> Array:
    """Return the constant tariff, EUR/kWh, shape of `time_s` (s since 1 January)."""
    return np.full(np.shape(time_s), CONSTANT)


def dynamic(time_s: Array) -> Array:
    """Return the day/night tariff, EUR/kWh: the day price holds from 07:00 up to and including the 22:00 sample."""
    hour = hour_of_day(time_s)
    # BOPTEST's price series has 15-min samples held to the next: the 22:00 value lasts to 22:15.
    return np.where((hour >= 7.0) & (hour < 22.25), DYNAMIC_DAY, DYNAMIC_NIGHT)


def denver_dynamic(time_s: Array) -> Array:
    """Return the day/night tariff of `bestest_air`, USD/kWh: dearer from 9:00 to 21:00, dearest on working afternoons.

    From June to September both are dearer still. Source: boundary data of the test case.
    """
    day = np.floor(np.asarray(time_s) / DAY_S) % 365
    hour = hour_of_day(time_s)
    summer = (day >= 151) & (day < 273)
    working = ~np.isin(day % 7, (4, 5))
    mid, peak = np.where(summer, 0.0842, 0.05413), np.where(summer, 0.13814, 0.0888)
    by_day = np.where(working & (hour >= 14.0) & (hour < 18.0), peak, mid)
    return np.where((hour >= 9.0) & (hour < 21.0), by_day, 0.0444)


def synthetic_denver_spot() -> Tariff:
    """Return a synthetic highly dynamic tariff like that of `bestest_air`: hourly, mean near 0.021 USD/kWh, spikes.

    Mean, spread, daily shape, and rare negative and dear hours are those of the test case's own prices.
    """
    rng = np.random.default_rng(1)
    hour = np.arange(8760.0)
    of_day = hour % 24
    daylight = np.where((of_day >= 5) & (of_day < 20), np.sin(np.pi * np.clip((of_day - 3.0) / 19.0, 0.0, 1.0)), 0.0)
    slow = np.repeat(_autoregressive(rng, 365, 0.7) * 0.004, 24)
    prices = 0.0158 + 0.0115 * daylight + slow + 0.0095 * _autoregressive(rng, 8760, 0.8)
    for start in rng.choice(8757, size=30, replace=False):
        prices[start : start + 3] += rng.uniform(0.02, 0.06)
    return held_prices(hour * HOUR_S, np.asarray(np.round(np.clip(prices, -0.02, 0.1), 5), dtype=np.float64))


def synthetic_spot() -> Tariff:
    """Return a synthetic highly dynamic tariff: hourly, spot-like, mean near 0.24 EUR/kWh, rare negative hours.

    It replaces the day-ahead prices of the real test case (Belpex 2019 plus 0.20), which cannot be redistributed.
    """
    rng = np.random.default_rng(0)
    hour = np.arange(8760.0)
    of_day = hour % 24
    day = hour // 24
    shape = 0.010 * np.exp(-(((of_day - 8.5) / 2.0) ** 2)) + 0.014 * np.exp(-(((of_day - 19.0) / 2.2) ** 2))
    night = -0.009 * np.exp(-(((of_day - 3.5) / 2.5) ** 2))
    weekend = np.where(np.isin(day % 7, (4, 5)), -0.006, 0.0)
    slow = np.repeat(_autoregressive(rng, 365, 0.8) * 0.007, 24)
    fast = _autoregressive(rng, 8760, 0.7) * 0.0045
    season = 0.006 * np.cos(2 * np.pi * (day - 15) / 365)
    prices = 0.2375 + shape + night + weekend + season + slow + fast
    # Three windy nights of 5 h with prices 0.1 to 0.3 lower.
    for start in rng.choice(8752, size=3, replace=False):
        prices[start : start + 5] -= rng.uniform(0.1, 0.3)
    return held_prices(hour * HOUR_S, np.asarray(np.round(prices, 5), dtype=np.float64))


def tariff_from_file(path: Path) -> Tariff:
    """Read a tariff from a CSV file (or .csv.gz); each price holds until the next time.

    Columns: `time`, s since 1 January increasing from 0, or stamps from 1 January on, and `price` per kWh or BOPTEST's
    PriceElectricPowerHighlyDynamic; with comma, semicolon or tab, decimal commas behind the latter two, and lines of
    comment (#). A file of a whole year (365 days) repeats; a shorter one is valid until its end.
    The 366th day of a leap year is read with a `DoubtfulInput` warning and not used. Raises `ConfigError` for a file
    that is missing, damaged or has other columns, and for values that are no numbers, do not rise or leave the year.
    """
    time_s, price = _read_prices(path, _text(path))
    if time_s.size < 2:
        raise ConfigError(f"{path}: only one price; give at least two, whose distance says how long the last one holds")
    if time_s.min() < -YEAR_S or time_s.max() > YEAR_S + DAY_S:
        raise ConfigError(
            f"{path}: times from {time_s.min():g} to {time_s.max():g} s; a year ends at {YEAR_S:g} s: "
            "give the prices of one, which then repeats"
        )
    if time_s[0] > 0 or not (np.diff(time_s) > 0).all():
        raise ConfigError(f"{path}: times must rise and start at 0 s or before (first is {time_s[0]:g} s)")
    if np.abs(price).max() > _MOST_PRICE:
        raise ConfigError(
            f"{path}: a price of {price[np.abs(price).argmax()]:g} per kWh; at most {_MOST_PRICE:g} is read"
        )
    if doubt := price_doubt(price):
        warnings.warn(f"{path}: {doubt}", DoubtfulInput, stacklevel=2)
    if time_s[-1] > YEAR_S:  # a row at its end may close the year
        warnings.warn(
            f"{path}: has prices until day {time_s[-1] / DAY_S:g}; those after day 365 are not used, since the year "
            "repeats then",
            DoubtfulInput,
            stacklevel=2,
        )
    return held_prices(time_s, price, str(path))


def held_prices(time_s: Array, price: Array, source: str = "tariff") -> Tariff:
    """A tariff, periodic over the year, whose `price` (n,) per kWh holds from each `time_s` (n,) to the next.

    The last price holds as long as the one before it; beyond, the tariff raises `ConfigError`, naming `source`.
    """
    until_s = float(time_s[-1] + (time_s[-1] - time_s[-2]))

    def tariff(at_s: Array) -> Array:
        in_year_s = np.mod(np.asarray(at_s, dtype=np.float64), YEAR_S)
        if in_year_s.size and in_year_s.max() >= until_s:
            raise ConfigError(
                f"{source}: has prices until day {until_s / DAY_S:g}, asked for day {in_year_s.max() / DAY_S:g}; "
                "give a longer file, or an earlier window"
            )
        return np.asarray(price[np.searchsorted(time_s, in_year_s, side="right") - 1])

    return tariff


def _text(path: Path) -> str:
    """Content of a CSV file or .csv.gz; raises `ConfigError` if it is not text or too long."""
    content = read_bounded(path, _MOST_BYTES, ConfigError)
    try:
        if path.suffix == ".gz":
            with gzip.open(io.BytesIO(content)) as file:
                content = read_pieces(file, _MOST_BYTES)
            if len(content) > _MOST_BYTES:
                raise ConfigError(f"{path}: more than {_MOST_BYTES:,} bytes when unpacked, the most that is read here")
        return content.decode("utf-8-sig")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:  # EOFError, zlib.error: truncated .gz
        raise ConfigError(f"{path}: cannot be read ({error})") from error


def _read_prices(path: Path, text: str) -> tuple[Array, Array]:
    """Return times, s, and prices, (n,) each; raises `ConfigError` naming the line of an invalid value."""
    lines = text.splitlines()
    comments = [line.startswith("#") or not line.strip() for line in lines]
    if all(comments):
        _price_columns(path, [])
    first = comments.index(False)
    separator = max(",;\t", key=lines[first].count)
    decimal = separator != "," and any("," in line for line in lines[first + 1 : first + 50])
    rows: list[tuple[str, str]] = []
    numbers: list[int] = []
    # Comments stay as empty lines, so that the reader's count is that of the file.
    kept = ("" if comment else line for line, comment in zip(lines, comments, strict=True))
    reader = csv.reader(kept, delimiter=separator)
    try:
        header: list[str] = []
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if not header:
                header = [cell.strip() for cell in row]
                columns = _price_columns(path, header)
                continue
            if len(rows) > _MOST_PRICES:
                raise ConfigError(f"{path}: more than {_MOST_PRICES:,} prices, one for each minute of a year")
            time, price = (row[column].strip() if column < len(row) else "" for column in columns)
            rows.append((time, price.replace(",", ".") if decimal else price))
            numbers.append(reader.line_num)
    except csv.Error as error:
        raise ConfigError(f"{path}: line {reader.line_num}: not CSV ({error})") from error
    named = [header[column] for column in columns]
    prices = [_number(path, line, price, named[1]) for line, (_, price) in zip(numbers, rows, strict=True)]
    times = [time for time, _ in rows]
    if times and _is_stamp(times[0]):
        return _seconds(path, times, numbers, named[0]), np.array(prices, dtype=np.float64)
    seconds = [
        _number(path, line, time.replace(",", ".") if decimal else time, named[0])
        for line, time in zip(numbers, times, strict=True)
    ]
    return np.array(seconds, dtype=np.float64), np.array(prices, dtype=np.float64)


def _price_columns(path: Path, header: list[str]) -> tuple[int, int]:
    """Places of the times and the prices: by their names, or the first and the second of two columns."""
    low = [re.sub(r"\W*[\[(].*", "", name).strip().lower() for name in header]
    time = next((k for k, name in enumerate(low) if name in _TIME_COLUMNS), None)
    price = next((low.index(name.lower()) for name in _PRICE_COLUMNS if name.lower() in low), None)
    if time is None or price is None:
        raise ConfigError(
            f"{path}: expected a CSV file with columns 'time' (s since 1 January, or stamps such as 2025-01-01 "
            "00:00) and "
            f"one of {', '.join(_PRICE_COLUMNS)} (per kWh); there {'is' if len(header) == 1 else 'are'} "
            f"{', '.join(header)[:200] or 'none'}"
        )
    return time, price


def _is_stamp(text: str) -> bool:
    return bool(re.match(r"\d{4}-\d{2}-\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}", text))


def _seconds(path: Path, times: list[str], numbers: list[int], name: str) -> Array:
    """Seconds of stamps (n,) since the beginning of the year of the first one, by their clock."""
    form = "ISO8601" if re.match(r"\d{4}-", times[0]) else "%d.%m.%Y %H:%M" if "." in times[0] else None
    if form is None:
        raise ConfigError(
            f"{path}: line {numbers[0]}, column '{name}': day or month first in {times[0]!r:.60}? write 2025-01-31 "
            "14:30"
        )
    stamps = pd.to_datetime(
        pd.Series(times).str.replace(r"[+-]\d{2}:?\d{2}$|Z$", "", regex=True), format=form, errors="coerce"
    )
    if (wrong := np.flatnonzero(stamps.isna())).size:
        row = int(wrong[0])
        raise ConfigError(f"{path}: line {numbers[row]}, column '{name}': {times[row]!r:.60} is no time")
    year = pd.Timestamp(year=stamps.iloc[0].year, month=1, day=1)
    return np.asarray((stamps - year).dt.total_seconds(), dtype=np.float64)


def _number(path: Path, line: int, text: str, column: str) -> float:
    try:
        value = plain_number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}: line {line}, column '{column}': {text!r:.60} is not a finite number")
    return value


def _autoregressive(rng: np.random.Generator, n: int, memory: float) -> Array:
    """Return first-order autoregressive noise of unit variance, shape (n,)."""
    noise = rng.standard_normal(n) * np.sqrt(1 - memory**2)
    out = np.empty(n)
    out[0] = noise[0]
    for i in range(1, n):
        out[i] = memory * out[i - 1] + noise[i]
    return out


def by_name(highly_dynamic: Tariff | None = None) -> dict[str, Tariff]:
    """Return the three tariffs by BOPTEST's names; the highly dynamic one is synthetic unless given."""
    return {"constant": constant, "dynamic": dynamic, "highly_dynamic": highly_dynamic or synthetic_spot()}
