"""What a table of unknown form is taken for: how it is written, where names of signals stand, how stamps are read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal
from zoneinfo import available_timezones

import numpy as np
import pandas as pd

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.tables.clock import LATE, newest_first, plain, times_of
from thermoforce_mpc.measurements.tables.files import (
    SEPARATORS,
    WORKBOOKS,
    cells_of,
    head_of,
    header_of,
    is_text,
    longest_sheet,
    named_after,
    reading,
    sample,
)
from thermoforce_mpc.measurements.tables.forms import CsvFormat, TableForm, TimeStampRules, each_column
from thermoforce_mpc.measurements.tables.raw_table import (
    ISO,
    QUESTION,
    SWITCH,
    as_numbers,
    quantity_of,
    told_points,
    unit_of_cells,
    with_offset,
)
from thermoforce_mpc.measurements.units import UNITS

ROWS = 2000
"""Rows of a table that are looked at."""
_LINES, _MOST_HEAD, _MOST_PAIRS = 400, 60, 50
_OF_INFLUX = 1_000_000
# From so many columns on that are called as times are, these are the times of a table.
_LEAST_TIMES_ASIDE = 4
# Headers of columns, by what they hold, in the languages of the maps.
_TIME = re.compile(
    r"(?i)^(<>)?(date|time|datetime|date[ /_-]*time|time "
    "?stamp|timestamp|_time|start|end|from|to|ts|at|when|hour|datum|zeit|"
    r"uhrzeit|zeitpunkt|zeitstempel|datum[ /]*zeit|datum[ "
    "/]*uhrzeit|heure|horodatage|horodate|moment|tijd|tijdstip|datumtijd|"
    r"last_(changed|updated)(_ts)?|time ?utc|utc|local ?time|recorded.*|logged.*|beginn|von|start_ts|created.*|"
    r"fecha|hora|ora|orario|marca ?de ?tiempo)\b"
)
_DAY = re.compile(r"(?i)^(<>)?(date|datum|day|tag|dag|jour|fecha|dia|data|giorno)\b")
_OF_DAY = re.compile(r"(?i)^(time|uhrzeit|zeit|heure|tijd|uur|hour|time of day|clock|hora|ora|orario)\b")
_END = re.compile(
    r"(?i)((intervall?|period|hour|stunden|stop|zeit|time|timestamp|date(?: de)?|datum|fecha)[ _.-]?)?"
    r"(end(e|ing|s)?|bis|to|until|tot|einde|fin|fine|hasta)"
    r"([ _.-]?(time|date|datetime|at|zeit|interval|period))?(?: ?[\[(][^\])]*[\])])?"
)
_POINT = re.compile(
    r"(?i)^(entity_?id|statistic_?id|metadata_?id|point|point.?(name|id)|name|sensor|sensor.?(name|id)|tag|tag.?name|device.*|"
    r"topic|signal|variable|metric|parameter|channel|object.?name|object|item|id|series|datapoint|data.?point|measurement|"
    r"register|messstelle|datenpunkt|kanal|bezeichnung|messpunkt|capteur|grandeur|mesure|punt|meetpunt|naam|nom|room|_field|"
    r"_measurement|field|nombre|nome|punto|trend|trendlog|quantity|key|path|name.path.reference|address|source|ort|raum|type|kind|attribute?|capability|property|eigenschaft)$"
)
_VALUE = re.compile(
    r"(?i)^(value|payload|arvo|värde|vaerdi|værdi|verdi|state|_value|mean|wert|messwert|valeur|valore|valor|waarde|meetwaarde|reading|val|present.?value|object.?value|data|sum|"
    r"avg|average|numeric_value|float_value|result|actual.?value|istwert|v|y)([ _]*[\[(].*)?$"
)
_STATUS = re.compile(r"(?i)^(status|quality|trend ?flags|reliability|qualit.*|flag|flags|statut)$")
# Columns of programs beside a reading: whether it was confirmed, where it comes from, what it was.
_BESIDE = re.compile(r"(?i)^(ack|acknowledged|q|lc|from|_from|source|event|unit|units|type|attributes|id|row|#)$")
# A device has readings of several kinds: both columns together name a signal.
_DEVICE_COLUMN = re.compile(
    r"(?i)^(device.*|topic|room|raum|ort|location|source|gerät|geraet|appareil|apparaat|asset)$"
)
_QUANTITY_COLUMN = re.compile(
    r"(?i)^(reading|parameter|quantity|variable|metric|measurement|channel|kanal|field|data.?point|datapoint|grandeur|"
    r"mesure|sensor|signal|object.?name|register|attribute?|attribut|capability|property|eigenschaft)$"
)
_UNIT_COLUMN = re.compile(r"(?i)^(unit|units|unit_of_measurement|uom|einheit|unité|unite|eenheid|enhet|enhed|yksikkö)$")
# Stamps without a year, as EnergyPlus writes them, and the year that is taken: 2017, like its own, began on a Sunday.
_NO_YEAR, _YEAR = r"\s*\d{1,2}/\d{1,2}\s+\d{1,2}:\d{2}(:\d{2})?\s*", 2017
# A line above the names of columns with what each of them is to be divided by, as NIBE's heat pumps write it.
_DIVISORS = re.compile(r"(?i)^\W*divisors\b")
# What stands in a line of units below the names of columns.
_UNIT = re.compile(
    r"(?i)[\[(]?(°?[cfk]|deg ?[cf]|celsius|%|[kM]?W|[kM]?Wh|W/m.{1,2}|-|hh:mm|datetime|date|time|utc|iso.*|s|min|h|"
    r"float|double|string|boolean|ts|rn|avg|smp|tot|std|min|max|Pa|hPa|ppm|lx|m/s|km/h|Hz|V|A|W|J|l/h|k?Btu.{0,3}|m³|m3|.{1,3}/kWh|"
    r"[dDmMyYHhstT.:/ -]{8,24})?[\])]?"
)
_VALUES_OF: tuple[tuple[str, ...], ...] = (("mean", "sum", "state"), ("state",), ("value",), ("_value",))
_DAYS = (
    "%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%d-%m-%Y", "%m-%d-%Y", "%d/%m/%y", "%m/%d/%y",
    "%Y.%m.%d",
    "%Y%m%d", "%d-%b-%y", "%d-%b-%Y", "%d %b %Y", "%d. %b %Y", "%d %b. %Y", "%d.%b.%Y", "%d.%b %Y", "%d/%b/%Y",
    "%d %b %y", "%b %d, %Y", "%b %d %Y",
    "%d-%m-%y", "%Y-%m-%d", "%m-%d-%y", "%y/%m/%d", "%y-%m-%d", "%y.%m.%d",
)  # fmt: skip
_CLOCKS = (
    "%H:%M", "%H:%M:%S", "%H:%M:%S.%f", "%I:%M %p", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M%p", "%I:%M:%S%p", "%H.%M",
    "%Hh%M",
    "%H:%M:%S:%f", "%H:%M:%S,%f", "%Hh", "%H%M%S", "%H%M",
)  # fmt: skip
# Zones of clocks by what they are called.
_CALLED = (
    ("CES?T|MES?Z", "Europe/Berlin"), ("BST|WES?T", "Europe/London"), ("EES?T", "Europe/Athens"),
    ("E[SD]T", "America/New_York"),
    ("C[SD]T", "America/Chicago"), ("M[SD]T", "America/Denver"), ("P[SD]T", "America/Los_Angeles"),
)  # fmt: skip
_ZONE_OFFSET = re.compile(r"[A-Za-z_]+/[A-Za-z_]+ ?\([+-]\d{2}:\d{2}\)")
_TIME_ZONE = re.compile(r"(?i)time.?zone(?!.?abbr)|zeitzone|tijdzone|fuseau( horaire)?|zona horaria|fuso orario")
_BETWEEN = (" ", ", ", "T", " - ", ":")
# Days since 30 December 1899, as spreadsheets count them, of the years 2000 to 2050.
_SERIALS = (36526.0, 54789.0)
# A reading of day and month under which a record is so many times as long as under another one is wrong.
_SURELY_LONGER = 5.0
_IS_STAMP = re.compile(r"\s*\d{1,4}[-./]\d{1,2}[-./]\d{1,4}(?!\d)")
# A sheet of so many rows is more than a summary.
_LEAST_ROWS = 48


@dataclass(frozen=True)
class Recognised:
    """What files are taken for; `notes`: in words, for comments of a map, of which a line with '?' is not certain."""

    paths: tuple[Path, ...]
    csv: CsvFormat
    table: TableForm
    clock: TimeStampRules
    words: str
    notes: dict[str, str]


def told_beside(path: Path, form: CsvFormat) -> tuple[dict[str, str], dict[str, float]]:
    """Units by column from a line below the names of columns, and divisors from one above; of CSV files."""
    if not is_text(path):
        return {}, {}
    separator, names, at, _ = header_of(path, form)
    _, lines = sample(path)
    below = [cells_of(line, separator) for line in lines[at + 1 : at + 1 + form.skip_after]]
    units = {name: cell for cells in below for name, cell in zip(names, cells, strict=False) if _UNIT.fullmatch(cell)}
    divisors: dict[str, float] = {}
    for line in lines[:at]:
        if _DIVISORS.match(line):
            cells = zip(names, cells_of(line, separator), strict=False)
            divisors |= {name: float(cell) for name, cell in cells if re.fullmatch(r"[1-9]\d*", cell)}
    return units, divisors


def units_of_points(head: pd.DataFrame, table: TableForm, decimal: str) -> dict[str, str]:
    """Units of the signals of a table of one reading a row: from a column of units, or behind the readings."""
    column = next((str(name) for name in head.columns if _UNIT_COLUMN.match(str(name))), None)
    out: dict[str, str] = {}
    for point, rows in head.groupby(told_points(head, table.points), sort=False):
        cells = [unit_of_cells(rows[value], decimal) for value in table.values if value in rows]
        units = rows[column].dropna().astype(str) if column is not None else pd.Series(dtype=str)
        out[str(point)] = next((cell for cell in cells if cell), str(units.iloc[0]) if len(units) else "")
    return out


def written_alike(paths: Sequence[Path]) -> list[list[Path]]:
    """Files of one building by how they are written, in the order of the first of each kind; raises as `recognised`."""
    if len(paths) == 1:
        return [list(paths)]
    kinds: list[tuple[Recognised, list[Path]]] = []
    for path in paths:
        form = guessed_form(path)
        head = head_of(path, _LINES, form)
        for first, of_kind in kinds:
            if _alike(first, path, form, head):
                of_kind.append(path)
                break
        else:
            kinds.append((recognised([path]), [path]))
    return [of_kind for _, of_kind in kinds]


def _alike(first: Recognised, path: Path, form: CsvFormat, head: pd.DataFrame) -> bool:
    """Whether a file with some `head` rows, which seems to have `form`, is read as another one is written."""
    if head.empty or (form != first.csv and not _same_cells(path, form, first.csv, head)):
        return False
    columns, stamps = [str(name) for name in head.columns], each_column(first.clock.column)
    points, values = first.table.points, first.table.values
    if points and not {*points, *stamps, *values[:1]} <= set(columns):
        return False
    if not points:
        if not set(stamps) <= set(columns):  # the first column, whatever it is called
            was_first = len(stamps) == 1 and stamps[0] == str(head_of(first.paths[0], 1, first.csv).columns[0])
            stamps = tuple(columns[:1]) if was_first else ()
        others = [name for name in columns if name not in stamps and not _dated(head[name])]
        if not stamps or _of_readings(head, others, set(stamps)) is not None:
            return False
    return _same_clock(first.clock, head, stamps, path, form)


def _same_cells(path: Path, form: CsvFormat, other: CsvFormat, head: pd.DataFrame) -> bool:
    """Whether the `head` rows of a file, by `form`, are the same by another one."""
    try:
        by_other = head_of(path, _LINES, other)
    except DataError:
        return False
    if list(by_other.columns) != list(head.columns) or len(by_other) != len(head):
        return False
    return all(
        np.array_equal(as_numbers(head[c], form.decimal), as_numbers(by_other[c], other.decimal), equal_nan=True)
        for c in head.columns[1:]
    )


def _same_clock(clock: TimeStampRules, head: pd.DataFrame, stamps: Sequence[str], path: Path, form: CsvFormat) -> bool:
    """Whether the columns `stamps` of a table are read by `clock`."""
    at = head[stamps[0]]
    if pd.api.types.is_numeric_dtype(at):
        theirs, _ = counted_clock(at)
        return len(stamps) == 1 and clock.unit is not None and (theirs.unit, theirs.since) == (clock.unit, clock.since)
    if clock.unit is not None or pd.api.types.is_datetime64_any_dtype(at):
        return clock.unit is None and clock.format is None and clock.year is None
    if len(stamps) > 1:
        at = at.astype(str).str.strip() + " " + head[stamps[1]].astype(str).str.strip()
    as_written = at.dropna().astype(str)
    if as_written.empty:
        return False
    if clock.year is not None:
        return bool(as_written.str.fullmatch(_NO_YEAR).all())
    text = plain(as_written)
    if _told_zone(text, as_written, stamps, path, form) != clock.zone:
        return False
    if clock.format is None:
        return bool(text.str.match(ISO).all())
    return _fits_all(text, clock.format)


def recognised(paths: Sequence[Path]) -> Recognised:
    """What files of one building are taken for; raises `DataError` for one that is no table."""
    forms, sheets = zip(*map(_guessed, paths), strict=True)
    heads = [_head(path, form) for path, form in zip(paths, forms, strict=True)]
    for path, head in zip(paths, heads, strict=True):
        if head.empty:
            raise DataError(f"{path}: the table has no rows")
    form, others = forms[0], [f"{path}" for path, one in zip(paths, forms, strict=True) if one != forms[0]]
    notes = {"csv": f"? {', '.join(others[:3])} seem to be written otherwise" if others else ""}
    notes["names"] = _numbered(paths[0], form)
    notes["sheets"] = sheets[0]
    head = heads[0]
    for path, one in zip(paths, heads, strict=True):
        _check_layout(path, one)
        _check_one_clock(path, one)
    column, clock, notes["time"] = _clock(head, paths[0], form)
    same = all(not column or set(column) <= set(map(str, one.columns)) for one in heads)
    first = len(column) == 1 and all(str(one.columns[0]) == column[0] for one in heads)
    if not same or (first and len(paths) > 1):
        column = ()
    clock = clock.model_copy(update={"column": column if len(column) > 1 else (column[0] if column else None)})
    of_stamps = set(column or [str(head.columns[0])])
    table, words = _form_of(paths, heads, of_stamps, form)
    return Recognised(tuple(paths), form, table, clock, words, notes)


def _head(path: Path, form: CsvFormat) -> pd.DataFrame:
    """Rows of a table that are looked at; of InfluxDB's more, which writes one signal after the other."""
    head = head_of(path, ROWS, form)
    return head_of(path, _OF_INFLUX, form) if {"_value", "_field"} <= set(head.columns) and len(head) == ROWS else head


