"""Tables of time stamps as arrays, and back: pandas at the door, seconds and numbers inside."""

from __future__ import annotations

import re
from datetime import datetime
from numbers import Real

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data.clock import DAY_S
from thermoforce_mpc.data.limits import LEVEL, RULES, outside
from thermoforce_mpc.errors import DataError, check_kind, suggestion

# pandas takes 03.04.2026 for March and 25.03.2026 for March too.
_YEAR_LAST = re.compile(r"\s*\d{1,2}[./-]\d{1,2}[./-]\d{2,4}\b")

# What is probably wrong with a column of which most is impossible.
_REMEDIES = {
    "temperature": "convert K by x - 273.15, °F by (x - 32) / 1.8, or is it another column?",
    "level": "divide % by 100, or is it a set-point or a power?",
    "irradiance": "convert kW/m² or J/m² to W/m², or is it another column?",
}


def check_table(df: object, what: str) -> None:
    """Raise `DataError` where what is given as the table of `what` is no data frame."""
    remedy = "read a file by pd.read_csv(file, index_col=0, parse_dates=True), make one of a Series by .to_frame(name)"
    check_kind(df, pd.DataFrame, f"{what}: the table", remedy)


def new_year(index: pd.Index, what: str) -> pd.Timestamp:
    """1 January 00:00 of the year in which `index` begins, on its zone's clock of that day: where `time_s` counts from.

    In the south that is summer time: days counted from it begin at 23:00 all winter. Raises `DataError` for an index
    that holds no time stamps, NaT, or nothing.
    """
    return _stamped(index, what)[0]


def _stamped(index: pd.Index, what: str) -> tuple[pd.Timestamp, pd.DatetimeIndex]:
    """The new year of `index`, and itself; raises `DataError`, see `new_year`."""
    if not isinstance(index, pd.DatetimeIndex):
        if len(index) and isinstance(index[0], str | datetime) and str(index[0])[:4].isdigit():
            raise DataError(
                f"{what}: the index holds {index[0]!r} and the like as {index.dtype}, not time stamps: pandas leaves "
                "stamps whose offset changes, as with summer time, and such that it cannot read; set "
                "df.index = pd.to_datetime(df.index, utc=True).tz_convert('Europe/Brussels'), or your zone"
            )
        raise DataError(
            f"{what}: the index holds {index.dtype}, not time stamps; read it with "
            "pd.read_csv(..., index_col=0, parse_dates=True) or set it with df.set_index(pd.to_datetime(df[column]))"
        )
    if index.empty:
        raise DataError(f"{what}: the table has no rows")
    if index.hasnans:
        raise DataError(f"{what}: time stamp {int(np.flatnonzero(index.isna())[0])} is NaT; drop or mend that row")
    return pd.Timestamp(year=index[0].year, month=1, day=1, tz=index.tz), index


def seconds_since(origin: pd.Timestamp, index: pd.Index, what: str) -> NDArray[np.float64]:
    """Seconds from `origin` to each stamp of `index`, shape (n,): elapsed time, so summer time makes no jump.

    Raises `DataError` where the index holds no time stamps, or only one of `origin` and `index` has a time zone.
    """
    _, at = _stamped(index, what)
    if (at.tz is None) != (origin.tz is None):
        has, has_not = (what, "the record") if at.tz is not None else ("the record", what)
        raise DataError(f"time zones: {has} has one and {has_not} has none; use df.tz_localize(...) on the latter")
    return np.asarray((at - origin) / pd.Timedelta(seconds=1), dtype=np.float64)


def time_told(time: pd.Timestamp | str, what: str) -> pd.Timestamp:
    """A time as people write it, the year first; raises `DataError` for others, of which 03.04.2026 may be two days."""
    if isinstance(time, str) and _YEAR_LAST.match(time):
        raise DataError(f"{what} '{time}': is its day or its month first? write it as 2026-01-20 14:30")
    try:
        at = pd.Timestamp(time)
    except (ValueError, TypeError) as error:
        raise DataError(f"{what} '{time}' is not a time stamp: write for example 2026-01-20 00:00") from error
    if pd.isna(at):
        raise DataError(f"{what} '{time}' is not a time stamp: write for example 2026-01-20 00:00")
    return at


def seconds_at(origin: pd.Timestamp, time: pd.Timestamp | str, what: str) -> float:
    """Seconds from `origin` to a time as people write it, on the clock of `origin` where it has no offset.

    Of an hour that the end of summer time repeats, the first is meant. Raises `DataError` for what is no time stamp,
    does not exist on that clock, or has a zone where `origin` has none.
    """
    at = time_told(time, what)
    if at.tz is not None and origin.tz is None:
        raise DataError(f"{what} '{time}' has a time zone and the record has none: write it without")
    if at.tz is None and origin.tz is not None:
        localised = at.tz_localize(origin.tz, ambiguous=True, nonexistent="NaT")
        if not isinstance(localised, pd.Timestamp):  # NaT
            raise DataError(
                f"{what} '{time}' does not exist in {origin.tz}, where summer time begins: name a time before or after "
                "that hour"
            )
        at = localised
    return float((at - origin).total_seconds())


