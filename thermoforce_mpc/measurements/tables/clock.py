"""Time stamps of tables to instants in order: formats, numbers, zones, daylight saving, shuffled and repeated rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.entries import Clock
from thermoforce_mpc.measurements.tables.raw_table import RawTable

_ISO = re.compile(r"\s*\d{4}-\d{2}-\d{2}")
_OFFSET = "(?:[+-][0-9]{2}:?[0-9]{2}|Z) *$"
# An offset in whole hours after a time of day, as PostgreSQL, TimescaleDB and DuckDB write them.
_WHOLE_HOURS = r":[0-9]{2}(?:[.,][0-9]+)? ?[+-][0-9]{2} *$"
# Rows looked at for such an offset before all are read.
_LOOKED_AT = 1000
_AN_HOUR = pd.Timedelta("1h")
_MOST_YEARS = 20
# The clock of a table that is being written may be ahead of ours by so much.
_AHEAD = pd.Timedelta("5min")


def instants(table: RawTable, clock: Clock, notes: list[str], now: pd.Timestamp | None = None) -> pd.Series:
    """The instants of a table's rows, in the zone of the map; rows that are left out are missing from its index.

    `now`: the time, with a zone, of a table that is being written; it tells the hour that comes twice apart.
    """
    stamps = table.stamps
    empty = np.flatnonzero(stamps.isna().to_numpy())
    if empty.size:
        raise DataError(
            f"{table.where(int(empty[0]))}: the time stamp is empty ({empty.size} such rows); remove the row"
        )
    if pd.api.types.is_numeric_dtype(stamps):
        times = _counted(table, clock)
    elif pd.api.types.is_datetime64_any_dtype(stamps):
        times = stamps
    else:
        times = _parsed(table, stamps.astype(str), clock)
    if times.dt.tz is not None:
        if clock.zone is not None:
            return times.dt.tz_convert(clock.zone)
        return times
    if clock.zone is None:
        return times
    return _localised(table, times, clock, notes, now)


def _counted(table: RawTable, clock: Clock) -> pd.Series:
    """Numbers as elapsed time: since an instant where `since` has an offset, else on the clock of the map's zone."""
    if clock.unit is None or clock.since is None:
        raise DataError(
            f"{table.name}: the time stamps are numbers (first {table.stamps.iloc[0]:g}); set time.unit (s, ms, min, "
            "h, D) and time.since (what they count from), or name another column as time.column"
        )
    numbers = np.asarray(table.stamps, dtype=np.float64)
    if not np.isfinite(numbers).all():
        row = int(np.argmin(np.isfinite(numbers)))
        raise DataError(f"{table.where(row)}: the time stamp is {numbers[row]:g}; remove the row")
    try:
        return pd.Series(clock.counted_from() + pd.to_timedelta(numbers, unit=clock.unit)).dt.round("1ms")
    except (ValueError, OverflowError) as error:
        row = int(np.argmax(np.abs(numbers)))
        raise DataError(
            f"{table.where(row)}: the time stamp {numbers[row]:.17g} is no date, read in {clock.unit} since "
            f"{clock.since}: check time.unit, or mend the row"
        ) from error