def _check_layout(path: Path, head: pd.DataFrame) -> None:
    """Refuse a table of lines that nothing parts, and one whose times stand side by side."""
    names = [str(name) for name in head.columns]
    if len(names) == 1 and not isinstance(head.index, pd.DatetimeIndex):
        raise DataError(
            f"{path}: nothing parts the cells of its lines ({names[0][:60]!r}): a table has commas, semicolons, "
            "tabs or | between them (csv.separator for another mark) and a line of column names; of a log take the "
            "export as CSV"
        )
    if len(names) > 1 and (_IS_STAMP.match(names[0]) or all(_numeric(name) for name in names)):
        others_numbers = all(_numeric(name) for name in names[1:])
        such = "time,value" if others_numbers and len(names) == 2 else "time,living temperature,outdoor temperature"
        raise DataError(
            f"{path}: its first line is a reading ({', '.join(names[:3])}, …), and none names the columns: write one "
            f"above it that says what each is, such as '{such if others_numbers else 'time,topic,value'}'"
        )
    times = [name for name in names if _stamp(name)]
    if len(times) >= _LEAST_TIMES_ASIDE and len(times) > len(names) / 2:
        first = len(names) - len(times)
        raise DataError(
            f"{path}: its times stand side by side as names of columns ({times[0]}, {times[1]}, …) and each row is a "
            "signal, as Home Assistant's energy dashboard writes it. Turn it round: python -c \"import pandas; "
            f"t = pandas.read_csv('{path.name}'); t = t.set_index(t.columns[0]).iloc[:, {first - 1}:].T; "
            "t.to_csv('turned.csv', index_label='time')\""
        )