def stamps(time_s: NDArray[np.float64], origin: pd.Timestamp | None) -> pd.Index:
    """Time stamps of `time_s` (n,), in the zone of `origin`; the seconds themselves where there is no origin."""
    if origin is None:
        return pd.Index(time_s, name="time_s")
    return pd.DatetimeIndex(origin + pd.to_timedelta(np.round(time_s, 3), unit="s"), name="time")


def clock_s(time_s: NDArray[np.float64], origin: pd.Timestamp | None) -> NDArray[np.float64]:
    """What the clock of the zone of `origin` shows at `time_s` (n,), s from `origin`: in summer time an hour more.

    People and tariffs go by it. Where there is no zone, `time_s`.
    """
    if origin is None or origin.tz is None or not time_s.size:
        return time_s
    at = pd.DatetimeIndex(stamps(time_s, origin))
    ahead = (at.tz_localize(None) - at.tz_convert("UTC").tz_localize(None)).total_seconds().to_numpy()
    offset = origin.utcoffset()
    assert offset is not None
    return np.asarray(time_s + ahead - offset.total_seconds())


def days_before_s(time_s: NDArray[np.float64], days: int, origin: pd.Timestamp | None) -> NDArray[np.float64]:
    """When the clock showed the same as at `time_s` (n,), s from `origin`, `days` days before."""
    then = time_s - days * DAY_S
    moved = (clock_s(time_s, origin) - time_s) - (clock_s(then, origin) - then)
    return np.asarray(then + moved)


def table(time_s: NDArray[np.float64], origin: pd.Timestamp | None, **columns: NDArray[np.float64]) -> pd.DataFrame:
    """A table of `columns` (n,) by name over `stamps`."""
    return pd.DataFrame(columns, index=stamps(time_s, origin))


def column(df: pd.DataFrame, name: str, what: str) -> NDArray[np.float64]:
    """The numbers of a column, shape (n,), NaN where a cell is empty; raises `DataError` where it is none."""
    if name not in df.columns:
        names = [str(key) for key in df.columns]
        raise DataError(f"{what}: no column '{name}'{suggestion(str(name), names)}; there are {', '.join(names)}")
    if isinstance(df[name], pd.DataFrame):
        raise DataError(f"{what}: there are {df[name].shape[1]} columns '{name}'; give each a name of its own")
    try:
        return np.asarray(pd.to_numeric(df[name]), dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise DataError(f"{what}: column '{name}' holds a cell that is no number ({error})") from error


def series(df: pd.DataFrame, source: str | float | None, what: str, argument: str) -> NDArray[np.float64]:
    """A column by name, one number for all rows, or NaN for all where None is given; shape (n,).

    Raises `DataError` for what is none of them, naming `what` it is of and the `argument`.
    """
    if isinstance(source, str):
        return column(df, source, what)
    if source is not None and (isinstance(source, bool | np.bool_) or not isinstance(source, Real)):
        raise DataError(
            f"{what}: {argument} is a {type(source).__name__}, expected the name of a column, or one number: put "
            f"values into the table, by their time stamps (df['{argument}'] = ...), and give {argument}='{argument}'"
        )
    return np.full(len(df), np.nan if source is None else float(source))


def measured_column(df: pd.DataFrame, name: str, what: str, argument: str, signal: str) -> NDArray[np.float64]:
    """A column of readings of a signal of `limits.RULES`, shape (n,).

    Raises `DataError` where it is none, or most cells (zeros do not count) are impossible: another unit, or column.
    """
    check_kind(name, str, f"{what}: {argument}", "give the name of a column")
    values, rule = column(df, name, what), RULES[signal]
    low, high = (-LEVEL[1], LEVEL[1]) if signal == "u" else rule.range
    known = np.flatnonzero(np.isfinite(values) & (values != 0.0))
    wrong = known[outside(values[known], (low, high))]
    if 2 * wrong.size > known.size:
        k = int(wrong[0])
        raise DataError(
            f"{what}: {argument}: column '{name}': {wrong.size} of {known.size} cells are no {rule.kind} between "
            f"{low:.4g} and {high:.4g} {rule.unit}".rstrip()
            + f", first {values[k]:.6g} at {df.index[k]}: {_REMEDIES.get(rule.kind, 'is it another column?')}"
        )
    return values
