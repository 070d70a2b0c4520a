"""A table that a machine appends to: what cannot be read is left out, with a note that names line and reason.

A power failure tears a line or leaves a block of NUL, a restart writes the header again or a stamp of 1970, a sensor
writes ERR. A person who hands in a table mends it; here the rest goes on.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from bisect import bisect_right
from codecs import BOM_UTF8
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.clock import CLOCKS_S
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.errors import DataError, counted
from thermoforce_mpc.measurements.tables.ahead import before_set_back
from thermoforce_mpc.measurements.tables.clock import newest_first, parsed_or_nat
from thermoforce_mpc.measurements.tables.files import (
    another_header,
    cells_of,
    columns_of,
    header_of,
    is_text,
    opened,
    read_tables,
    reading,
)
from thermoforce_mpc.measurements.tables.forms import CsvFormat, TableForm, TimeStampRules, Written, each_column
from thermoforce_mpc.measurements.tables.raw_table import (
    MISSING,
    MOST_BESIDE,
    RawTable,
    as_numbers,
    bad_status,
    in_units,
    known_column,
    of_one_signal,
    other_unit,
    raw_table,
    tables_of,
    told_by_others,
    told_points,
    with_numbers,
)
from thermoforce_mpc.scenario.settings import suggestion

# A stamp so far from its place in the file is none, s; after the clock it is none where few rows have such.
_FAR_S, _FEW = 86400.0, 0.01
# Stamps of a wall clock go back in autumn, s.
_HOUR_TWICE_S = 3600.0
# So far from most others, where rows are not in the order of time, and so long before the next ones.
_FAR_FROM_MOST_S = 5 * 365 * 86400.0
_EMPTY = frozenset(("", "nan", "NaN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A", *MISSING))
_SHOWN = 60
# Rows before the last one whose cells tell how one of its last column ends, and how many must.
_BEFORE, _LEAST_BEFORE = 100, 8


@dataclass
class _Left:
    """What was left out of a file: lines and reasons."""

    name: str
    unit: str = "line"
    lines: dict[str, list[tuple[int, str]]] = field(default_factory=dict)

    def add(self, reason: str, line: int, what: str = "") -> None:
        self.lines.setdefault(reason, []).append((line, what[:_SHOWN]))

    def add_all(self, other: _Left, line: int) -> None:
        """What was left out of a part of the file, `line` of whose lines came before it."""
        for reason, found in other.lines.items():
            self.lines.setdefault(reason, []).extend((line + at, what) for at, what in found)

    def notes(self) -> list[str]:
        """A note per reason, which names its last line."""
        out = list[str]()
        for reason, found in self.lines.items():
            line, what = found[-1]
            more = f" ({counted(len(found), f'such {self.unit}')})" if len(found) > 1 else ""
            text = f"{self.name}, {self.unit} {line}: {reason}{f', {what!r}' if what else ''}{more}: left out"
            out.append(Note(text, f"{self.name}: {reason}", len(found)))
        return out


def read_appended(
    paths: Sequence[Path],
    wanted: Sequence[str],
    written: Callable[[Path], Written],
    latest: pd.Timestamp,
    notes: list[str],
    may_lack: Collection[str] = (),
    units: Mapping[str, str] | None = None,
    now: pd.Timestamp | None = None,
) -> list[RawTable]:
    """As `read_tables`, without the lines and cells that cannot be read; `notes` collects them.

    Of rows stamped after `latest` few are wrong, and many left as they are. Where no row is of a time to come, `now` is
    the time: rows from before a clock was set back are wrong, however many. Raises `DataError` where no file can be
    read, or one that cannot may have columns that are missing, or these are not among those it `may_lack`.
    """
    found: list[RawTable] = []
    known: dict[str, None] = {}
    refused: list[DataError] = []
    for path in paths:
        of = written(path)
        clock = of.time.lenient()
        try:
            if not is_text(path):
                found += [replace(one, clock=clock) for one in read_tables([path], wanted, written, notes, units)]
                known |= dict.fromkeys(name for one in found for name in one.names)
                continue
            here = _read(path, wanted, clock, of.csv, of.table, (latest, now), notes, known, units or {})
        except DataError as error:  # one that was begun a moment ago, and has no row yet
            refused.append(error)
            continue
        if here is not None:
            found.append(replace(here, clock=clock))
    missing = [key for key in wanted if key not in known]
    if refused and (not found or not set(missing) <= set(may_lack)):
        raise refused[0]
    notes += [f"{error}: left out" for error in refused]
    for key in missing:
        if key in may_lack:
            notes.append(away(key, list(known), str(paths[0])))
        else:
            known_column(key, pd.Index(list(known)), str(paths[0]))
    return found


def away(key: str, names: Sequence[str], table: str) -> Note:
    """That a table with columns `names` has the column `key` no more."""
    text = f"{table}: column '{key}' is not there any more{suggestion(key, names)}: what it measures is unknown"
    return Note(
        f"{text} until it is back; if it was renamed, name it in the map and start again", f"{table}: {key} away"
    )


def _read(
    path: Path,
    wanted: Sequence[str],
    clock: TimeStampRules,
    form: CsvFormat,
    table: TableForm,
    times: tuple[pd.Timestamp, pd.Timestamp | None],
    notes: list[str],
    known: dict[str, None],
    units: Mapping[str, str],
) -> RawTable | None:
    """The `wanted` signals of a file, None where it has none; `known` collects the names of its signals.

    `times`: `latest` and `now` of `read_appended`.
    """
    with reading(path):
        separator, names, header, cells = header_of(path, form)
        with opened(path) as file:
            content = file.read()
    stamps, _ = columns_of(path, names, clock.column, form, table, wanted)
    sections = _sections(content, _Section(tuple(names), tuple(cells), 0, header), separator, form, stamps[0])
    units_of = tuple(units.get(key, "") for key in wanted)
    texts, parts, left = list[_Text](), list[_Part](), _Left(str(path))
    for number, (section, body) in enumerate(sections):
        of = path, list(section.names), tuple(stamps), form, table
        known |= dict.fromkeys(columns_of(*of, None)[1] if table.point is None else ())
        if not (values := columns_of(*of, wanted)[1]):
            continue
        text = _Text(
            str(path), section.names, section.cells, separator, tuple(stamps), values, tuple(wanted), units_of, clock,
            form, table, number,
        )  # fmt: skip
        first = section.header + 1 + form.skip_after
        read = _parts(text, body, first) or [_part(text, body, first)]
        texts.append(text)
        parts += [replace(part, line=section.line + part.line) for part in read]
    if not texts:
        return None
    if len(sections) > 1:
        notes.append(_of_headers(path, [section for section, _ in sections], wanted))
    for part in parts:
        left.add_all(part.left, part.line)
        known |= dict.fromkeys(part.known)
    found = _joined(texts[0], parts, *times, left)
    notes += left.notes()
    if found is None:
        raise DataError(f"{path}: nothing of it can be read ({'; '.join(left.notes()[:3]) or 'it has no rows'})")
    return found


@dataclass(frozen=True)
class _Section:
    """Lines of a file under one header: `line` come before them, line `header` of them (from 0) names the columns."""

    names: tuple[str, ...]
    cells: tuple[str, ...]
    line: int
    header: int = 0


def _sections(
    content: bytes, first: _Section, separator: str, form: CsvFormat, stamp: str
) -> list[tuple[_Section, bytes]]:
    """A file parted where another header stands that names the column `stamp` too, with the lines of each section.

    A logger that is started with another sensor, or another order of them, goes on in its file below a new one.
    """
    written = first.cells[first.names.index(stamp)]
    if not written or form.encoding.lower().startswith("utf-16"):  # nothing to look for
        return [(first, content)]
    name, ends = written.encode(form.encoding).removeprefix(BOM_UTF8), separator.encode() + b'"\r\n '
    found, begins, at = [first], [0], 0
    for _ in range(first.header + 1):
        at = content.find(b"\n", at) + 1 or len(content)
    while (at := content.find(name, at)) >= 0:
        before, at = content[at - 1 : at], at + len(name)
        if before not in ends or content[at : at + 1] not in ends:
            continue
        begin, end = content.rfind(b"\n", 0, at) + 1, content.find(b"\n", at)
        if end < 0:  # it is still being written
            break
        at, told = end, found[-1].cells
        cells = cells_of(content[begin:end].decode(form.encoding, "replace"), separator)
        if tuple(cells) == told or not another_header(cells, told) or len({*cells}) < len(cells):
            continue
        line = found[-1].line + content.count(b"\n", begins[-1], begin)
        found.append(_Section(tuple(stamp if cell == written else cell for cell in cells), tuple(cells), line))
        begins.append(begin)
    return [
        (one, content[begin:end]) for one, (begin, end) in zip(found, pairwise([*begins, len(content)]), strict=True)
    ]


def _of_headers(path: Path, sections: Sequence[_Section], wanted: Sequence[str]) -> Note:
    """That the columns of a file are called otherwise from a line on."""
    last, before = sections[-1], {name for section in sections[:-1] for name in section.names}
    lost = [f"'{key}'{suggestion(key, last.names)}" for key in wanted if key in before and key not in last.names]
    text = f"{path}, line {last.line + 1}: another header: its columns are read by their names"
    text += f"; from there on there is no {', '.join(lost)}" if lost else ""
    return Note(text, f"{path}: another header", len(sections) - 1)


@dataclass(frozen=True)
class _Text:
    """How the text of a file is read: its columns (`cells`: as they stand there), and what is wanted of it.

    `units`: of those wanted, see `raw_table`; `section`: how many of other columns stand before it in the file.
    """

    name: str
    names: tuple[str, ...]
    cells: tuple[str, ...]
    separator: str
    stamps: tuple[str, ...]
    values: dict[str, str]
    wanted: tuple[str, ...]
    units: tuple[str, ...]
    clock: TimeStampRules
    form: CsvFormat
    table: TableForm
    section: int = 0

    @property
    def in_parts(self) -> bool:
        """Whether a line means the same whatever stands before it."""
        plain = self.form.encoding.lower() in ("utf-8", "utf8", "utf-8-sig", "ascii", "latin-1", "cp1252")
        return plain and self.clock.year is None and (self.clock.zone is not None or self.clock.unit is not None)


@dataclass(frozen=True)
class _Part:
    """What lines of a file say, `line` of which came before: rows with a time that are wanted, and what was left out.

    `table`: None without such rows; its `line` counts within the part. `at` (n,): their times, UTC, those without an
    offset (`offset`) as if they were of UTC. `alone`: whether other lines do not change what these say.
    """

    line: int
    count: int
    table: RawTable | None
    at: pd.Series
    offset: NDArray[np.bool_]
    left: _Left
    known: tuple[str, ...]
    alone: bool = True


def _joined(
    text: _Text, parts: Sequence[_Part], latest: pd.Timestamp, now: pd.Timestamp | None, left: _Left
) -> RawTable | None:
    """One table of the rows of parts, without those whose time cannot be right; None where none is left."""
    tables = [replace(part.table, line=part.line + np.asarray(part.table.line)) for part in parts if part.table]
    if not tables:
        return None
    at, offset = pd.concat([part.at for part in parts], ignore_index=True), np.concatenate([p.offset for p in parts])
    lines = np.concatenate([np.asarray(one.line) for one in tables])
    codes = [one.codes for one in tables if one.codes is not None]
    keep = _with_times(at, offset, latest, lines, left, in_order=not text.table.points)
    if now is not None:
        signal = np.concatenate(codes) if codes else np.zeros(len(at), dtype=np.int32)
        _leave_set_back(keep, (at, offset), signal, text.clock.zone, now, lines, left)
    if not keep.any():
        return None
    if text.clock.unit is not None or text.clock.zone is None:
        stamps = pd.concat([one.stamps for one in tables], ignore_index=True)
    else:
        stamps = at if offset[keep][0] else at.dt.tz_localize(None)
    columns = {}
    for key in dict.fromkeys(key for one in tables for key in one.columns):
        of = [one.columns[key] if key in one.columns else np.full(len(one.stamps), np.nan) for one in tables]
        columns[key] = np.concatenate(of)[keep]
    beside: dict[str, Array] = {}
    for one in tables:
        for name, values in one.beside.items():
            beside[name] = np.append(beside.get(name, values[:0]), values)[:MOST_BESIDE]
    return replace(
        tables[0],
        stamps=stamps[keep].reset_index(drop=True),
        columns=columns,
        line=lines[keep],
        codes=np.concatenate(codes)[keep] if codes else None,
        beside=beside,
    )


PART_BYTES = 2**19
"""Size of a part of a file that is kept: half a tenth of a second to read."""
# Files of which parts are kept: of a year with one a day.
_MOST_FILES = 400


class PartsKept:
    """Parts of files that were read last, by how they are read and what stands there: of a log only the end is new."""

    def __init__(self) -> None:
        self._of_files: OrderedDict[tuple[Any, ...], dict[bytes, _Part]] = OrderedDict()

    def turn_over(self, key: tuple[Any, ...]) -> tuple[dict[bytes, _Part], dict[bytes, _Part]]:
        """What was known of a file, and an empty place for what is known of it from now on."""
        before = self._of_files.pop(key, {})
        here = self._of_files[key] = {}
        while len(self._of_files) > _MOST_FILES:
            self._of_files.popitem(last=False)
        return before, here


PARTS = PartsKept()
"""The parts that this process keeps."""


def _parts(text: _Text, content: bytes, first: int) -> list[_Part] | None:
    """A file read in parts, of which those that were read before are known; None where it has to be read as a whole.

    A part is known by its bytes, so that a file that is cut, mended or written anew is read as it stands.
    """
    begin = 0
    for _ in range(first):
        begin = content.find(b"\n", begin) + 1
        if not begin:
            return None
    if not text.in_parts:
        return None
    cuts = [begin]
    while len(content) - cuts[-1] > 2 * PART_BYTES and (end := content.find(b"\n", cuts[-1] + PART_BYTES) + 1):
        cuts.append(end)
    key = (
        text.name,
        text.section,
        text.names,
        text.wanted,
        text.units,
        *(one.model_dump_json() for one in (text.clock, text.form, text.table)),
    )
    before, here = PARTS.turn_over(key)
    parts, line = list[_Part](), first
    for cut, end in pairwise([*cuts, len(content)]):
        digest = hashlib.blake2b(memoryview(content)[cut:end], digest_size=16).digest()
        part = here[digest] = before.get(digest) or _part(text, content[cut:end], 0)
        if not part.alone and len(cuts) > 1:
            return None
        parts.append(replace(part, line=line))
        line += part.count
    return parts


def _part(text: _Text, content: bytes, first: int) -> _Part:
    """What lines from `first` on say."""
    form, table, stamps, points = text.form, text.table, text.stamps, text.table.points
    status = [table.status] if table.status in text.names else []
    keys = list(dict.fromkeys([*stamps, *points, *text.values.values(), *status]))
    left, names, alone = _Left(text.name), list(text.names), True
    if (whole := _whole(content, form, first, text.separator, names, keys)) is not None:
        lines, frame = whole
        count = len(frame)
    else:
        lines, rows, count, alone = _rows(content, form, first, text.separator, list(text.cells), left)
        frame = pd.DataFrame(rows, columns=names, dtype=str)[keys]
    frame = with_numbers(frame.mask(frame.isin({*_EMPTY, *form.missing})), form.words, form.decimal)
    of_signal = dict(zip(text.wanted, text.units, strict=True))
    units = of_signal if points else {column: of_signal.get(key, "") for key, column in text.values.items()}
    told = told_points(frame, points) if points else None
    ours = np.ones(len(frame), dtype=bool) if told is None else np.asarray(told.isin(text.wanted))
    for key in dict.fromkeys(text.values.values()):
        in_units = all(text.units) if points else bool(units[key])
        alone = alone and (in_units or not told_by_others(frame[key], form.decimal))
        frame[key] = _numbers(frame[key], key, form.decimal, lines, left, ours, told, units)
    written = frame[stamps[0]]
    for more in stamps[1:]:
        written = written + " " + frame[more]
    at, offset, read = _stamped(written, text.clock, lines, left)
    frame, lines, at, offset = frame[read].reset_index(drop=True), lines[read], at[read], offset[read]
    if frame.empty:
        return _Part(0, count, None, at, offset, left, (), alone)
    if text.clock.unit is not None:
        frame[stamps[0]] = pd.to_numeric(frame[stamps[0]])
    if points:
        (one,) = tables_of(frame, stamps, text.wanted, table, text.name, np.arange(len(frame)), strict=False)
        ours = np.asarray(one.line)
        known = (*one.points, *one.beside)
        one = replace(one, line=lines[ours])
        at, offset = at.iloc[ours], offset[ours]
    else:
        one = raw_table(frame, stamps, list(dict.fromkeys(text.values.values())), text.name, lines)
        bad = bad_status(frame, table)
        columns = {key: np.where(bad, np.nan, one.columns[of]) for key, of in text.values.items()}
        known = ()
        one = (
            replace(one, columns=columns)
            if table.by_file != "point"
            else of_one_signal(one, next(iter(columns)), columns)
        )
    at = at.reset_index(drop=True)
    if text.clock.unit is None and text.clock.zone is not None:  # what is kept for the next reading is not text
        one = replace(one, stamps=at)
    return _Part(0, count, one, at, offset, left, known, alone)


def frame_appended(
    df: pd.DataFrame,
    columns: Sequence[str],
    clock: TimeStampRules,
    latest: pd.Timestamp,
    notes: list[str],
    units: Mapping[str, str] | None = None,
    now: pd.Timestamp | None = None,
) -> RawTable:
    """As `raw_table` of a data frame, without the rows and cells that cannot be read; `notes` collects them.

    `latest`, `now`: as of `read_appended`.
    """
    df = in_units(df, units)
    of_stamps = isinstance(df.index, pd.DatetimeIndex) or not pd.api.types.is_numeric_dtype(df.index)
    if of_stamps and clock.column in (None, df.index.name):
        df = df.rename_axis(index=str(df.index.name or "time")).reset_index()
    elif not len(df.columns):
        raise DataError("table: the table has no columns")
    stamps = each_column(str(df.columns[0]) if clock.column is None else clock.column)
    keys = [known_column(key, df.columns, "table") for key in dict.fromkeys([*stamps, *columns])]
    frame, left, rows = df[keys].reset_index(drop=True).copy(), _Left("table", "row"), np.arange(1, len(df) + 1)
    for key in keys[len(stamps) :]:
        if not pd.api.types.is_numeric_dtype(frame[key]):
            cells = frame[key].mask(frame[key].isin(_EMPTY))
            frame[key] = _numbers(cells, key, ".", rows, left, np.ones(len(frame), dtype=bool), None, units or {})
    at = frame[stamps[0]]
    for more in stamps[1:]:
        at = at.astype(str) + " " + frame[more].astype(str)
    times, offset, keep = _stamped(at, clock, rows, left)
    keep[keep] = _with_times(times[keep], offset[keep], latest, rows[keep], left, in_order=True)
    if now is not None:
        _leave_set_back(keep, (times, offset), np.zeros(len(times), dtype=np.int32), clock.zone, now, rows, left)
    frame = frame[keep].reset_index(drop=True)
    notes += left.notes()
    if frame.empty:
        raise DataError(f"table: nothing of it can be read ({'; '.join(left.notes()[:3]) or 'it has no rows'})")
    if clock.unit is not None:
        frame[stamps[0]] = pd.to_numeric(frame[stamps[0]])
    return raw_table(frame, stamps, columns, "table")


def _whole(
    content: bytes, form: CsvFormat, first: int, separator: str, names: list[str], keys: list[str]
) -> tuple[NDArray[np.intp], pd.DataFrame] | None:
    """Line numbers and cells of the columns `keys` of the lines from `first` on, in a fraction of the time of `_rows`.

    None where any of them needs a look of its own: torn, quoted, with spaces around cells, not of ASCII.
    """
    begin = 0
    for _ in range(first):
        begin = content.find(b"\n", begin) + 1
        if not begin:
            return None
    body, n = content[begin:].replace(b"\r\n", b"\n"), len(names)
    comments = form.comment is not None and (b"\n" + form.comment.encode()) in b"\n" + body
    plain = form.encoding.lower() in ("utf-8", "utf8", "utf-8-sig", "ascii") and not comments and n > 1
    if not plain or separator.isspace() or not separator.isascii() or not body.isascii() or body[-1:] != b"\n":
        return None
    mark, codes = separator.encode(), np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    marks = np.diff(np.searchsorted(np.flatnonzero(codes == ord(separator)), ends), prepend=0)
    spaced = any(of in body for of in (b" " + mark, mark + b" ", b"\n ", b" \n")) or body[:1] == b" "
    if b'"' in body or spaced or (marks != n - 1).any() or np.count_nonzero(codes < ord(" ")) != ends.size:
        return None
    frame = pd.read_csv(
        io.BytesIO(body), sep=separator, header=None, names=list(range(n)), usecols=[names.index(key) for key in keys],
        dtype=str, na_filter=False, quoting=csv.QUOTE_NONE, skip_blank_lines=False,
    )  # fmt: skip
    frame = frame[[names.index(key) for key in keys]].set_axis(keys, axis=1)
    if (frame[keys[0]] == keys[0]).any():  # the header again
        return None
    return np.arange(first + 1, first + 1 + len(frame), dtype=np.intp), frame


def _rows(
    content: bytes, form: CsvFormat, first: int, separator: str, names: list[str], left: _Left
) -> tuple[NDArray[np.intp], list[list[str]], int, bool]:
    """Line numbers and cells of the lines from `first` on that can be split into as many cells as there are `names`.

    And how many lines there are, and whether others do not change what these say.
    """
    rows: list[list[str]] = []
    numbers: list[int] = []
    number = 0
    longer: dict[int, tuple[int, str]] = {}
    text = content.decode(form.encoding, errors="replace")
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if number <= first or not line.strip() or (form.comment and line.startswith(form.comment)):
            continue
        line = line.rstrip("\n")
        if "\x00" in line:
            line = line.replace("\x00", "").lstrip("\ufeff")
            left.add("NUL bytes", number, line)
            if not line.strip():
                continue
        if "\ufffd" in line:
            left.add(f"is not {form.encoding}", number, line)
            continue
        cells = cells_of(line, separator)
        if len(cells) == len(names) + 1 and not cells[-1].strip():
            cells.pop()
            longer[len(rows)] = number, line
        if cells == names:
            left.add("the header again", number)
        elif len(cells) != len(names):
            left.add(f"{counted(len(cells), 'cell')}, the header has {len(names)}", number, line)
        else:
            rows.append(cells)
            numbers.append(number)
    open_end = text[-1:] not in ("\n", "\r") and len(rows) - 1 not in longer
    if rows and open_end and numbers[-1] == number:
        _leave_cut(rows, numbers[-1], left)
    alone, longer = not longer, {row: of for row, of in longer.items() if row < len(rows)}
    if 2 * len(longer) <= len(rows):  # not as its rows end: a line that was torn, with the next one behind it
        for number, line in longer.values():
            left.add(f"{counted(len(names) + 1, 'cell')}, the header has {len(names)}", number, line)
        kept = [row for row in range(len(rows)) if row not in longer]
        rows, numbers = [rows[row] for row in kept], [numbers[row] for row in kept]
    return np.array(numbers, dtype=np.intp), rows, number, alone


def _leave_cut(rows: list[list[str]], number: int, left: _Left) -> None:
    """Empty the last cell of a file that ends in it, for it may still be being written: 21.35 begins as 2.

    It is whole where all before it have as many decimals as it, or end with the same unit.
    """
    *before, last = (row[-1] for row in rows[-_BEFORE - 1 :])
    ends = {re.sub(r"^[+-]?\d+", "", re.sub(r"\d", "0", cell)) for cell in before if cell not in _EMPTY}
    whole = len(ends) == 1 and len(before) >= _LEAST_BEFORE and "" not in ends
    if last and not (whole and re.sub(r"^[+-]?\d+", "", re.sub(r"\d", "0", last)) in ends):
        left.add("no end of line: its last cell may be cut off", number, last)
        rows[-1] = [*rows[-1][:-1], ""]


def _numbers(
    column: pd.Series,
    key: str,
    decimal: str,
    lines: NDArray[np.intp],
    left: _Left,
    ours: NDArray[np.bool_],
    points: pd.Series[str] | None,
    units: Mapping[str, str],
) -> pd.Series:
    numbers = as_numbers(column, decimal, points, units)
    for row in np.flatnonzero((numbers.isna() & column.notna()).to_numpy() & ours):
        cell, name = str(column.iloc[row]), key if points is None else points.iloc[row]
        reason = other_unit(cell, decimal, units.get(name, "")) or "holds no number"
        left.add(f"column '{name}' {reason}", int(lines[row]), cell)
    return numbers.astype(float)


def _stamped(
    written: pd.Series, clock: TimeStampRules, lines: NDArray[np.intp], left: _Left
) -> tuple[pd.Series, NDArray[np.bool_], NDArray[np.bool_]]:
    """Times of stamps (n,) as they are `written`, UTC, which have an offset, and which are times at all."""
    at, offset = parsed_or_nat(written, clock)
    read = np.array(at.notna())
    for row in np.flatnonzero(~read):
        left.add("no time stamp", int(lines[row]), written.iloc[row] if isinstance(written.iloc[row], str) else "")
    return at, offset, read


def _with_times(
    at: pd.Series,
    offset: NDArray[np.bool_],
    latest: pd.Timestamp,
    lines: NDArray[np.intp],
    left: _Left,
    *,
    in_order: bool,
) -> NDArray[np.bool_]:
    """Which rows (n,) have a time that is of the clock of most, and not far from the rows before and after it, or from
    most.
    """
    few = offset if 2 * int(offset.sum()) < offset.size else ~offset
    reason = (
        "its stamp has no offset from UTC, as most have"
        if offset.sum() * 2 >= offset.size
        else ("its stamp has an offset from UTC, as most have not")
    )
    keep = ~few
    for row in np.flatnonzero(few):
        left.add(reason, int(lines[row]), _second(at.iloc[row]))
    rows = np.flatnonzero(keep)
    if not rows.size:
        return keep
    at_s = np.asarray((at[keep] - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), dtype=np.float64)
    if in_order and newest_first(at_s):
        far = _far(at_s[::-1])[::-1]
    else:
        far = _far(at_s) if in_order else np.abs(at_s - np.median(at_s)) > _FAR_FROM_MOST_S
    late = at_s > latest.timestamp()
    if late.any() and late.sum() <= max(1, _FEW * late.size):
        far |= late
    far |= at_s < _since_gap(at_s[~far & ~late])
    for row in rows[far]:
        left.add("a time far from those of the rows around", int(lines[row]), _second(at.iloc[row]))
    keep[rows[far]] = False
    return keep


def _since_gap(at_s: NDArray[np.float64]) -> float:
    """The time after the last gap of years, s: a clock without a battery begins in 1970, also in a file of its own."""
    in_order = np.sort(at_s)
    gaps = np.flatnonzero(np.diff(in_order) > _FAR_FROM_MOST_S)
    return float(in_order[gaps[-1] + 1]) if gaps.size else -np.inf


def _leave_set_back(
    keep: NDArray[np.bool_],
    stamped: tuple[pd.Series, NDArray[np.bool_]],
    signal: NDArray[np.int32],
    zone: str | None,
    now: pd.Timestamp,
    lines: NDArray[np.intp],
    left: _Left,
) -> None:
    """Keep no row (n,) of those that a clock stamped before it was set back; `stamped`: times and which have an offset,
    see `_Part`."""
    at, offset = stamped
    wall = now.tz_convert(zone).tz_localize(None).tz_localize("UTC") if zone else now
    latest_s = np.where(offset, now.timestamp(), wall.timestamp() + _HOUR_TWICE_S) + CLOCKS_S
    wrong = np.flatnonzero(keep)[before_set_back(at[keep], signal[keep], latest_s[keep])]
    for row in wrong:
        left.add("stamped after the clock, which was set back since", int(lines[row]), _second(at.iloc[row]))
    keep[wrong] = False


def _second(at: pd.Timestamp) -> str:
    return f"{at:%Y-%m-%d %H:%M:%S}"


def _far(at_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which times (n,) do not fit the longest rising sequence of days: more than a day before or after their place."""
    if at_s.size < 2 or (np.diff(at_s) > -_FAR_S).all():
        return np.zeros(at_s.size, dtype=bool)
    day = np.floor(at_s / _FAR_S)
    tails: list[float] = []
    ends: list[int] = []
    before = np.full(at_s.size, -1)
    for i, value in enumerate(day.tolist()):
        place = bisect_right(tails, value)
        before[i] = ends[place - 1] if place else -1
        if place == len(tails):
            tails.append(value)
            ends.append(i)
        else:
            tails[place], ends[place] = value, i
    rising = np.zeros(at_s.size, dtype=bool)
    i = ends[-1]
    while i >= 0:
        rising[i] = True
        i = int(before[i])
    places = np.flatnonzero(rising)
    at = np.searchsorted(places, np.arange(at_s.size))
    earlier = at_s[places[np.maximum(at - 1, 0)]]
    later = at_s[places[np.minimum(at, places.size - 1)]]
    return np.asarray(~rising & ((at_s < earlier - _FAR_S) | (at_s > later + _FAR_S)))