def _fractions(told: pd.Series) -> bool:
    """Whether cells are numbers that are not all whole, as readings are and what counts rooms is not."""
    numbers = pd.to_numeric(told.astype(str).str.replace(",", "."), errors="coerce")
    return bool(numbers.notna().all() and (numbers % 1.0 != 0.0).any())


def _check_devices(path: Path, head: pd.DataFrame, columns: Sequence[str], of_stamps: set[str]) -> None:
    """Refuse a table in which a column says of which device a row is, and several what it measured."""
    known = [c for c in columns if not _UNIT_COLUMN.match(c) and not _BESIDE.match(c)]
    measured = [c for c in known if _numbers(head[c]) and not _points(head, c, again=True)]
    again = head[list(of_stamps)].duplicated().mean() if of_stamps <= set(map(str, head.columns)) else 0.0
    for column in known if len(measured) > 1 else ():
        told = head[column].dropna()
        of_rows = _POINT.match(column) or _DEVICE_COLUMN.match(column) or column.lower().endswith("id")
        changes = float((told != told.shift()).mean())
        if (
            of_rows
            and column not in measured
            and 1 < told.nunique() <= len(head) / 3
            and (again > 0.2 or (changes > 0.3 and not _fractions(told)))
        ):
            raise DataError(
                f"{path}: each row is of one of {told.nunique()} by column '{column}', with several readings "
                f"({', '.join(measured[:3])}): make a file of each, named as its room; they are read together: "
                f"python -c \"import pandas; t = pandas.read_csv('{path.name}', sep=None, engine='python'); "
                f"[d.to_csv(str(n).replace('/', ' ') + '.csv', index=False) for n, d in t.groupby('{column}')]\""
            )


