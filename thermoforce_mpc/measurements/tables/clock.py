"""Time stamps of tables to instants in order: formats, numbers, zones, daylight saving, shuffled and repeated rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.tables.forms import TimeStampRules
from thermoforce_mpc.measurements.tables.raw_table import ISO, OFFSET, RawTable, full_offsets, with_offset

# Months by how their names begin, in English, German, French, Dutch, Italian and Spanish, without accents.
_MONTHS = (
    "jan|gen|ene", "feb|fev", "mar|maa|mrt|mae", "apr|avr|abr", "may|mai|mei|mag|maj", "jun|juin|giu", "jul|juil|lug",
    "aug|aou|ago", "sep|set", "oct|okt|ott", "nov", "dec|dez|dic",
)  # fmt: skip
_ENGLISH = (
    "January", "February", "March", "April", "May", "June", "July", "August", "September", "October", "November",
    "December",
)  # fmt: skip
# Weekdays before a date, in the same languages; the French mar. is March where no date in digits follows.
_DAY_OF_WEEK = (
    r"(?i)^\s*(?:monday|tuesday|wednesday|thursday|friday|saturday|sunday|mon|tues?|wed|thu(?:rs?)?|fri|sat|sun|"
    r"montag|dienstag|mittwoch|donnerstag|freitag|samstag|sonnabend|sonntag|mo|di|mi|do|fr|sa|so|"
    r"lundi|mardi|mercredi|jeudi|vendredi|samedi|dimanche|lun|mer|jeu|ven|sam|dim|mar(?=\.?,? \d+[./-]\d)|"
    r"maandag|dinsdag|woensdag|donderdag|vrijdag|zaterdag|zondag|ma|wo|vr|za|zo|"
    r"lunes|martes|mi[eé]rcoles|jueves|viernes|s[aá]bado|domingo|"
    r"luned[iì]|marted[iì]|mercoled[iì]|gioved[iì]|venerd[iì]|sabato|domenica)[.,]{0,2}\s+(?=\d)"
)
# Words between a date and a time of day.
_BEFORE_CLOCK = re.compile(r"(?i),?\s(?:kl\.?|um|at|à|om|alle|a las|klo)\s+(?=\d)")
# Hours ahead of UTC of what clocks are called.
_CLOCKS = {
    "UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "BST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3,
    "EST": -5, "EDT": -4, "CST": -6, "CDT": -5, "MST": -7, "MDT": -6, "PST": -8, "PDT": -7,
}  # fmt: skip
# More ends than this are ends of intervals; offsets from UTC are fewer.
_MOST_OFFSETS = 4
# From so many rows on a table is one whose newest row stands first, and so few of its rows rise all the same.
_LEAST_FALLS, _FEW_RISE = 7, 0.005
_HALF_A_YEAR = 5
_AN_HOUR = pd.Timedelta("1h")
# Rows that go on from one another are no farther apart than so many of their usual distances.
_GOES_ON = 1.5
_MOST_YEARS = 20
LATE = r"(?<=[ T])24:00(?=\D|$)"
"""Midnight at the end of a day."""
# The clock of a table that is being written may be ahead of ours by so much.
_AHEAD = pd.Timedelta("5min")
# Share of the stamps of two files from which they stand beside one another rather than overlap at their ends.
_MOST_SHARED = 0.5


def instants(table: RawTable, clock: TimeStampRules, notes: list[str], now: pd.Timestamp | None = None) -> pd.Series:
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
        text = stamps.astype(str) if clock.year is None else with_year(stamps.astype(str), clock.year)
        times = _parsed(table, plain(text, clock.format), clock)
    if newest_first(times):
        times = times.iloc[::-1]
        notes.append(f"{table.name}: its newest row stands first: turned round")
    if times.dt.tz is not None:
        if clock.zone is not None:
            return times.dt.tz_convert(clock.zone)
        return times
    if clock.zone is None:
        return times
    return _localised(table, times, clock, notes, now)


def newest_first(times: pd.Series | NDArray[np.float64]) -> bool:
    """Whether times (n,), instants or s, fall throughout; the hour that comes twice in autumn may rise once."""
    at = pd.DatetimeIndex(times).as_unit("ns").asi8 if isinstance(times, pd.Series) else times
    steps = np.diff(at)
    return bool(
        steps.size >= _LEAST_FALLS
        and (steps < 0).any()
        and (steps > 0).sum() <= max(1, _FEW_RISE * steps.size)
        and at[-1] < at[0]
    )


def _counted(table: RawTable, clock: TimeStampRules) -> pd.Series:
    """Numbers as elapsed time: since an instant where `since` has an offset, else on the clock of the map's zone.

    Days of a calendar are times without a zone.
    """
    if clock.unit is None or clock.since is None:
        raise DataError(
            f"{table.name}: the time stamps are numbers (first {table.stamps.iloc[0]:g}); set time.unit (s, ms, us, "
            "ns, min, h, D) and time.since (what they count from), or name another column as time.column"
        )
    numbers = np.asarray(table.stamps, dtype=np.float64)
    if not np.isfinite(numbers).all():
        row = int(np.argmin(np.isfinite(numbers)))
        raise DataError(f"{table.where(row)}: the time stamp is {numbers[row]:g}; remove the row")
    try:
        times = pd.Series(clock.counted_from() + pd.to_timedelta(numbers, unit=clock.unit)).dt.round("1ms")
        # Days with five decimals, as a spreadsheet writes them, are minutes to within a second.
        minutes = times.dt.round("1min")
        of_minutes = clock.of_calendar and ((times - minutes).abs() < pd.Timedelta("1s")).all()
        return minutes if of_minutes else times
    except (ValueError, OverflowError) as error:
        row = int(np.argmax(np.abs(numbers)))
        raise DataError(
            f"{table.where(row)}: the time stamp {numbers[row]:.17g} is no date, read in {clock.unit} since "
            f"{clock.since}: check time.unit, or mend the row"
        ) from error


def _parsed(table: RawTable, text: pd.Series, clock: TimeStampRules) -> pd.Series:
    form = clock.format or "ISO8601"
    if clock.format is None and not ISO.match(text.iloc[0]):
        raise DataError(
            f"{table.where(0)}: the time stamp {text.iloc[0]!r} is not of the form 2025-01-31 14:30; set time.format, "
            "such as '%d/%m/%Y %H:%M' (day first) or '%m/%d/%Y %I:%M %p', or name another column as time.column"
        )
    # With daylight saving, offsets differ: those with a zone to come to are read as instants at once.
    as_instants = clock.zone is not None and bool(with_offset(text.iloc[:1])[0]) and bool(with_offset(text).all())
    try:
        return times_of(text, form, utc=as_instants)
    except (ValueError, OverflowError) as error:
        with_one = with_offset(text)
        if with_one.any() and not with_one.all():
            other = int(np.argmax(with_one != with_one[0]))
            words = ("has none", "has a time zone") if with_one[0] else ("has a time zone", "has none")
            raise DataError(
                f"{table.where(other)}: the time stamp {text.iloc[other]!r} {words[0]}, {text.iloc[0]!r} before it "
                f"{words[1]}: two clocks in one table; write all stamps with an offset, or none"
            ) from error
        times = times_of(text, form, utc=bool(with_one.all()), errors="coerce")
        wrong = np.flatnonzero(times.isna().to_numpy())
        if wrong.size:
            raise DataError(
                f"{table.where(int(wrong[0]))}: {text.iloc[wrong[0]]!r} is no time stamp of the form "
                f"{clock.format or '2025-01-31 14:30'} ({wrong.size} such rows); mend the row, or set time.format"
            ) from error
        if clock.zone is None:
            kinds = text.str.extract(f"({OFFSET})", expand=False).str.strip().drop_duplicates()
            second = int(kinds.index[1])
            raise DataError(
                f"{table.where(second)}: the time stamps have the offsets {kinds.iloc[0]} and {kinds.iloc[1]}: "
                "daylight saving, or two time zones; name the building's as time.zone, such as Europe/Brussels"
            ) from error
        return times


def parsed_or_nat(text: pd.Series, clock: TimeStampRules) -> tuple[pd.Series, NDArray[np.bool_]]:
    """Stamps (n,) to times of UTC, NaT for what is none, and which have an offset; others as if they were of UTC."""
    if pd.api.types.is_datetime64_any_dtype(text):
        at = text.dt.tz_localize("UTC") if text.dt.tz is None else text.dt.tz_convert("UTC")
        return at, np.full(len(text), text.dt.tz is not None)
    if clock.unit is not None:
        numbers = pd.to_numeric(text, errors="coerce")
        finite = np.isfinite(numbers.to_numpy(dtype=np.float64))
        most = 9e18 if clock.unit in ("us", "ns") else 1e15
        within = finite & (np.abs(numbers.to_numpy(dtype=np.float64)) < most)
        since = clock.counted_from()
        since = since.tz_localize("UTC") if since.tz is None else since.tz_convert("UTC")
        elapsed = pd.to_timedelta(numbers.where(within), unit=clock.unit, errors="coerce")
        return pd.Series(since + elapsed), np.zeros(len(text), dtype=bool)
    text = text.astype(object).where(text.notna(), "").astype(str)
    text = text if clock.year is None else with_year(text, clock.year)
    text = plain(text, clock.format) if len(text) else text
    if clock.format is None:
        text = text.where(text.str.match(ISO), "")
    return times_of(text, clock.format or "ISO8601", utc=True, errors="coerce"), with_offset(text)


def times_of(text: pd.Series, form: str, *, utc: bool, errors: Literal["raise", "coerce"] = "raise") -> pd.Series:
    """Stamps (n,) by a `strptime` format or "ISO8601", as by `pandas.to_datetime`; 24:00 is the end of its day."""
    late = text.str.contains(LATE, regex=True) if "24:00" in "\n".join(text.tolist()) else None
    if late is None or not late.any():
        return pd.to_datetime(text, format=form, utc=utc, errors=errors)
    at = pd.to_datetime(text.str.replace(LATE, "00:00", regex=True), format=form, utc=utc, errors=errors)
    return at + pd.Timedelta("1D") * late.astype(int)


def plain(text: pd.Series, form: str | None = None) -> pd.Series:
    """Stamps (n,) of text as `strptime` knows them: of intervals the beginning, months in English, offsets in digits.

    Months have three letters, or with %B in `form` all of them. Names of weekdays before a date are left out, unless %a
    or %A in `form` reads them; a.m. becomes am.
    """
    first = str(text.iloc[0])
    if re.search(r":\d\d\D*(?:-|–|—|/| to | bis | tot | à | t/m )\D*\d", first):
        text = _beginnings(text)
        first = str(text.iloc[0])
    if first.rstrip().endswith("]"):  # Java writes the zone's name behind the offset
        text = text.str.replace(r"(?<=\d|Z)\[[\w/+-]+\]\s*$", "", regex=True)
    if _BEFORE_CLOCK.search(first):
        text = text.str.replace(_BEFORE_CLOCK, " ", regex=True)
    if re.search(r"(?i)[ap]\.\s?m\b", first):
        text = text.str.replace(r"(?i)\b([ap])\.\s?m\.?", r"\1M", regex=True)
    whole = "\n".join(text.tolist())  # one look at all tells what few have: a log has hundreds of thousands
    if (not form or not re.search("%[aA]", form)) and re.search(r"(?m)^\s*[A-Za-z]", whole):
        text = text.str.replace(_DAY_OF_WEEK, "", regex=True)
        first = str(text.iloc[0])
    if re.search(r"[A-Za-zäéûô]{3,}", first):
        told = pd.unique(text.str.replace(r"[^A-Za-zÀ-ÿ]+", " ", regex=True))
        words = dict.fromkeys(word for one in told for word in str(one).split() if len(word) > 2)
        for word in words:
            if (other := _in_digits(word, form)) is not None:
                text = text.str.replace(rf"\b{word}\b\.?" if other.isalpha() else rf" ?\b{word}\b", other, regex=True)
    return full_offsets(text)


def with_year(text: pd.Series, year: int) -> pd.Series:
    """Stamps (n,) of the form ' 01/31  24:00:00' (EnergyPlus: month, day) as 2025-01-31 24:00:00; others as they are.

    The first is of `year`; a month that falls by six and more is of the next one.
    """
    parts = text.str.extract(r"^\s*(\d{1,2})[/.-](\d{1,2})\s+(\d{1,2}:\d{2}(?::\d{2})?)\s*$")
    known = parts[0].notna()
    months = parts[0][known].astype(int)
    years = year + (months.diff() < -_HALF_A_YEAR).cumsum()
    days = years.astype(str) + "-" + months.astype(str).str.zfill(2) + "-" + parts[1][known].str.zfill(2)
    out = text.copy()
    out[known] = days + " " + parts[2][known].str.zfill(5)
    return out


def _beginnings(text: pd.Series) -> pd.Series:
    """The first of two times in each stamp; stamps with an offset from UTC are left as they are."""
    parts = text.str.extract(
        r"^(.*?\d:\d\d(?::\d\d)?(?: ?[AaPp]\.?[Mm]\.?)?)\s*(?:-|–|—|/|to|bis|tot|à|t/m)\s*([^+-]*\d.*)$"
    )
    if parts[0].isna().any() or parts[1].nunique() <= min(_MOST_OFFSETS, len(text) - 1):
        return text
    tail = parts[1].str.extract(r"\(?([A-Z]{3,4})\)?$", expand=False)
    return parts[0].str.cat(tail, sep=" ") if tail.notna().all() else parts[0]


def _in_digits(word: str, form: str | None) -> str | None:
    """What `strptime` knows for the name of a month or a clock, None for other words."""
    if word.upper() in _CLOCKS and word.isupper():
        return f" {_CLOCKS[word]:+03d}00"
    if word.lower() in ("uhr", "heure", "uur", "ore", "horas"):
        return ""
    bare = word.lower().translate(str.maketrans("äéèûôç", "aeeuoc"))
    for month, begins in zip(_ENGLISH, _MONTHS, strict=True):
        if re.match(begins, bare):
            return month if form is not None and "%B" in form else month[:3]
    return None


def _localised(
    table: RawTable, times: pd.Series, clock: TimeStampRules, notes: list[str], now: pd.Timestamp | None
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
                f"{what}; a clock without summer time is time.zone: {all_year(zone, times.iloc[0])}, "
                "time.nonexistent: gap leaves the rows out"
            )
        notes.append(Note(f"{what}: left out", f"{table.name}: where summer time begins", lost.size))
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
            f"time, time.zone: {all_year(zone, times.iloc[0])}"
        ) from error
    unclear = int(local.isna().sum())
    if unclear:
        text = f"{table.name}: {unclear} rows in the hour that the end of summer time repeats were left out"
        notes.append(Note(text, f"{table.name}: where summer time ends", unclear))
    return local[local.notna()]


def _by_the_clock(table: RawTable, times: pd.Series, zone: str, notes: list[str], now: pd.Timestamp) -> pd.Series:
    """Stamps of a table that is being written, whose order does not tell the hour that comes twice, by the time `now`.

    Rows from the last step back on are of its second pass. Without one they are of the first, which is the older, if
    they go on from the row before and nothing came after them; a table that begins with them, such as a forecast made
    in that hour, goes on from the second. What would lie after now is of the first anyway. Where that does not tell it
    they are left out.
    """
    first, second = (times.dt.tz_localize(zone, ambiguous=np.full(len(times), summer)) for summer in (True, False))
    rows = np.flatnonzero((first != second).to_numpy())
    back = np.flatnonzero(np.diff(times.to_numpy()[rows].astype(np.int64)) < 0)
    matter = f"{table.name}: where summer time ends"
    what = f"{table.name}: {rows.size} rows in the hour that the end of summer time repeats"
    later = np.zeros(len(times), dtype=bool)
    if back.size:
        later[rows[back[-1] + 1] :] = True
    elif rows[0] == 0 and rows[-1] < len(times) - 1:
        goes_on = second.iloc[rows[-1] + 1] - second.iloc[rows[-1]]
        later[rows] = goes_on <= _GOES_ON * times.diff().median()
        notes.append(Note(f"{what}: told apart by what comes after", matter, rows.size))
        return times.dt.tz_localize(zone, ambiguous=~later)
    elif rows[-1] < len(times) - 1:
        text = f"{what}: left out, since their order does not tell which it is"
        notes.append(Note(text, f"{matter}, left out", rows.size))
        local = times.dt.tz_localize(zone, ambiguous="NaT")
        return local[local.notna()]
    elif rows[0] > 0 and first.iloc[rows[0]] - first.iloc[rows[0] - 1] > _AN_HOUR:
        later[rows] = True
    later &= (second <= now + _AHEAD).to_numpy()
    notes.append(Note(f"{what}: told apart by the clock", matter, rows.size))
    return times.dt.tz_localize(zone, ambiguous=~later)


def all_year(zone: str, stamp: pd.Timestamp) -> str:
    """The name of the clock that keeps the standard time of `zone` all year."""
    offsets = [pd.Timestamp(year=stamp.year, month=month, day=1, tz=zone).utcoffset() for month in (1, 7)]
    hours = min(offset.total_seconds() for offset in offsets if offset is not None) / 3600.0
    if hours == 0:
        return "UTC"
    return f"Etc/GMT{-hours:+g}" if hours == round(hours) else f"one with an offset of {hours:+g} h"


@dataclass(frozen=True)
class Timed:
    """Columns of tables by name over increasing instants; `notes`: what was done to rows, in words.

    `columns` (n,) stand at `index` (n,), but for those with instants of their `own`, of which each row is a reading:
    NaN says there that the signal was not available from then on. `beside`: first readings of signals that the map does
    not name, where each row is one reading. `marks`: the end of an interval that the stamps of a column mark, by file.
    """

    index: pd.DatetimeIndex
    columns: dict[str, Array]
    notes: tuple[str, ...] = field(default=())
    own: dict[str, pd.DatetimeIndex] = field(default_factory=dict)
    beside: dict[str, Array] = field(default_factory=dict)
    marks: dict[str, Literal["start", "end"]] = field(default_factory=dict)

    def at(self, name: str) -> pd.DatetimeIndex:
        """The instants of a column."""
        return self.own.get(name, self.index)

    @property
    def every_s(self) -> float:
        """Usual distance of rows, s: of columns with instants of their own, that of the densest; NaN for one row."""
        of = list(self.own.values()) or [self.index]
        usual = [np.median(np.diff(one.as_unit("ns").asi8)) / 1e9 for one in of if len(one) > 1]
        return float(min(usual, default=np.nan))


def timed(tables: Sequence[RawTable], clock: TimeStampRules, now: pd.Timestamp | None = None) -> Timed:
    """The rows of `tables` in the order of time, in the zone of the map, without a zone where there is none.

    Tables with the same columns follow one another; others stand beside, and their columns keep instants of their own.
    `now`: the time, of tables that are being written (`instants`).

    Raises `DataError`, with file, line and what to do, for a stamp that cannot be read, is out of order, comes twice or
    does not exist, and for zones that differ.
    """
    notes: list[str] = []
    stamps = []
    for table in tables:
        read = _instants_of_readings if table.codes is not None else instants
        at = read(table, table.clock or clock, notes, now)
        stamps.append(at.dt.tz_convert(clock.zone) if clock.zone is not None and at.dt.tz is not None else at)
    marks = {name: table.clock.marks for table in tables if table.clock is not None for name in table.names}
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
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, table in enumerate(tables):
        if table.codes is None:
            alike.setdefault(tuple(table.columns), []).append(i)
    parts = [
        _after_one_another([tables[i] for i in of], [stamps[i] for i in of], tables[of[0]].clock or clock, notes)
        for of in alike.values()
    ]
    if len(parts) == 1 and len(alike) and all(table.codes is None for table in tables):
        index, columns = parts[0]
        _check_years(index, tables[0].name)
        return Timed(index, columns, tuple(notes), marks=marks)
    found: dict[str, list[tuple[pd.DatetimeIndex, Array]]] = {}
    for index, columns in parts:
        for name, values in columns.items():
            known = np.isfinite(values)  # an empty cell of a wide table says nothing
            found.setdefault(name, []).append((index[known], values[known]))
    for table, stamp in zip(tables, stamps, strict=True):
        if table.codes is not None:
            codes, values, index = table.codes[stamp.index], table.columns[""][stamp.index], pd.DatetimeIndex(stamp)
            for k, name in enumerate(table.points):
                found.setdefault(name, []).append((index[codes == k], values[codes == k]))
    own: dict[str, pd.DatetimeIndex] = {}
    columns = {}
    for name, pieces in found.items():
        index = pd.DatetimeIndex(np.concatenate([one.as_unit("ns").asi8 for one, _ in pieces]))
        index = index.tz_localize("UTC").tz_convert(stamps[0].dt.tz) if has[0] else index
        values = np.concatenate([one for _, one in pieces])
        order = np.lexsort((np.isfinite(values), index.asi8))
        # Of two at one instant the later reading counts; of a signal all rows may have been left out.
        order = order[np.append(np.diff(index.asi8[order]) > 0, True)[: order.size]]
        own[name], columns[name] = index[order], values[order]
    outages = [one for table in tables for one in table.outages]
    for begin, end in outages:
        notes.append(f"{tables[0].name}: nothing at all was stored from {begin} to {end}: a gap of every signal")
        for name, index in own.items():
            k = int(index.searchsorted(begin, side="right"))
            if k and (k == len(index) or index[k] >= end):
                own[name] = index.insert(k, begin + pd.Timedelta("1ms"))
                columns[name] = np.insert(columns[name], k, np.nan)
    union = pd.DatetimeIndex(np.unique(np.concatenate([one.asi8 for one in own.values()])))
    union = union.tz_localize("UTC").tz_convert(stamps[0].dt.tz) if has[0] else union
    if not len(union):
        raise DataError(f"{tables[0].name}: the columns of the map hold no reading")
    _check_years(union, tables[0].name)
    beside = {name: values for table in tables for name, values in table.beside.items() if name not in own}
    return Timed(union, columns, tuple(notes), own, beside, marks)


def _instants_of_readings(
    table: RawTable, clock: TimeStampRules, notes: list[str], now: pd.Timestamp | None
) -> pd.Series:
    """Instants of a table of one reading a row; each signal's rows tell which of the two hours in autumn they mean."""
    of_wall_clock = not pd.api.types.is_numeric_dtype(table.stamps) and clock.zone is not None
    if not of_wall_clock or getattr(table.stamps.dtype, "tz", None) is not None or table.codes is None:
        return instants(table, clock, notes, now)
    rows = [np.flatnonzero(table.codes == k) for k in range(len(table.points))]
    lines = table.line if not isinstance(table.line, int) else table.line + np.arange(len(table.stamps))
    found = []
    for of in rows:
        if of.size:
            one = replace(table, stamps=table.stamps.iloc[of].reset_index(drop=True), line=lines[of])
            at = instants(one, clock, notes, now)
            found.append(at.set_axis(of[at.index]))
    return pd.concat(found).sort_index()


