"""BOPTEST's boundary data: time series over the year, in CSV files with a `time` column."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.errors import ConfigError, WeatherError

# BOPTEST interpolates these series linearly and holds all others (prices, set-points, occupancy).
_WEATHER = frozenset(
    [
        "HDifHor",
        "HDirNor",
        "HGloHor",
        "HHorIR",
        "TBlaSky",
        "TDewPoi",
        "TDryBul",
        "TWetBul",
        "ceiHei",
        "cloTim",
        "lat",
        "lon",
        "nOpa",
        "nTot",
        "pAtm",
        "relHum",
        "solAlt",
        "solDec",
        "solHouAng",
        "solTim",
        "solZen",
        "winDir",
        "winSpe",
    ]
)
YEAR_S = 365 * DAY_S
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
        """Return the unit of a weather series or comfort bound; None for others, whose unit the file does not give."""
        return "K" if name.startswith(("LowerSetp", "UpperSetp")) else _UNITS.get(name)

    def at(self, name: str, time_s: Array) -> Array:
        """Return the series `name` at times (n,), s since 1 January: weather interpolated linearly, others held.

        A series that covers the year repeats, as in BOPTEST: its last value is that of midnight, followed by the first
        of the new year.

        Raises:
            ConfigError: there is no such series.
            WeatherError: a time lies outside the file's range.
        """
        if name not in self.series:
            raise ConfigError(f"the FMU's resources have no series '{name}'; known: {', '.join(sorted(self.series))}")
        one = self.series[name]
        time_s = np.asarray(time_s, dtype=np.float64)
        until_s = _covered_until(one)
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

    Raises:
        ConfigError: the file is truncated or malformed, a cell is not a finite number, or time does not increase;
            names file, column and row.
    """
    try:
        frame = pd.read_csv(io.BytesIO(content), comment="#")
    except (ValueError, UnicodeDecodeError) as error:  # pandas' parser errors are ValueErrors
        raise ConfigError(f"{source}: not a CSV file ({error})") from error
    if "time" not in frame:
        return {}
    columns = {}
    for name in frame.columns:
        values = pd.to_numeric(frame[name], errors="coerce").to_numpy(dtype=np.float64)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise ConfigError(f"{source}: column '{name}', data row {row + 1}: '{frame[name].iloc[row]}' is no number")
        columns[name] = values
    time_s = columns.pop("time")
    if time_s.size < 2 or not (np.diff(time_s) > 0).all():
        raise ConfigError(f"{source}: column 'time' must rise over at least two rows")
    return {str(name): Series(time_s, values, source) for name, values in columns.items()}


def _covered_until(series: Series) -> float:
    """Return the end of the range, s: the last value holds as long as the one before it."""
    return float(series.time_s[-1] + (series.time_s[-1] - series.time_s[-2]))