def _check_one_clock(path: Path, head: pd.DataFrame) -> None:
    """Refuse trends side by side, each with stamps of its own, as building automation exports them."""
    names = [str(name) for name in head.columns]
    at = [k for k, name in enumerate(names) if _dated(head[name])]
    pairs = len(at) > 1 and at == list(range(0, 2 * len(at), 2)) and len(names) == 2 * len(at)
    if pairs and any(not head[names[k]].equals(head[names[0]].rename(names[k])) for k in at[1:]):
        raise DataError(
            f"{path}: holds {len(at)} trends side by side, each with times of its own ({names[0]}, {names[2]}, …): "
            "save each pair of columns as a file, named as what it holds; files of one signal each are read together"
        )


def _numbered(path: Path, form: CsvFormat) -> str:
    """Which columns of a file are told apart by a number alone, in words."""
    if not is_text(path):
        return ""
    _, names, _, cells = header_of(path, form)
    ours = [name for name, cell in zip(names, cells, strict=True) if re.fullmatch(re.escape(cell) + r" \d+", name)]
    return f"columns of the same name are numbered from left to right: {', '.join(ours[:6])}" if ours else ""


def guessed_form(path: Path) -> CsvFormat:
    """How a file seems to be written: encoding, lines above the header, separator, decimal comma, lines of units.

    Of a workbook the lines above the header and of units alone, and its longest sheet, where that is not the first.
    """
    return _guessed(path)[0]


def _guessed(path: Path) -> tuple[CsvFormat, str]:
    """See `guessed_form`; and which other sheets of a workbook hold a table, in words: one sheet is read."""
    if is_text(path):
        return _guessed_of_text(path), ""
    if path.suffix.lower() not in WORKBOOKS:
        return CsvFormat(), ""
    rows_of, longest, lines = longest_sheet(path, _LINES)
    skip, _, _ = _header_at(lines)
    sheet = None if longest == next(iter(rows_of)) else longest
    others = [name for name, rows in rows_of.items() if name != longest and rows >= _LEAST_ROWS]
    told = f"sheet '{longest}' is read; save these as files of their own: {', '.join(others)}" if others else ""
    return CsvFormat(sheet=sheet, skip_lines=skip, skip_after=_after_header(lines, skip, "\t", None)), told


def _guessed_of_text(path: Path) -> CsvFormat:
    encoding, text = sample(path)
    lines = text[:_LINES]
    with reading(path):
        skip, separator, comment = _header_at(lines)
    rows = [line for line in lines[skip + 1 :] if line.strip() and not (comment and line.startswith(comment))]
    header = next((line for line in lines[skip:] if line.strip() and not (comment and line.startswith(comment))), "")
    after = _after_header(lines, skip, separator, comment) if rows and comment else 0
    below = "\n".join(rows[after:])
    ends = rf"[ ]*(?:[°%A-Za-z\x7b][^{re.escape(separator)}\"\r\n]{{{{0,6}}}})?(?=[{re.escape(separator)}\"\r\n]|$)"
    number = rf"(?:^|[{re.escape(separator)}\"])(?:[$0-9A-Fa-f ]+\|)?[ ]*-?\d+{{}}\d+{ends}"
    points, commas = (len(re.findall(number.format(mark), below, re.M)) for mark in (r"\.", ","))
    if separator == ",":  # there a decimal comma needs quotes
        commas = len(re.findall(r'"-?\d+,\d+[^",\d]{0,6}"', below))
    return CsvFormat(
        encoding=encoding,
        decimal="," if commas > points else ".",
        separator=None if max(SEPARATORS, key=header.count) == separator else separator,
        skip_lines=skip
        if (not comment or not all(line.startswith(comment) or not line.strip() for line in lines[:skip]))
        else 0,
        skip_after=after,
        comment=comment,
    )


def _after_header(lines: Sequence[str], skip: int, separator: str, comment: str | None) -> int:
    """How many lines below that of column names, at `skip`, are none of readings, as those of units."""
    after = 0
    for line in lines[skip + 1 : skip + 3]:
        if not line.strip() or (comment and line.startswith(comment)):
            break
        cells = cells_of(line, separator)
        if any(_numeric(cell) or _stamp(cell) for cell in cells) or not any(cells[1:]) or line == lines[skip]:
            break
        after += 1
    return after