def _after_one_another(
    tables: Sequence[RawTable], stamps: Sequence[pd.Series], clock: TimeStampRules, notes: list[str]
) -> tuple[pd.DatetimeIndex, dict[str, Array]]:
    """Instants and columns of tables with the same columns."""
    order = sorted(range(len(stamps)), key=lambda i: stamps[i].iloc[0])
    tables, stamps = [tables[i] for i in order], [stamps[i] for i in order]
    index = pd.DatetimeIndex(pd.concat(stamps, ignore_index=True))
    columns = {
        name: np.concatenate([t.columns[name][s.index] for t, s in zip(tables, stamps, strict=True)])
        for name in tables[0].columns
    }
    where = partial(_place, tables, stamps)
    if len({table.name for table in tables}) > 1:
        kept = _once(index, columns, tables, stamps, clock, where, notes)
        index, columns = index[kept], {name: values[kept] for name, values in columns.items()}
        where = partial(_place_of, where, kept)
    keep = _in_order(index, clock, where, notes)
    if keep is not None:
        index, columns = index[keep], {name: values[keep] for name, values in columns.items()}
    return index, columns


def _once(
    index: pd.DatetimeIndex,
    columns: dict[str, Array],
    tables: Sequence[RawTable],
    stamps: Sequence[pd.Series],
    clock: TimeStampRules,
    where: Callable[[int], str],
    notes: list[str],
) -> NDArray[np.intp]:
    """The rows to keep of files that overlap: of rows at one time in two files one, if they say the same.

    What one of both does not say is filled in from the other. Raises `DataError` where they differ, unless the map says
    which counts, and for files that say throughout something else at the same times.
    """
    file = np.repeat(np.arange(len(tables)), [len(one) for one in stamps])
    names = np.array([table.name for table in tables])[file]
    order = np.lexsort((file, index.asi8))
    pair = np.flatnonzero((np.diff(index.asi8[order]) == 0) & (names[order[1:]] != names[order[:-1]]))
    one, other = order[pair], order[pair + 1]
    if not one.size:
        return np.arange(len(index))
    differs = {name: ~np.isclose(values[one], values[other], rtol=1e-9, atol=0.0) for name, values in columns.items()}
    for name, values in columns.items():
        differs[name] &= np.isfinite(values[one]) & np.isfinite(values[other])
    n = int(np.any(list(differs.values()), axis=0).sum())
    if n:
        _check_beside(tables, stamps)
    if n and clock.duplicates == "refuse":
        name = next(name for name, rows in differs.items() if rows.any())
        k = int(np.argmax(differs[name]))
        raise DataError(
            f"{where(int(other[k]))}: {index[other[k]]} stands at {where(int(one[k]))} too, and {name} is "
            f"{columns[name][other[k]]:g} here and {columns[name][one[k]]:g} there; the files overlap in {one.size} "
            f"rows, of which {n} differ: cut off what is wrong, or set time.duplicates: first (of the file that begins "
            "earlier) or last"
        )
    is_last = clock.duplicates == "last"
    kept, left = (other, one) if is_last else (one, other)
    if not n:
        for values in columns.values():
            values[kept] = np.where(np.isfinite(values[kept]), values[kept], values[left])
    said = f"the {clock.duplicates} one kept" if n else "which say the same"
    files = " and ".join(dict.fromkeys([str(names[one[0]]), str(names[other[0]])]))
    text = f"{files} overlap from {index[one[0]]} to {index[one[-1]]}: {one.size} rows in both, {said}"
    notes.append(Note(text, f"{files} overlap, {said}", one.size))
    return np.delete(np.arange(len(index)), left)


