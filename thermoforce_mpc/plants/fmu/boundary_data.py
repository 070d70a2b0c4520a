"""BOPTEST's boundary data: time series over the year, in CSV files with a `time` column."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, YEAR_S, Array
from thermoforce_mpc.errors import ConfigError, WeatherError

# BOPTEST interpolates these series linearly and holds all others (prices, set-points, occupancy).
_WEATHER = (
    "HDifHor", "HDirNor", "HGloHor", "HHorIR", "TBlaSky", "TDewPoi", "TDryBul", "TWetBul", "ceiHei", "cloTim", "lat",
    "lon", "nOpa", "nTot", "pAtm", "relHum", "solAlt", "solDec", "solHouAng", "solTim", "solZen", "winDir", "winSpe",
)  # fmt: skip
# A year of weather every 15 minutes has 12 MB.
MOST_BYTES = 100_000_000
_MOST_ROWS = 2 * 365 * 1440 + 2
_MOST_LINE_BYTES = 20_000
_PART_ROWS = 20_000
_LARGEST = 1e12
_UNITS = {"TDryBul": "K", "TDewPoi": "K", "TWetBul": "K", "TBlaSky": "K", "HGloHor": "W/m2", "HDirNor": "W/m2"}
_UNITS |= {"HDifHor": "W/m2", "HHorIR": "W/m2"}


@dataclass(frozen=True)
class Series:
    """Time series: values (n,) at increasing times (n,), s since 1 January, and its source file."""

    time_s: Array
    values: Array
    source: str


@dataclass(frozen=True)
class BoundaryData:
    """Series by BOPTEST name, in BOPTEST's units."""

    series: Mapping[str, Series]

    def with_table(self, table: Mapping[str, Series], source: str) -> BoundaryData:
        """Return these series plus those of `table`; raises `ConfigError` for duplicate names."""
        for name in table:
            if name in self.series:
                raise ConfigError(f"{source}: column '{name}' is already in {self.series[name].source}")
        return BoundaryData({**self.series, **table})

    def unit(self, name: str) -> str | None:
        """Return the unit of a weather series or comfort bound; None for others, whose unit no file gives."""
        return "K" if name.startswith(("LowerSetp", "UpperSetp")) else _UNITS.get(name)

    def at(self, name: str, time_s: Array) -> Array:
        """Return the series `name` at times (n,), s since 1 January: weather interpolated linearly, others held.

        A series that covers the year repeats, as in BOPTEST: its last value is that of midnight, followed by the first
        of the new year. Raises `ConfigError` for an unknown series, `WeatherError` for a time outside the file's range.
        """
        if name not in self.series:
            raise ConfigError(f"the FMU's resources have no series '{name}'; known: {', '.join(sorted(self.series))}")
        one = self.series[name]
        time_s = np.asarray(time_s, dtype=np.float64)
        until_s = float(2.0 * one.time_s[-1] - one.time_s[-2])  # the last value holds as long as the one before it
        if until_s >= YEAR_S:
            time_s = np.where(time_s > YEAR_S, np.mod(time_s, YEAR_S), time_s)
        if time_s.size and (time_s.min() < one.time_s[0] - 1e-6 or time_s.max() > until_s + 1e-6):
            raise WeatherError(
                f"{one.source}: '{name}' covers days {one.time_s[0] / DAY_S:g} to {until_s / DAY_S:g}, "
                f"asked for days {time_s.min() / DAY_S:g} to {time_s.max() / DAY_S:g}; choose an earlier window"
            )
        if name in _WEATHER:
            return np.asarray(np.interp(time_s, one.time_s, one.values))
        index = np.searchsorted(one.time_s, time_s + 1e-6, side="right") - 1
        return one.values[np.maximum(index, 0)]

    def require(self, names: Iterable[str], purpose: str) -> None:
        """Raise `ConfigError` if a series needed for `purpose` is missing."""
        missing = [name for name in names if name not in self.series]
        if missing:
            raise ConfigError(f"the FMU's resources have no series {', '.join(missing)}, needed for {purpose}")


def read_table(content: bytes, source: str) -> dict[str, Series]:
    """Return the series of one CSV file; {} for a file without a `time` column, which BOPTEST also ignores.

    A row in which all but the time is empty is left out. Raises `ConfigError`, which names file, column and row, for a
    truncated or malformed file, a cell that is no finite number, or a time that does not increase.
    """
    _check_lines(content, source)
    columns: dict[str, list[Array]] = {}
    try:
        # In parts, so that a cell of text costs memory for a part only.
        with (
            warnings.catch_warnings(),
            pd.read_csv(
                io.BytesIO(content), comment="#", index_col=False, chunksize=_PART_ROWS, low_memory=False
            ) as parts,
        ):
            warnings.simplefilter("error", pd.errors.ParserWarning)
            for part in parts:
                if "time" not in part:
                    return {}
                # A row without any value says nothing; BOPTEST goes on with the one before it.
                part = part[part.drop(columns="time").notna().any(axis=1) | (part.columns.size == 1)]
                for name in part.columns:
                    columns.setdefault(str(name), []).append(_numbers(part[name], source))
    except pd.errors.ParserWarning as error:
        raise ConfigError(f"{source}: its rows have more cells than its header") from error
    except (ValueError, OverflowError) as error:  # pandas' parser errors are ValueErrors
        raise ConfigError(f"{source}: not a CSV file ({error!s:.200})") from error
    arrays = {name: np.concatenate(values) for name, values in columns.items()}
    time_s = arrays.pop("time")
    if time_s.size < 2 or not (np.diff(time_s) > 0).all():
        raise ConfigError(f"{source}: column 'time' must rise over at least two rows")
    return {name: Series(time_s, values, source) for name, values in arrays.items()}


def _numbers(column: pd.Series, source: str) -> Array:
    """Return the numbers of a column; raises `ConfigError` naming the first cell that is none."""
    values: Array = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
    usable = np.abs(values) <= _LARGEST
    if not usable.all():
        at = int(np.argmin(usable))
        what = f"column '{column.name!s:.100}', data row {column.index[at] + 1}: '{column.iloc[at]!s:.60}'"
        raise ConfigError(f"{source}: {what} is no number, or beyond ±{_LARGEST:g}")
    return values


def _check_lines(content: bytes, source: str) -> None:
    """Raise `ConfigError` for what no table of numbers has: lines without end, many of them, open quotes."""
    if content.count(b"\n") > _MOST_ROWS:
        raise ConfigError(f"{source}: more than {_MOST_ROWS:,} rows, two years of minutes")
    characters = np.frombuffer(content, dtype=np.uint8)
    ends = np.concatenate([[-1], np.flatnonzero(characters == ord("\n")), [characters.size]])
    if np.diff(ends).max() > _MOST_LINE_BYTES:
        raise ConfigError(f"{source}: line {int(np.diff(ends).argmax()) + 1} has more than {_MOST_LINE_BYTES:,} bytes")
    quotes = np.bincount(np.searchsorted(ends, np.flatnonzero(characters == ord('"'))), minlength=1)
    if (quotes % 2).any():
        raise ConfigError(f"{source}: line {int((quotes % 2).argmax())}: a quotation mark is not closed")