def _header_at(lines: Sequence[str]) -> tuple[int, str, str | None]:
    """Place of the line of column names, the separator, and the mark of comments (None where the header begins so)."""
    best = (0, -1.0, ",")
    for separator in SEPARATORS:
        if separator == "," and _decimal_commas(lines):
            continue
        n = [_separators(line, separator) for line in lines]
        counted = Counter(k for k, line in zip(n, lines, strict=True) if k and not line.startswith("#"))
        if not counted:
            continue
        usual, times = max(counted.items(), key=lambda item: (item[1], item[0]))
        share = times / max(sum(1 for line in lines if line.strip() and not line.startswith("#")), 1)
        stamped = any(_stamp(cell) for line in lines[:_MOST_HEAD] for cell in cells_of(line, separator))
        worth = share + 0.5 * stamped + 0.01 * usual
        if worth > best[1]:
            best = (usual, worth, separator)
    usual, _, separator = best
    if best[1] < 0:
        return 0, ",", "#"
    first = next(
        (
            k
            for k, line in enumerate(lines)
            if abs(_separators(line, separator) - usual) <= 1 and not line.startswith("#") and line.strip()
        ),
        0,
    )
    cells = cells_of(lines[first], separator)
    data = sum(_numeric(cell) or _stamp(cell) for cell in cells if cell) > len([c for c in cells if c]) / 2
    above = lines[first - 1] if first else ""
    if data and above.startswith("#") and _separators(above, separator) == usual:
        return first - 1, separator, None
    # Lines of names and units above a table may have as many separators as it: the last before the first stamp counts.
    for k in range(first, min(first + _MOST_HEAD, len(lines) - 1)):
        after = cells_of(lines[k + 1], separator)
        ours = cells_of(lines[k], separator)
        if any(_stamp(cell) for cell in ours):
            break
        if any(_stamp(cell) for cell in after):
            named = [
                j
                for j in range(first, k + 1)
                if _separators(lines[j], separator) == usual and not lines[j].startswith("#")
            ]
            # Lines of units, and of how it was sampled, stand below the names.
            while len(named) > 1 and _is_units(cells_of(lines[named[-1]], separator)):
                named.pop()
            return named[-1] if named else k, separator, "#"
    return first, separator, "#"


def _decimal_commas(lines: Sequence[str]) -> bool:
    """Whether all commas of rows stand within numbers, and another mark parts the rows."""
    rows = [line for line in lines if re.match(r"\d", line)]
    parted = any(all(mark in row for row in rows) for mark in SEPARATORS if mark != ",")
    return bool(rows) and parted and not any(re.search(r"(?<!\d),|,(?!\d)", row) for row in rows)


def _separators(line: str, separator: str) -> int:
    """How many times a line is parted; what stands in quotes parts nothing."""
    return len(cells_of(line, separator)) - 1 if '"' in line else line.count(separator)


def _is_units(cells: Sequence[str]) -> bool:
    """Whether cells are those of a line of units, such as '°C' and '[kW]'."""
    return all(_UNIT.fullmatch(cell) for cell in cells) and any(cells)


def _numeric(cell: str) -> bool:
    return bool(re.fullmatch(r"[+-]?\d+([.,]\d+)?([eE][+-]?\d+)?", cell.strip()))


def _stamp(cell: str) -> bool:
    """Whether a cell looks like a date, a time of day, or both, and not like a zone, as 'Europe/Berlin (+01:00)'."""
    return not _ZONE_OFFSET.search(cell) and bool(
        re.search(r"\d{4}-\d{2}-\d{2}|\d{1,2}[./-]\d{1,2}[./-]\d{2,4}|\d{4}/\d{2}/\d{2}|\d{1,2}:\d{2}", cell)
        or re.search(r"(?<!\w)\d{1,2}[ .-]+[A-Za-zäûé]{3,9}[ .-]+\d{2,4}", cell)
    )


def _clock(head: pd.DataFrame, path: Path, form: CsvFormat) -> tuple[tuple[str, ...], TimeStampRules, str]:
    """Columns of the stamps, how they are read, and a note."""
    columns = [str(column) for column in head.columns]
    dated = [c for c in columns if _dated(head[c])]
    days = [c for c in dated if _only(head[c], r"\d{1,2}:\d{2}", absent=True) and head[c].nunique() < len(head)]
    hours = [
        c
        for c in columns
        if c not in dated
        and _only(head[c], r"\s*\d{1,2}[:.h]\d{2}([:.]\d{2})?(\s*[AaPp]\.?[Mm]\.?)?(\s*(Uhr|uur))?\s*")
    ]
    if days and hours and (head[days[0]].nunique() < 0.5 * len(head) or _DAY.match(days[0])):
        key: tuple[str, ...] = (days[0], hours[0])
        stamps = head[key[0]].astype(str).str.strip() + " " + head[key[1]].astype(str).str.strip()
    else:
        named = [c for c in dated if _TIME.match(c)]
        prefer = [c for c in named if re.search(r"(?i)last_changed|_time$|^start$|^time|zeit|date", c)]
        # A table of one reading a row may have more than one: what changes with the readings counts.
        key = ((prefer or named or dated or [c for c in columns if _TIME.match(c)] or columns[:1])[0],)
        ends = [c for c in dated if c in named and re.match(r"(?i)(start|from|von|begin)", c)]
        key = (ends[0],) if ends else key
        stamps = head[key[0]]
    if pd.api.types.is_numeric_dtype(stamps):
        return key, *counted_clock(stamps)
    if pd.api.types.is_datetime64_any_dtype(stamps):
        return key, TimeStampRules(zone=_zone(stamps.astype(str).iloc[:1])), ""
    text = plain(stamps.dropna().astype(str))
    if not len(text):
        raise DataError(f"{path}: no column holds time stamps")
    # What ends at 24:00, or is called an end, is an interval, not a reading of then.
    late = stamps.astype(str).str.contains(LATE).any() or (len(key) == 1 and _END.fullmatch(key[0].strip()))
    marks: Literal["start", "end"] = "end" if late else "start"
    if _only(text, _NO_YEAR):
        return key, TimeStampRules(year=_YEAR, marks=marks), "the year, which the stamps do not have"
    pattern, note = _stamp_format(text)
    zone = _told_zone(text, stamps.dropna().astype(str), key, path, form)
    return key, TimeStampRules(format=pattern if pattern != "FILL IN" else None, zone=zone, marks=marks), note


def _dated(column: pd.Series) -> bool:
    if pd.api.types.is_datetime64_any_dtype(column):
        return True
    if pd.api.types.is_numeric_dtype(column):
        return False
    told = column.dropna().astype(str).iloc[:50]
    return len(told) > 0 and bool(
        told.str.fullmatch(_NO_YEAR).all()
        or told.str.contains(
            r"\d{4}-\d{2}-\d{2}|\d{1,2}[./-]\d{1,2}[./-]\d{2,4}|\d{4}/\d{1,2}/\d{1,2}|^\d{8}\b", regex=True
        ).mean()
        > 0.9
        or told.str.contains(
            r"\d{1,2}[ .-]+[A-Za-zäûéÄ]{3,9}\.?[ .-]+\d{2,4}|[A-Za-z]{3,9} \d{1,2},? \d{4}", regex=True
        ).mean()
        > 0.9
    )