def _place_of(where: Callable[[int], str], kept: NDArray[np.intp], row: int) -> str:
    return where(int(kept[row]))


def _check_beside(tables: Sequence[RawTable], stamps: Sequence[pd.Series]) -> None:
    """Refuse files with the same columns at the same times, which are different rooms or points."""
    for k in range(1, len(tables)):
        shared = stamps[k].isin(stamps[k - 1]).sum()
        if tables[k].name != tables[k - 1].name and shared > _MOST_SHARED * min(len(stamps[k]), len(stamps[k - 1])):
            raise DataError(
                f"{tables[k].name} and {tables[k - 1].name} have the same columns at the same times: they are of "
                "different rooms or points. Set table: {by_file: prefix} in the map (folder, where files of several "
                "folders are called alike), and name a column with its file, "
                f"as in '{Path(tables[k].name).stem} {next(iter(tables[k].columns))}'; `tf-mpc data map` of all files "
                "writes it"
            )


def _check_years(index: pd.DatetimeIndex, name: str) -> None:
    if (years := (index[-1] - index[0]).days / 365.0) > _MOST_YEARS:
        row = int(np.argmax(np.diff(index.asi8)))
        raise DataError(
            f"{name}: {years:.0f} years from {index[0]} to {index[-1]}, the longest gap from {index[row]} to "
            f"{index[row + 1]}: mend the time stamp that is wrong, or give {_MOST_YEARS} years at most"
        )