def _parsed(table: RawTable, text: pd.Series, clock: Clock) -> pd.Series:
    form = clock.format or "ISO8601"
    if _in_whole_hours(text.iloc[:: max(1, len(text) // _LOOKED_AT)]):
        text = _with_minutes(text)
    if clock.format is None and not _ISO.match(text.iloc[0]):
        raise DataError(
            f"{table.where(0)}: the time stamp {text.iloc[0]!r} is not of the form 2025-01-31 14:30; set time.format, "
            "such as '%d/%m/%Y %H:%M' (day first) or '%m/%d/%Y %I:%M %p', or name another column as time.column"
        )
    # With daylight saving, offsets differ: those with a zone to come to are read as instants at once.
    as_instants = clock.zone is not None and bool(_with_offset(text.iloc[:1])[0]) and bool(_with_offset(text).all())
    try:
        return pd.to_datetime(text, format=form, utc=as_instants)
    except (ValueError, OverflowError) as error:
        if _in_whole_hours(text):
            return _parsed(table, _with_minutes(text), clock)
        with_one = _with_offset(text)
        if with_one.any() and not with_one.all():
            other = int(np.argmax(with_one != with_one[0]))
            words = ("has none", "has a time zone") if with_one[0] else ("has a time zone", "has none")
            raise DataError(
                f"{table.where(other)}: the time stamp {text.iloc[other]!r} {words[0]}, {text.iloc[0]!r} before it "
                f"{words[1]}: two clocks in one table; write all stamps with an offset, or none"
            ) from error
        times = pd.to_datetime(text, format=form, utc=bool(with_one.all()), errors="coerce")
        wrong = np.flatnonzero(times.isna().to_numpy())
        if wrong.size:
            raise DataError(
                f"{table.where(int(wrong[0]))}: {text.iloc[wrong[0]]!r} is no time stamp of the form "
                f"{clock.format or '2025-01-31 14:30'} ({wrong.size} such rows); mend the row, or set time.format"
            ) from error
        if clock.zone is None:
            kinds = text.str.extract(f"({_OFFSET})", expand=False).str.strip().drop_duplicates()
            second = int(kinds.index[1])
            raise DataError(
                f"{table.where(second)}: the time stamps have the offsets {kinds.iloc[0]} and {kinds.iloc[1]}: "
                "daylight saving, or two time zones; name the building's as time.zone, such as Europe/Brussels"
            ) from error
        return times


def parsed_or_nat(text: pd.Series, clock: Clock) -> pd.Series:
    """Stamps (n,) as text to times of UTC, those without an offset as if they were of UTC; NaT for what is none.

    Of stamps with and without an offset in one table the fewer are none.
    """
    if clock.unit is not None:
        numbers = pd.to_numeric(text, errors="coerce")
        finite = np.isfinite(numbers.to_numpy(dtype=np.float64))
        within = finite & (np.abs(numbers.to_numpy(dtype=np.float64)) < 1e15)
        since = clock.counted_from()
        since = since.tz_localize("UTC") if since.tz is None else since.tz_convert("UTC")
        elapsed = pd.to_timedelta(numbers.where(within), unit=clock.unit, errors="coerce")
        return pd.Series(since + elapsed)
    text = _with_minutes(text.astype(object).where(text.notna(), "").astype(str))
    if clock.format is None:
        text = text.where(text.str.match(_ISO), "")
    at = pd.to_datetime(text, format=clock.format or "ISO8601", utc=True, errors="coerce")
    offset = _with_offset(text)
    read = at.notna().to_numpy()
    fewer = offset if 2 * int((offset & read).sum()) < int(read.sum()) else ~offset
    return at.mask(fewer)


def _in_whole_hours(text: pd.Series) -> bool:
    return bool(text.str.contains(_WHOLE_HOURS, regex=True).any())


def _with_minutes(text: pd.Series) -> pd.Series:
    """Stamps (n,) whose offset in whole hours has minutes: '+01' as '+01:00'."""
    whole = text.str.contains(_WHOLE_HOURS, regex=True)
    return text.where(~whole, text.str.rstrip().str.replace(" +", "+", regex=False).str.replace(" -", "-") + ":00")


def _with_offset(text: pd.Series) -> NDArray[np.bool_]:
    """Which stamps (n,) end with an offset from UTC."""
    return np.asarray(text.str.contains(_OFFSET, regex=True), dtype=bool)


def _localised(
    table: RawTable, times: pd.Series, clock: Clock, notes: list[str], now: pd.Timestamp | None
) -> pd.Series:
    """Stamps of the wall clock as instants, by the rules of the map for the hours of summer time's begin and end."""
    zone = str(clock.zone)
    existing = times.dt.tz_localize(zone, ambiguous=np.ones(len(times), dtype=bool), nonexistent="NaT")
    lost = np.flatnonzero(existing.isna().to_numpy())
    if lost.size:
        what = (
            f"{table.where(int(lost[0]))}: {times.iloc[lost[0]]} does not exist in {zone}, where summer time begins "
            f"({lost.size} such rows)"
        )
        if clock.nonexistent == "refuse":
            raise DataError(
                f"{what}; a clock without summer time is time.zone: {_all_year(zone, times.iloc[0])}, "
                "time.nonexistent: gap leaves the rows out"
            )
        notes.append(f"{what}: left out")
        times = times[existing.notna()]
    rule = {"infer": "infer", "gap": "NaT"}.get(clock.ambiguous)
    try:
        ambiguous = rule or np.full(len(times), clock.ambiguous == "first")
        local = times.dt.tz_localize(zone, ambiguous=ambiguous)
    except ValueError as error:
        if now is not None:
            return _by_the_clock(table, times, zone, notes, now)
        twice = times.dt.tz_localize(zone, ambiguous="NaT")
        row = int(times.index[int(np.argmax(twice.isna().to_numpy()))])
        raise DataError(
            f"{table.where(row)}: {times.loc[row]} comes twice in {zone}, where summer time ends, and the order of the "
            "rows does not tell which it is; set time.ambiguous: first, second or gap, or, for a clock without summer "
            f"time, time.zone: {_all_year(zone, times.iloc[0])}"
        ) from error
    unclear = int(local.isna().sum())
    if unclear:
        notes.append(f"{table.name}: {unclear} rows in the hour that the end of summer time repeats were left out")
    return local[local.notna()]


def _by_the_clock(table: RawTable, times: pd.Series, zone: str, notes: list[str], now: pd.Timestamp) -> pd.Series:
    """Stamps of a table that is being written, whose order does not tell the hour that comes twice, by the time `now`.

    Rows from the last step back on are of its second pass. Without one they are of the first, which is the older, if
    they go on from the row before and nothing came after them; what would lie after now is of the first anyway. Where
    that does not tell it they are left out.
    """
    first, second = (times.dt.tz_localize(zone, ambiguous=np.full(len(times), summer)) for summer in (True, False))
    rows = np.flatnonzero((first != second).to_numpy())
    back = np.flatnonzero(np.diff(times.to_numpy()[rows].astype(np.int64)) < 0)
    what = f"{table.name}: {rows.size} rows in the hour that the end of summer time repeats"
    later = np.zeros(len(times), dtype=bool)
    if back.size:
        later[rows[back[-1] + 1] :] = True
    elif rows[-1] < len(times) - 1:
        notes.append(f"{what}: left out, since their order does not tell which it is")
        local = times.dt.tz_localize(zone, ambiguous="NaT")
        return local[local.notna()]
    elif rows[0] > 0 and first.iloc[rows[0]] - first.iloc[rows[0] - 1] > _AN_HOUR:
        later[rows] = True
    later &= (second <= now + _AHEAD).to_numpy()
    notes.append(f"{what}: told apart by the clock")
    return times.dt.tz_localize(zone, ambiguous=~later)


def _all_year(zone: str, stamp: pd.Timestamp) -> str:
    """The name of the clock that keeps the standard time of `zone` all year."""
    offsets = [pd.Timestamp(year=stamp.year, month=month, day=1, tz=zone).utcoffset() for month in (1, 7)]
    hours = min(offset.total_seconds() for offset in offsets if offset is not None) / 3600.0
    if hours == 0:
        return "UTC"
    return f"Etc/GMT{-hours:+g}" if hours == round(hours) else f"one with an offset of {hours:+g} h"


@dataclass(frozen=True)
class Timed:
    """Columns of tables by name (n,) over increasing instants; `notes`: what was done to rows, in words."""

    index: pd.DatetimeIndex
    columns: dict[str, Array]
    notes: tuple[str, ...] = field(default=())


def timed(tables: Sequence[RawTable], clock: Clock, now: pd.Timestamp | None = None) -> Timed:
    """The rows of `tables` in the order of time, in the zone of the map, without a zone where there is none.

    `now`: the time, of tables that are being written (`instants`).

    Raises `DataError`, with file, line and what to do, for a stamp that cannot be read, is out of order, comes twice or
    does not exist, and for zones that differ.
    """
    notes: list[str] = []
    stamps = [instants(table, clock, notes, now) for table in tables]
    has = [stamp.dt.tz is not None for stamp in stamps]
    if len(set(has)) > 1:
        naive, aware = tables[has.index(False)].name, tables[has.index(True)].name
        raise DataError(
            f"{naive}: its time stamps have no time zone, those of {aware} have one; name time.zone of the map"
        )
    zones = list(dict.fromkeys(str(stamp.dt.tz) for stamp in stamps))
    if len(zones) > 1:
        other = tables[[str(stamp.dt.tz) for stamp in stamps].index(zones[1])].name
        raise DataError(
            f"{other}: its time stamps have the offset {zones[1]}, those of {tables[0].name} {zones[0]}: daylight "
            "saving, or two time zones; name the building's as time.zone, such as Europe/Brussels"
        )
    order = sorted(range(len(stamps)), key=lambda i: stamps[i].iloc[0])
    tables, stamps = [tables[i] for i in order], [stamps[i] for i in order]
    index = pd.DatetimeIndex(pd.concat(stamps, ignore_index=True))
    columns = {
        name: np.concatenate([t.columns[name][s.index] for t, s in zip(tables, stamps, strict=True)])
        for name in tables[0].columns
    }
    keep = _in_order(index, clock, partial(_place, tables, stamps), notes)
    if keep is not None:
        index, columns = index[keep], {name: values[keep] for name, values in columns.items()}
    if (years := (index[-1] - index[0]).days / 365.0) > _MOST_YEARS:
        row = int(np.argmax(np.diff(index.asi8)))
        raise DataError(
            f"{tables[0].name}: {years:.0f} years from {index[0]} to {index[-1]}, the longest gap from {index[row]} to "
            f"{index[row + 1]}: mend the time stamp that is wrong, or give {_MOST_YEARS} years at most"
        )
    return Timed(index, columns, tuple(notes))


def _place(tables: Sequence[RawTable], stamps: Sequence[pd.Series], row: int) -> str:
    """Where a row of several tables stands."""
    for table, of_table in zip(tables, stamps, strict=True):
        if row < len(of_table):
            return table.where(int(of_table.index[row]))
        row -= len(of_table)
    return tables[-1].name


def _in_order(
    index: pd.DatetimeIndex, clock: Clock, where: Callable[[int], str], notes: list[str]
) -> NDArray[np.intp] | None:
    """The rows to keep in the order to keep them, None where all stand as they should."""
    at = index.asi8
    keep = np.arange(at.size)
    back = np.flatnonzero(np.diff(at) < 0)
    if back.size:
        row = int(back[0]) + 1
        autumn = index[row - 1] - index[row] < _AN_HOUR * 1.01
        what = f"{where(row)}: {index[row]} comes after {index[row - 1]}; {back.size} such rows"
        if clock.order == "refuse":
            hint = "; if it is the end of summer time, name time.zone" if autumn and clock.zone is None else ""
            raise DataError(f"{what}: sort the table, or set time.order: sort{hint}")
        keep = np.argsort(at, kind="stable")
        at = at[keep]
        notes.append(f"{what}: sorted")
    same = np.flatnonzero(np.diff(at) == 0)
    if same.size:
        first, second = (int(keep[same[0] + i]) for i in (0, 1))
        what = f"{where(second)}: {index[second]} stands at {where(first)} too; {same.size} such rows"
        if clock.duplicates == "refuse":
            raise DataError(f"{what}: remove one of them, or set time.duplicates: first or last")
        drop = same + 1 if clock.duplicates == "first" else same
        keep = np.delete(keep, drop)
        notes.append(f"{what}: the {clock.duplicates} one kept")
    return keep if back.size or same.size else None