def _only(column: pd.Series, pattern: str, *, absent: bool = False) -> bool:
    told = column.dropna().astype(str).iloc[:200]
    if absent:
        return len(told) > 0 and not told.str.contains(pattern, regex=True).any()
    return len(told) > 0 and bool(told.str.fullmatch(pattern).all())


def counted_clock(stamps: pd.Series) -> tuple[TimeStampRules, str]:
    """How stamps that are numbers are read, and a note; without a unit where that does not show."""
    first = float(stamps.dropna().iloc[0]) if stamps.notna().any() else 0.0
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 1e9 * scale < first < 2.5e9 * scale:
            return TimeStampRules(unit=unit, since="1970-01-01T00:00Z", zone="UTC"), ""
    days = stamps.dropna().to_numpy(dtype=np.float64)
    if _SERIALS[0] < first < _SERIALS[1] and (days % 1.0 != 0.0).mean() > 0.5 and np.ptp(days) < _SERIALS[0]:
        return TimeStampRules(unit="D", since="1899-12-30"), ""
    return TimeStampRules(), "? stamps are numbers: name their unit and what they count from"


def _stamp_format(text: pd.Series) -> tuple[str | None, str]:
    """The `strptime` format of stamps, None for ISO 8601, and a note where another fits as well."""
    sample_of = text if len(text) <= 500 else text.iloc[:: len(text) // 500]
    as_iso = bool(ISO.match(str(text.iloc[0])))
    if as_iso:  # tables joined end to end have lines of their headers between
        sample_of = sample_of[sample_of.str.contains(r"\d{2}:?\d{2}", regex=True)]
    if as_iso and times_of(sample_of, "ISO8601", utc=True, errors="coerce").notna().all():
        return None, ""
    fitting = []
    first = next((one for one in map(str.strip, text.astype(str)) if not re.search(LATE, one)), "")
    ends = (" %z", "%z") if with_offset(text.iloc[:1])[0] else ("",)
    for day in _DAYS:
        for between in _BETWEEN:
            for clock in (*_CLOCKS, ""):
                for end in ends:
                    form = f"{day}{between}{clock}{end}" if clock else day
                    fits = form not in fitting and _may_fit(first, form) and _fits(first, form)
                    if fits and _fits_all(sample_of, form):
                        fitting.append(form)
    if not fitting:
        return "FILL IN", f"? stamps such as {text.iloc[0]}: %d day, %m month, %Y year, %H:%M"
    # Days taken for months make years of days: of the forms that fit, the one under which the record is shortest.
    lasts = {form: _span(sample_of, form) for form in fitting}
    best = min(fitting, key=lasts.__getitem__)
    day = best.split(" %H")[0].split(" %I")[0]
    others = [form for form in fitting if not form.startswith(day) and lasts[form] <= _SURELY_LONGER * lasts[best]]
    return best, f"or '{others[0]}': both fit" if others else ""


def _marks(text: str) -> str:
    return "".join(c for c in text if not c.isalnum() and not c.isspace())


def _may_fit(text: str, form: str) -> bool:
    """Whether a stamp of this format can have the marks of `text`: `strptime` compiles each format to refuse it."""
    named, literal = "%b" in form or "%p" in form, re.sub("%[A-Za-z]", "", form)
    if (named or re.search("[A-Za-z]", literal)) and not re.search(r"[^\W\d_]", text):
        return False
    if named or "%z" in form:  # names have marks of their own in some languages, and offsets do
        return not Counter(_marks(literal)) - Counter(_marks(text))
    return _marks(literal) == _marks(text)


def _fits(text: str, form: str) -> bool:
    try:
        year = datetime.strptime(text, form).year
    except ValueError:
        return False
    return 1990 <= year <= 2100


def _fits_all(text: pd.Series, form: str) -> bool:
    times = times_of(text, form, utc="%z" in form, errors="coerce")
    if not times.notna().all():
        return False
    if newest_first(times):
        times = times.iloc[::-1]
    back = times.diff() < pd.Timedelta(0)
    return bool(back.sum() <= 1) or bool((times.max() - times.min()) < pd.Timedelta("400D") and back.mean() < 0.2)


def _span(text: pd.Series, form: str) -> pd.Timedelta:
    times = times_of(text, form, utc="%z" in form, errors="coerce")
    return pd.Timedelta(times.max() - times.min())


def _told_zone(
    text: pd.Series, as_written: pd.Series, columns: Sequence[str], path: Path, form: CsvFormat
) -> str | None:
    """The zone that stamps tell, or the names of their columns, or the lines above these; None where none does."""
    told = _zone(text if with_offset(text).any() else as_written.iloc[:1], as_written.iloc[0])
    return told or _zone_of_header(" ".join(columns)) or _zone_above(path, form)


def _zone_above(path: Path, form: CsvFormat) -> str | None:
    """The zone in a cell below the word "timezone", or behind it, of the lines above a table; None without that."""
    if not is_text(path):
        return None
    separator, _, header, _ = header_of(path, form)
    rows = [cells_of(line, separator) for line in sample(path)[1][:header]]
    for row, below in zip(rows, [*rows[1:], []], strict=False):
        for k, cell in enumerate(row):
            if word := _TIME_ZONE.search(cell):
                beside = row[k + 1] if k + 1 < len(row) else ""
                under = below[k] if len(below) == len(row) else ""
                for told in (cell[word.end() :], under, beside):
                    name = told.strip(" :=\"'()")
                    if zone := name if "/" in name and name in available_timezones() else _zone_of_header(name):
                        return zone
    return None


def _zone(stamps: pd.Series, as_written: str = "") -> str | None:
    """The zone of stamps with offsets, or with the name of a clock `as_written`; None where they have none."""
    if called := _zone_called(as_written):
        return called
    ends = stamps.str.extract(r"([+-]\d{2}:?\d{0,2}|Z) *$", expand=False)
    if ends.isna().any() or not with_offset(stamps).all():
        return None
    offsets = {float(e[:3]) + (float(e[-2:]) / 60 if len(e) > 3 else 0.0) if e != "Z" else 0.0 for e in ends.unique()}
    least = min(offsets)
    standard = {
        1.0: "Europe/Berlin", 0.0: "UTC", 2.0: "Europe/Athens", -5.0: "America/New_York", -6.0: "America/Chicago",
        -7.0: "America/Denver", -8.0: "America/Los_Angeles", -4.0: "America/Halifax",
    }.get(least)  # fmt: skip
    if least == 0.0 and len(offsets) > 1:
        return "Europe/London"
    return standard if standard and (len(offsets) > 1 or least in (0.0, 1.0)) else _all_year(least)


def _zone_called(text: str) -> str | None:
    """The zone of a clock that a text names, as CEST; None without one."""
    return next((zone for words, zone in _CALLED if re.search(rf"\b({words})\b", text)), None)


def _zone_of_header(name: str) -> str | None:
    """The zone that the header of the stamps tells, as "Time UTC", "GMT+01:00", "(Europe/Paris)"; None for others."""
    named = re.search(r"\b[A-Z][A-Za-z]+/[A-Z][A-Za-z_]+(/[A-Z][A-Za-z_]+)?", name)
    if named and named[0] in available_timezones():
        return named[0]
    told = re.search(r"\b(?:GMT|UTC)\s?([+-]\d{1,2})(?::?00)?\b", name)
    if told:
        return _all_year(float(told[1]))
    return "UTC" if re.search(r"(?<![A-Za-z])(UTC|GMT|utc)(?![A-Za-z])", name) else _zone_called(name)


def _all_year(hours: float) -> str | None:
    return f"Etc/GMT{-hours:+.0f}" if hours == int(hours) and hours else ("UTC" if hours == 0 else None)


def _form_of(
    paths: Sequence[Path], heads: Sequence[pd.DataFrame], of_stamps: set[str], form: CsvFormat
) -> tuple[TableForm, str]:
    head = heads[0]
    columns = [str(column) for column in head.columns if str(column) not in of_stamps and not _dated(head[str(column)])]
    of_readings = _of_readings(head, columns, of_stamps)
    if of_readings is not None:
        programs = {"entity_id": "Home Assistant's history", "statistic_id": "Home Assistant's statistics"}
        of_influx = of_readings.value == "_value"
        influx = "InfluxDB's annotated CSV" if is_text(paths[0]) else "InfluxDB's line protocol"
        what = influx if of_influx else programs.get(str(of_readings.point), "a table")
        return of_readings, f"{what} with one row per reading"
    for path, one in zip(paths, heads, strict=True):
        named = [str(c) for c in one.columns if str(c) not in of_stamps and not _dated(one[str(c)])]
        _check_devices(path, one, named, of_stamps)
    status = next(
        (c for c in columns if c.lower() in ("status", "quality", "reliability") and not _numbers(head[c])), None
    )
    valued = [
        [
            str(c)
            for c in one.columns
            if _numbers(one[c]) and not (_STATUS.match(str(c)) or _BESIDE.match(str(c))) and str(c) not in of_stamps
        ]
        for one in heads
    ]
    each_one = all(len(of) == 1 for of in valued)
    values = tuple(dict.fromkeys(name for of in valued for name in of))
    told = named_after(paths[0], form) != named_after(paths[0], CsvFormat())
    said = each_one and all(_VALUE.match(name) for name in values)
    pairs = [(i, j) for j in range(len(heads)) for i in range(j) if set(valued[i]) & set(valued[j])]
    shared = any(_at_the_same_time(*(_stamps_of(heads[k], of_stamps) for k in (i, j))) for i, j in pairs[:_MOST_PAIRS])
    if each_one and (said or told or status is not None or (shared and len(values) == 1)):
        by_file = TableForm(by_file="point", value=values[0] if len(values) == 1 else values, status=status)
        return by_file, "one file per signal"
    if shared:
        called_alike = len({named_after(path, form) for path in paths}) < len(paths)
        by_folder = called_alike and len({path.resolve().parent for path in paths}) > 1
        each = "folders of files" if by_folder else "files"
        words = f"{each} with the same columns, one for each room or device"
        return TableForm(by_file="folder" if by_folder else "prefix", status=status), words
    return TableForm(status=status if each_one else None), "one column per signal"


def _only_numbers(head: pd.DataFrame, columns: Sequence[str], again: bool) -> list[str]:
    """The one column of numbers of a table, where there is but one."""
    numeric = [c for c in columns if _numbers(head[c]) and not (_points(head, c, again) or _BESIDE.match(c))]
    return numeric if len(numeric) == 1 else []


def _points(head: pd.DataFrame, column: str, again: bool) -> bool:
    """Whether a column names signals, by its header, cells, and whether stamps come `again` in several rows.

    A "room" of 20.5 is a temperature where each stamp has one row, the number of a room where it has several.
    """
    if not _POINT.match(column):
        return False
    numbers = [as_numbers(head[column].dropna().iloc[:ROWS], mark) for mark in (".", ",")]
    return again or not any((one.dropna() % 1.0 != 0.0).any() for one in numbers)


def _of_quantities(column: pd.Series) -> bool:
    """Whether the cells of a column are of several units, as '21.3 °C' and '35 %': readings of several signals."""
    if pd.api.types.is_numeric_dtype(column) or pd.api.types.is_datetime64_any_dtype(column):
        return False
    cells = column.dropna().astype(str).iloc[:200]
    found = [quantity_of(cell, mark) for cell in cells for mark in (",", ".")]
    kinds = {UNITS[one[1]].quantity for one in found if one is not None}
    return len(kinds) > 1 and sum(one is not None for one in found) > 0.8 * len(cells)


def _numbers(column: pd.Series) -> bool:
    known = column.dropna()
    return len(known) > 0 and bool(
        as_numbers(known.iloc[:ROWS]).notna().mean() > 0.5 or as_numbers(known.iloc[:ROWS], ",").notna().mean() > 0.5
    )


def _stamps_of(head: pd.DataFrame, of_stamps: set[str]) -> pd.Series[str]:
    """The stamps of a table as they are written, those of two columns parted by a space; else its first column."""
    columns = [name for name in head.columns if str(name) in of_stamps] or [head.columns[0]]
    return head[columns].dropna().astype(str).agg(" ".join, axis=1)


def _at_the_same_time(*stamps: pd.Series[str]) -> bool:
    """Whether stamps of two files are of the same time, rather than one after the other."""
    first, second = (set(of_file) for of_file in stamps)
    if len(first & second) > 0.3 * min(len(first), len(second)):
        return True
    ranges = []
    for of_file in stamps:
        text = plain(of_file)
        form, _ = _stamp_format(text) if len(text) else (None, "")
        if form == "FILL IN":
            return False
        times = times_of(text, form or "ISO8601", utc=True, errors="coerce").dropna()
        if not len(times):
            return False
        ranges.append((times.min(), times.max()))
    (a, b), (c, d) = ranges
    return bool(min(b, d) - max(a, c) > 0.3 * min(b - a, d - c))


def _of_readings(head: pd.DataFrame, columns: Sequence[str], of_stamps: set[str]) -> TableForm | None:
    """Where the names of signals stand in a table of one reading a row; None for other tables."""
    if {"_value", "_field"} <= set(columns):
        tags = [
            c
            for c in columns
            if c not in ("_value", "result", "table", "", "_start", "_stop") and head[c].nunique(dropna=False) > 1
        ]
        # A tag that another one tells already is not needed: the unit of an entity, its domain.
        named = sorted(tags, key=lambda c: (not _POINT.match(c) or c in ("_field", "_measurement"), -head[c].nunique()))
        point: list[str] = []
        n = len(head[tags].drop_duplicates()) if tags else 1
        for key in named:
            if not point or len(head[point].drop_duplicates()) < n:
                point.append(key)
        # What has none of these tags, as of another program, is named by its own.
        for key in sorted(named, key=lambda c: c == "_measurement"):
            nameless = head[[c for c in point if c not in ("_field", "_measurement")]].isna().all(axis=1)
            if key not in (*point, "_field") and head.loc[nameless, key].notna().any():
                point.insert(0, key)
        if not point:
            given = [
                c
                for c in columns
                if c not in ("_value", "result", "table", "", "_start", "_stop") and not _numbers(head[c])
            ]
            point = (
                [c for c in given if c == "entity_id"]
                or [c for c in given if c not in ("_measurement", "host")]
                or given
            )
        return TableForm(point=point[0] if len(point) == 1 else tuple(point), value="_value")
    columns = [c for c in columns if not _UNIT_COLUMN.match(c)]
    again = of_stamps <= set(map(str, head.columns)) and head[list(of_stamps)].duplicated().mean() > 0.2
    told = [c for c in columns if _VALUE.match(c)]
    # A "reading" may be the name of one, beside its value; a "state" what a program thinks of it.
    values = [c for c in told if _numbers(head[c])] or _only_numbers(head, columns, again) or told
    values = values or [c for c in columns if _of_quantities(head[c])][:1]
    points = [c for c in columns if (_points(head, c, again) or c.lower() == "reading") and c not in values]
    repeated = [
        c for c in columns
        if c not in values and not _STATUS.match(c) and 1 < head[c].nunique() <= max(2, len(head) / 3)
        and not _numbers(head[c]) and not _BESIDE.match(c)
        and not set(head[c].dropna().astype(str).str.lower()) <= set(SWITCH)
    ]  # fmt: skip
    if not values or not (points or repeated):
        numeric = [c for c in columns if _numbers(head[c]) and not _points(head, c, again)]
        if not (len(numeric) == 1 and (repeated or points) and again):
            return None
        values = numeric
    first = {v.lower() for v in values}
    ours = [keys for keys in _VALUES_OF if keys[0] in first]
    by_lower = {c.lower(): c for c in columns}
    value = [by_lower[k] for k in ours[0] if k in by_lower] if ours else values[:1]
    ids = [c for c in points if re.search(r"(?i)name|entity|statistic|bezeichnung|naam|nom|tag|point|path", c)]
    # Of a sender and what it was sent to, the one of which there are more.
    ids = ids or sorted((c for c in repeated if re.search(r"(?i)name$", c)), key=lambda c: -head[c].nunique())
    point = (
        [c for c in ids if not _numbers(head[c])][:1]
        or ids[:1]
        or [c for c in points if not _numbers(head[c])][:1]
        or repeated[:1]
        or points[:1]
    )
    if not point:
        return None
    unique = head[[*point, *[c for c in of_stamps if c in head.columns]]].duplicated().mean() < 0.05
    for more in (*points, *repeated):
        of_device = _QUANTITY_COLUMN.match(more) and _DEVICE_COLUMN.match(point[0])
        if (not unique or of_device) and more not in point and not _numbers(head[more]):
            if len(head[[*point, more]].drop_duplicates()) == len(head[point].drop_duplicates()):
                continue  # another column tells it already
            point.append(more)
            unique = head[[*point, *[c for c in of_stamps if c in head.columns]]].duplicated().mean() < 0.05
    asking = [c for c in columns if not _numbers(head[c]) and (head[c] == QUESTION).any()]
    known = [c for c in columns if c.lower() in ("status", "quality", "reliability") and c not in value]
    status = next(iter(asking + known), None)
    return TableForm(
        point=point[0] if len(point) == 1 else tuple(point),
        value=value[0] if len(value) == 1 else tuple(value),
        status=status,
    )