def _place(tables: Sequence[RawTable], stamps: Sequence[pd.Series], row: int) -> str:
    """Where a row of several tables stands."""
    for table, of_table in zip(tables, stamps, strict=True):
        if row < len(of_table):
            return table.where(int(of_table.index[row]))
        row -= len(of_table)
    return tables[-1].name


def _in_order(
    index: pd.DatetimeIndex, clock: TimeStampRules, where: Callable[[int], str], notes: list[str]
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
            begins, ends = (where(one).rsplit(", ", 1)[0] for one in (row, row - 1))
            if begins != ends:
                hint = f"; {ends} and {begins} overlap: cut one of them off, unless they are of different rooms"
            raise DataError(f"{what}: sort the table, or set time.order: sort{hint}")
        keep = np.argsort(at, kind="stable")
        at = at[keep]
        notes.append(Note(f"{what}: sorted", f"{where(row).rsplit(', ', 1)[0]}: sorted", back.size))
    same = np.flatnonzero(np.diff(at) == 0)
    if same.size:
        first, second = (int(keep[same[0] + i]) for i in (0, 1))
        what = f"{where(second)}: {index[second]} stands at {where(first)} too; {same.size} such rows"
        if clock.duplicates == "refuse":
            if not (index[keep] != index[keep].normalize()).any() and same.size > at.size / 2:
                raise DataError(
                    f"{what}: the stamps of a day are all the same. Where the time of day stands in a column of "
                    "its own, "
                    "name both: time.column: [Date, Time]"
                )
            raise DataError(f"{what}: remove one of them, or set time.duplicates: first or last")
        drop = same + 1 if clock.duplicates == "first" else same
        keep = np.delete(keep, drop)
        text = f"{what}: the {clock.duplicates} one kept"
        notes.append(Note(text, f"{where(second).rsplit(', ', 1)[0]}: rows twice", same.size))
    return keep if back.size or same.size else None
