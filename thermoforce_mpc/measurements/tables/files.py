"""Files of measurements to columns of numbers: CSV, Parquet and workbooks, one file or many, bounded in size."""

from __future__ import annotations

import bz2
import codecs
import csv
import glob
import gzip
import importlib.util
import itertools
import lzma
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.files import check_regular, pyarrow_for
from thermoforce_mpc.measurements.tables.clock import instants
from thermoforce_mpc.measurements.tables.forms import CsvFormat, TableForm, TimeStampRules, Written, each_column
from thermoforce_mpc.measurements.tables.line_protocol import columns_of_lines, frames_of_lines, is_line_protocol
from thermoforce_mpc.measurements.tables.raw_table import (
    MISSING,
    RawTable,
    bad_status,
    known_column,
    of_one_signal,
    questions,
    raw_table,
    readings_table,
    with_numbers,
)
from thermoforce_mpc.scenario.settings import suggestion

Stamps: TypeAlias = str | tuple[str, ...] | None
Lines: TypeAlias = int | NDArray[np.int64]

# What is read at once, bytes when unpacked: about 15 million rows of six columns, in 4 GB of memory.
MOST_BYTES = 1_000_000_000
_COMPRESSED: dict[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
_BLOCK, _LOOKED_AT = 1_000_000, 100_000
PARQUET = (".parquet", ".pq")
WORKBOOKS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
# How files begin that are no text, and what they are.
_MAGIC = {
    b"\x89PNG": "a picture (PNG)", b"\xff\xd8\xff": "a picture (JPEG)", b"GIF8": "a picture (GIF)", b"%PDF": "a PDF",
    b"SQLite format 3": "a database (SQLite): export its readings as CSV", b"\x89HDF": "an HDF5 file",
    b"PAR1": "a Parquet file: name it .parquet", b"PK\x03\x04": "a workbook or an archive: name it .xlsx, or unpack it",
    b"\x1f\x8b": "packed (gzip): name it .csv.gz", b"BZh": "packed (bzip2): name it .csv.bz2",
    b"\xfd7zXZ": "packed (xz): name it .csv.xz", b"\xd0\xcf\x11\xe0": "an old workbook: name it .xls",
}  # fmt: skip
# How text begins that is no table, behind a mark of its encoding.
_NO_TABLE = {
    re.compile(rb"(\xef\xbb\xbf)?\s*(\[\s*[\[{\"\d-]|\[\s*\]|\{)"): "JSON",
    re.compile(rb"(?i)(\xef\xbb\xbf)?\s*<(!doctype )?html"): "a page of the web (HTML)",
    re.compile(rb"(\xef\xbb\xbf)?\s*<[?!a-zA-Z]"): "XML",
}
# Rows that are read at once where each is one reading: their text takes ten times the memory of their numbers.
_ROWS_AT_ONCE = 250_000
# Readings that are kept of signals outside the map; from a gap of so long in all signals on the logger stood still.
_FIRST, _LEAST_ROWS, _LEAST_OUTAGE_NS = 2000, 100, 7.2e12
# A trend report of Siemens names its points above the table, as "Point_1:","ROOM TEMP".
_POINTS = re.compile(r'^"?(Point_\d+):"?[,;\t]"?([^"\r\n]*?)"?(?:[,;\t]|\s*$)')
# Bytes of one value of a table; a Parquet file may pack a million equal ones into a few.
_CELL = 8
# How rows below a table begin that sum it up.
_SUMMARY = re.compile(
    r"(?i)^\W*(grand total|total|sum|average|avg|mean|median|min|minimum|max|maximum|std|summe|gesamt|mittel|"
    r"mittelwert|durchschnitt|somme|moyenne|totaal|gemiddelde|som|totale|media|totalt|medel|gennemsnit|gjennomsnitt)\W*(?:[,;\t|]|$)"
)
SEPARATORS = ",;\t|"
"""What may stand between the cells of a line."""
# What reading a damaged file raises: the errors of pandas and of text that cannot be decoded are ValueErrors.
_DAMAGED = (ValueError, OSError, EOFError, LookupError, csv.Error, lzma.LZMAError, zlib.error, MemoryError)


def found_files(patterns: Sequence[str | Path], most_bytes: int = MOST_BYTES) -> list[Path]:
    """The files of paths and patterns (`data/*.csv`), each once.

    Raises `DataError` for none, a device or pipe, or more than `most_bytes` when unpacked.
    """
    files: list[Path] = []
    for item in patterns:
        path = Path(item)
        if path.is_dir():
            raise DataError(f"{path}: is a folder; name its files, as in '{path}/*.csv'")
        matches = [path] if path.exists() else [Path(name) for name in sorted(glob.glob(str(item)))]
        if not matches:
            raise DataError(f"{item}: no such file")
        files += [match for match in matches if match not in files]
    if not files:
        raise DataError("no file of measurements was given")
    sizes = [_unpacked_bytes(path, most_bytes) for path in files]
    if sum(sizes) > most_bytes:
        largest = files[int(np.argmax(sizes))]
        amount = f"{sum(sizes) / 1e9:.1f}"
        if largest.suffix in _COMPRESSED:
            amount = f"unpacked more than {most_bytes / 1e9:.1f}"
        raise DataError(
            f"{largest}: {amount} GB to read{' in all' if len(files) > 1 else ''}, at most "
            f"{most_bytes / 1e9:.1f} GB are read at once: keep the columns of the map and the last year, or write "
            "means over a minute to a Parquet file; a model needs a few weeks. In Python `most_bytes` of "
            "`read_measurements` raises it"
        )
    return files


def _unpacked_bytes(path: Path, most_bytes: int) -> int:
    """Unpacked bytes of a file, counted to a little more than `most_bytes`; raises `DataError` as `found_files`."""
    check_regular(path, DataError)
    if path.suffix not in _COMPRESSED:
        return path.stat().st_size
    n = 0
    with reading(path), opened(path) as file:
        while n <= most_bytes and (piece := file.read(_BLOCK)):
            n += len(piece)
    return n


def named_after(path: Path, form: CsvFormat) -> str:
    """The name that a file gives its readings: that of a line `history:` above its header, else its own."""
    stem = path.name
    while Path(stem).suffix.lower() in (*_COMPRESSED, *PARQUET, *WORKBOOKS, ".csv", ".txt", ".tsv"):
        stem = Path(stem).stem
    if path.suffix.lower() in (*PARQUET, *WORKBOOKS) or not form.skip_lines:
        return stem
    with reading(path), opened(path, "rt", form.encoding) as lines:
        for line in itertools.islice(iter(lambda: lines.readline(_BLOCK), ""), form.skip_lines):
            told = re.match(r"\W*history:([^,;\t]*)", line, re.I)
            if told and (name := told[1].strip(' "\r\n/').rpartition("/")[2]):
                return name
    return stem


def named_before(path: Path, form: CsvFormat, table: TableForm) -> str:
    """The name before those of the columns of a file; '' where none is."""
    if table.by_file == "folder":
        return path.resolve().parent.name
    return named_after(path, form) if table.by_file == "prefix" else ""


def read_tables(
    paths: Sequence[Path],
    wanted: Sequence[str],
    written: Callable[[Path], Written],
    notes: list[str],
    units: Mapping[str, str] | None = None,
) -> list[RawTable]:
    """The time stamps and `wanted` signals of files, each as it is `written`; `units` by signal: see `raw_table`.

    A file need not hold all of them; `notes` is told of one that holds none. Raises `DataError`, with column and line,
    for one that cannot be read, is empty, or holds text in one, and where one of `wanted` is in no file.
    """
    tables: list[RawTable] = []
    known: dict[str, None] = {}
    for path in paths:
        found: list[RawTable] = []
        form, table = (of := written(path)).csv, of.table
        parts = _parts(path, form)
        for part in parts:
            stamps: Stamps = of.time.column
            if stamps is None and part is not parts[0] and parts[0].names[0] in part.names:
                stamps = parts[0].names[0]  # the first column, wherever another header has it
            if table.point is not None:
                found += _of_readings(part, stamps, wanted, form, table, units)
                known |= dict.fromkeys(name for one in found for name in (*_present(one), *one.beside))
            else:
                column_of = _signals(part, stamps, form, table)
                known |= dict.fromkeys(column_of)
                found += _of_columns(part, stamps, wanted, column_of, form, table, units)
        if not found and len(paths) > 1:
            notes.append(f"{path}: holds none of the columns of the map: left out")
        tables += [replace(one, clock=of.time) for one in found if len(one.stamps)]
    for key in wanted:
        known_column(key, pd.Index(list(known)), str(paths[0]))
    if not tables:
        raise DataError(f"{paths[0]}: the map names no column")
    return tables


def _present(table: RawTable) -> list[str]:
    """Signals of a table of one reading a row that have one."""
    return [table.points[k] for k in np.unique(table.codes if table.codes is not None else [])]


def stamps_of(path: Path, stamps: Stamps, form: CsvFormat) -> RawTable:
    """The time stamps of a file alone."""
    part = _parts(path, form)[0]
    keys = _keys(part, stamps)
    df, line = next(part.frames(list(keys), None))
    return raw_table(df, keys or None, [], str(path), line)


def all_readings(
    paths: Sequence[Path], clock: TimeStampRules, form: CsvFormat, table: TableForm
) -> dict[str, tuple[Array, Array, dict[str, int]]]:
    """Seconds and values of every signal of files of one reading a row, and the words in it; for a first look.

    Stamps that cannot be read count as a quarter of an hour apart.
    """
    names: dict[str, int] = {}
    wordy: dict[str, Counter[str]] = {}
    pieces = []
    for path in paths:
        for part in _parts(path, form):
            given = [key for key in table.values if key in part.names]
            keys = _keys(part, clock.column)
            told = [*keys, *table.points, *given, *([table.status] if table.status in part.names else [])]
            for df, line in part.frames(list(dict.fromkeys(told)), _ROWS_AT_ONCE):
                piece = readings_table(df, keys or None, table, str(path), line, form.decimal).with_instants()
                assert piece.codes is not None
                codes = np.array([names.setdefault(name, len(names)) for name in piece.points])[piece.codes]
                for name, words in piece.wordy.items():
                    wordy.setdefault(name, Counter()).update(words)
                at = piece.stamps
                if not pd.api.types.is_datetime64_any_dtype(at):
                    try:
                        at = instants(piece, clock.model_copy(update={"zone": None}), []).sort_index()
                    except DataError:
                        at = pd.Series(
                            pd.Timestamp("2025-01-01") + pd.to_timedelta(np.arange(len(at)) * 900.0, unit="s")
                        )
                at = at.dt.tz_convert(None) if getattr(at.dtype, "tz", None) is not None else at
                pieces.append((codes, at.astype("datetime64[ns]").to_numpy().astype("int64") / 1e9, piece.columns[""]))
    codes, time_s, readings = (np.concatenate(column) for column in zip(*pieces, strict=True))
    order = np.lexsort((time_s, codes))
    codes, time_s, readings = codes[order], time_s[order], readings[order]
    edges = np.searchsorted(codes, np.arange(len(names) + 1))
    return {
        name: (time_s[a:b], readings[a:b], dict(wordy.get(name, {})))
        for name, a, b in zip(names, edges[:-1], edges[1:], strict=True)
    }


def check_columns(paths: Sequence[str | Path], wanted: Sequence[str], written: Callable[[Path], Written]) -> None:
    """Refuse files that lack a column or are too large; raises `DataError` as `found_files` and `read_tables`.

    Where each row is one reading the signals are known only when all is read.
    """
    found, known, all_known = found_files(paths), dict[str, None](), True
    for path in found:
        form, table, stamps = (of := written(path)).csv, of.table, of.time.column
        parts = _parts(path, form, scan=False)
        if table.point is not None:
            for key in table.points:
                known_column(key, pd.Index(parts[0].names), str(path))
            all_known = False
        else:
            known |= dict.fromkeys(name for part in parts for name in _signals(part, stamps, form, table))
    for key in wanted if all_known else ():
        known_column(key, pd.Index(list(known)), str(found[0]))


def head_of(path: Path, rows: int, form: CsvFormat) -> pd.DataFrame:
    """The first `rows` rows of a file with all its columns, stamps (or index) first; raises `DataError`."""
    part = _parts(path, form, scan=False)[0]
    with reading(path, " as CSV"):
        df, _ = next(part.frames(None, rows))
    df = df.iloc[:rows]
    if len(df.columns):
        first = df.iloc[:, 0].astype(str)
        words = df.iloc[:, 1:].isna().all(axis=1) & ~first.str.contains(r"\d", regex=True) & (len(df.columns) > 1)
        summary = first.str.match(_SUMMARY)
        df = df[(first != str(df.columns[0])) & ~words & ~summary]  # without the header again, and what stands below
    return df.reset_index() if isinstance(df.index, pd.DatetimeIndex) else df


@dataclass(frozen=True)
class _Part:
    """Rows of a file under one line of column `names`; `frames` gives some of its columns, with the lines of rows.

    All of them for None, and at most so many rows at once.
    """

    path: Path
    names: list[str]
    frames: Callable[[Sequence[str] | None, int | None], Iterator[tuple[pd.DataFrame, Lines]]]


def _parts(path: Path, form: CsvFormat, *, scan: bool = True) -> list[_Part]:
    suffix = path.suffix.lower()
    if suffix in PARQUET:
        parts = [_parquet(path)]
    elif suffix in WORKBOOKS:
        parts = [_workbook(path, form)]
    elif not is_text(path):
        parts = [_line_protocol(path)]
    else:
        parts = _csv(path, form, scan=scan)
    return [replace(part, frames=partial(_numbered, part.frames, form)) for part in parts] if form.words else parts


def _numbered(
    frames: Callable[[Sequence[str] | None, int | None], Iterator[tuple[pd.DataFrame, Lines]]],
    form: CsvFormat,
    columns: Sequence[str] | None,
    rows: int | None,
) -> Iterator[tuple[pd.DataFrame, Lines]]:
    """Frames of a part of a file, with numbers in the place of words."""
    for df, line in frames(columns, rows):
        yield with_numbers(df, form.words, form.decimal), line


def _of_readings(
    part: _Part,
    stamps: Stamps,
    wanted: Sequence[str],
    form: CsvFormat,
    table: TableForm,
    units: Mapping[str, str] | None,
) -> Iterator[RawTable]:
    """A table of one reading a row, of the `wanted` signals; its stamps become instants early, since text is large."""
    points, values = table.points, table.values
    keys = _keys(part, stamps)
    given = [key for key in values if key in part.names] or list(values[:1])
    for key in (*keys, *points, *given):
        known_column(key, pd.Index(part.names), str(part.path))
    told = [*keys, *points, *given, *([table.status] if table.status in part.names else [])]
    pieces, beside = [], dict[str, Array]()
    code_of = {name: k for k, name in enumerate(dict.fromkeys(wanted))}
    at: list[pd.Series] = []
    for df, line in part.frames(list(dict.fromkeys(told)), _ROWS_AT_ONCE):
        lines: int | NDArray[np.int64] = line
        if (asks := questions(df, table)).any():
            lines = (line + np.arange(len(df)) if isinstance(line, int) else line)[~asks]
            df = df[~asks].reset_index(drop=True)
        piece = readings_table(df, keys or None, table, str(part.path), lines, form.decimal, wanted, units)
        piece = piece.with_instants()
        assert piece.codes is not None
        for k, name in enumerate(piece.points):
            if name not in code_of and len(beside.get(name, ())) < _FIRST:
                first = piece.columns[""][piece.codes == k][:_FIRST]
                beside[name] = np.concatenate([beside.get(name, np.empty(0)), first])
        codes = np.array([code_of.get(name, -1) for name in piece.points], dtype=np.int32)[piece.codes]
        ours = codes >= 0
        at.append(piece.stamps)
        ours_at = piece.line[ours] if not isinstance(piece.line, int) else piece.line + np.flatnonzero(ours)
        stamps_of = piece.stamps[ours].reset_index(drop=True)
        pieces.append((stamps_of, piece.columns[""][ours], ours_at, codes[ours]))
    stamps_of_all = [piece[0] for piece in pieces]
    if len({str(one.dtype) for one in at}) > 1:  # some stamps are of another form: messages name them
        stamps_of_all, at = [one.astype(str) for one in stamps_of_all], []
    yield RawTable(
        str(part.path),
        pd.concat(stamps_of_all, ignore_index=True),
        {"": np.concatenate([piece[1] for piece in pieces])},
        np.concatenate([piece[2] for piece in pieces]),
        tuple(code_of),
        np.concatenate([piece[3] for piece in pieces]),
        beside,
        _outages(at),
    )


def _outages(stamps: Sequence[pd.Series]) -> tuple[tuple[pd.Timestamp, pd.Timestamp], ...]:
    """From when to when no signal at all has a reading: the logger stood still, not the values."""
    if not stamps or getattr(stamps[0].dtype, "tz", None) is None:
        return ()
    at = np.unique(np.concatenate([pd.DatetimeIndex(one).as_unit("ns").asi8 for one in stamps]))
    apart = np.diff(at)
    if apart.size < _LEAST_ROWS:
        return ()
    most = max(_LEAST_OUTAGE_NS, 4.0 * float(np.percentile(apart, 99.0)), 10.0 * float(np.median(apart)))
    return tuple(
        (pd.Timestamp(at[k], tz="UTC"), pd.Timestamp(at[k + 1], tz="UTC")) for k in np.flatnonzero(apart > most)
    )


def _of_columns(
    part: _Part,
    stamps: Stamps,
    wanted: Sequence[str],
    column_of: dict[str, str],
    form: CsvFormat,
    table: TableForm,
    units: Mapping[str, str] | None,
) -> Iterator[RawTable]:
    here = [key for key in dict.fromkeys(wanted) if key in column_of]
    if not here:
        return
    keys = _keys(part, stamps)
    for key in (*keys, *(column_of[key] for key in here)):
        known_column(key, pd.Index(part.names), str(part.path))
        if part.names.count(key) > 1:
            raise DataError(
                f"{part.path}: there are {part.names.count(key)} columns '{key}'; give each a name of its own"
            )
    read = [*keys, *(column_of[key] for key in here), *([table.status] if table.status in part.names else [])]
    df, line = next(part.frames(list(dict.fromkeys(read)), None))
    told = {column_of[key]: (units or {}).get(key, "") for key in here}
    found = raw_table(df, keys or None, list(told), str(part.path), line, form.decimal, told)
    bad = bad_status(df, table)
    columns = {key: np.where(bad, np.nan, found.columns[column_of[key]]) for key in here}
    yield replace(found, columns=columns) if table.by_file != "point" else of_one_signal(found, here[0], columns)


def _keys(part: _Part, stamps: Stamps) -> tuple[str, ...]:
    """Columns of the time stamps of a part; none where its index has them."""
    if stamps is None:
        return tuple(part.names[:1]) if part.path.suffix.lower() not in PARQUET else ()
    return each_column(stamps)


def _signals(part: _Part, stamps: Stamps, form: CsvFormat, table: TableForm) -> dict[str, str]:
    """Columns of a part by the names of its signals."""
    if table.by_file is None:
        return {name: name for name in part.names}
    if name := named_before(part.path, form, table):
        keys = _keys(part, stamps)
        return {f"{name} {column}": column for column in part.names if column not in keys}
    given = [column for column in table.values if column in part.names]
    return {named_after(part.path, form): given[0]} if given else {}


def columns_of(
    path: Path, names: list[str], stamps: Stamps, form: CsvFormat, table: TableForm, wanted: Sequence[str] | None
) -> tuple[list[str], dict[str, str]]:
    """Columns of the stamps of a file with columns `names`, and by signal (of `wanted`, None: all) its column.

    Where each row is one reading, the columns of readings, by their own names.
    """
    part = _Part(path, names, lambda columns, rows: iter(()))
    keys = _keys(part, stamps)
    if table.point is not None:
        given = [key for key in table.values if key in names] or list(table.values[:1])
        for key in (*keys, *table.points, *given):
            known_column(key, pd.Index(names), str(path))
        return list(keys), {key: key for key in given}
    column_of = _signals(part, stamps, form, table)
    for key in keys:
        known_column(key, pd.Index(names), str(path))
    here = column_of if wanted is None else {key: column_of[key] for key in wanted if key in column_of}
    for key in here.values():
        if names.count(key) > 1 and wanted is not None:
            raise DataError(f"{path}: there are {names.count(key)} columns '{key}'; give each a name of its own")
    return list(keys), here


def _parquet(path: Path) -> _Part:
    pyarrow = pyarrow_for(path, DataError)
    try:
        told = pyarrow.parquet.read_metadata(path)
        schema = told.schema.to_arrow_schema()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: no Parquet file that can be read ({_short(error)})") from error
    # The index of a data frame stands among the columns of its file.
    index = [name for name in (schema.pandas_metadata or {}).get("index_columns", []) if isinstance(name, str)]

    def frames(columns: Sequence[str] | None, rows: int | None) -> Iterator[tuple[pd.DataFrame, Lines]]:
        stamps = index or schema.names[:1]
        present = list(dict.fromkeys([*stamps, *(schema.names if columns is None else columns)]))
        if told.num_rows * len(present) * _CELL > MOST_BYTES:
            raise DataError(
                f"{path}: {told.num_rows:,} rows, more than {MOST_BYTES / 1e9:.0f} GB; write means or a part"
            )
        try:
            yield pyarrow.parquet.read_table(path, columns=present).to_pandas(ignore_metadata=True), 1
        except (pyarrow.ArrowException, OSError, ValueError) as error:
            raise DataError(f"{path}: no Parquet file that can be read ({_short(error)})") from error

    return _Part(path, list(schema.names), frames)


def _line_protocol(path: Path) -> _Part:
    with reading(path), opened(path, "rt", "utf-8") as lines:
        names = columns_of_lines(lines)

    def frames(columns: Sequence[str] | None, rows: int | None) -> Iterator[tuple[pd.DataFrame, Lines]]:
        told = names if columns is None else list(columns)
        with reading(path), opened(path, "rt", "utf-8") as lines:
            for df, at in frames_of_lines(lines, str(path), told, rows):
                yield df, np.array(at, dtype=np.int64)

    return _Part(path, names, frames)


def longest_sheet(path: Path, most: int) -> tuple[dict[str, int], str, list[str]]:
    """The number of rows of each sheet of a workbook, in its order, its longest sheet, and the first rows of that one
    as lines of text, cells parted by tabs; raises `DataError` for one that cannot be read."""
    with _workbook_of(path) as book:
        rows = {str(name): book.book.get_sheet_by_name(name).height for name in book.sheet_names}
        longest = max(rows, key=lambda name: rows[name])
        cells = _cells_of(book, path, CsvFormat(sheet=longest)).iloc[:most].to_numpy()
    lines = ["\t".join("" if pd.isna(cell) else str(cell).replace("\n", " ") for cell in row) for row in cells]
    return rows, longest, lines


@contextmanager
def _workbook_of(path: Path) -> Iterator[pd.ExcelFile]:
    """An open workbook; raises `DataError` for one that cannot be read."""
    if importlib.util.find_spec("python_calamine") is None:
        raise DataError(
            f"{path}: workbooks are read with python-calamine: pip install 'thermoforce-mpc[workbook]', or save the "
            "sheet as CSV"
        )
    check_regular(path, DataError)
    try:
        with pd.ExcelFile(path, engine="calamine") as book:
            yield book
    except DataError:
        raise
    except Exception as error:  # calamine raises its own errors, and those of damaged archives
        raise DataError(f"{path}: no workbook that can be read ({_short(error)})") from error


def _cells_of(book: pd.ExcelFile, path: Path, form: CsvFormat) -> pd.DataFrame:
    names = [str(name) for name in book.sheet_names]
    if form.sheet is not None and form.sheet not in names:
        raise DataError(f"{path}: no sheet '{form.sheet}'{suggestion(form.sheet, names)}; there are {', '.join(names)}")
    cells = pd.read_excel(book, sheet_name=form.sheet or 0, header=None, dtype=object)
    if len(cells) <= form.skip_lines:
        told = f" (there are {', '.join(names)})" if len(names) > 1 else ""
        raise DataError(f"{path}: the sheet is empty; name another as csv.sheet{told}")
    return cells


def _workbook(path: Path, form: CsvFormat) -> _Part:
    with _workbook_of(path) as book:
        cells = _cells_of(book, path, form)
    groups = [str(cell).strip() for cell in cells.iloc[form.skip_lines - 1].fillna("")] if form.skip_lines else []
    names = _told_apart([str(name).strip() for name in cells.iloc[form.skip_lines].fillna("")], groups)
    first = form.skip_lines + 1 + form.skip_after
    rows = cells.iloc[first:].dropna(how="all").set_axis(names, axis=1)
    lines = rows.index.to_numpy() + 1
    rows = rows.reset_index(drop=True).infer_objects()

    def frames(columns: Sequence[str] | None, most: int | None) -> Iterator[tuple[pd.DataFrame, Lines]]:
        yield (rows if columns is None else rows[list(columns)]), lines

    return _Part(path, names, frames)


def _csv(path: Path, form: CsvFormat, *, scan: bool = True) -> list[_Part]:
    """The parts of a CSV file; without `scan` its first alone, whose lines are not checked."""
    separator, names, header, cells = header_of(path, form)
    found: list[tuple[list[str], Array | None, int]] = [(names, None, len(names))]
    first = header + 1 + form.skip_after
    if scan:
        with reading(path, " as CSV"):
            found = _scanned(path, form, separator, cells, first)
        found = [(names if told == cells else _told_apart(told, []), lines, most) for told, lines, most in found]

    def frames_of(names: list[str], lines: Any, cells: int, columns: Any, rows: int | None) -> Any:
        if lines is not None and not lines.size:
            raise DataError(f"{path}: the table has no rows")
        told = names if columns is None else list(columns)
        # Cells of a longer row, as behind a separator at its end, are left out.
        more: dict[str, Any] = {"header": None, "index_col": False}
        skipped: Any = first
        if lines is not None and lines.size != lines[-1] + 1 - first:
            skipped = np.setdiff1d(np.arange(lines[-1] + 1), lines, assume_unique=True)
        if lines is not None:
            more |= {"nrows": int(lines.size), "names": range(cells), "usecols": [names.index(name) for name in told]}
        rules: dict[str, Any] = {
            "sep": separator, "decimal": form.decimal, "encoding": form.encoding, "skiprows": skipped,
            "na_values": [*MISSING, *form.missing], "skip_blank_lines": False, "low_memory": False,
            "skipinitialspace": True, "on_bad_lines": "skip" if lines is None else "error", **more,
        }  # fmt: skip

        def renamed(df: pd.DataFrame) -> pd.DataFrame:
            places = [int(place) for place in df.columns if int(place) < len(names)]
            return df[places].set_axis([names[place] for place in places], axis=1)

        with reading(path, " as CSV"), warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            if lines is None:
                try:
                    yield renamed(pd.read_csv(path, **rules | {"nrows": rows})), first + 1
                except pd.errors.EmptyDataError as error:
                    raise DataError(f"{path}: the table has no rows") from error
                return
            if rows is None:
                df = renamed(pd.read_csv(path, **rules))
                yield _without_end(df, lines)
                return
            read = 0
            for piece in pd.read_csv(path, chunksize=rows, **rules):
                yield renamed(piece).reset_index(drop=True), lines[read : read + len(piece)] + 1
                read += len(piece)

    return [_Part(path, names, partial(frames_of, names, lines, cells)) for names, lines, cells in found]


def _without_end(df: pd.DataFrame, lines: Any) -> tuple[pd.DataFrame, Lines]:
    """A table without empty rows at its end, and the lines of its rows (which a cell over two lines shifts)."""
    filled = df.notna().any(axis=1).to_numpy().nonzero()[0]
    df = df.iloc[: filled[-1] + 1 if filled.size else 0]
    return df, lines[: len(df)] + 1


def _scanned(path: Path, form: CsvFormat, separator: str, names: list[str], first: int) -> list[Any]:
    """Names, places of lines and most cells of each part of a CSV file, whose rows begin at line `first` (from 0).

    Left out are empty lines, those of comment, and the header where it comes again, as in exports joined end to end.
    Another header begins another part. Refuses rows with more or fewer cells than their header, whose values would land
    in wrong columns.
    """
    parts: list[tuple[list[str], list[Any]]] = [(names, [])]
    most = [len(names)]
    begun, may_begin = 0, False
    with opened(path, "rt", form.encoding) as lines:
        while block := lines.readlines(_BLOCK):
            kept = np.ones(len(block), dtype=bool)
            kept[: max(0, first - begun)] = False
            n = np.array([line.count(separator) for line in block])
            special = np.array([line[:1] in "\r\n" or line.startswith(form.comment or "\n") for line in block])
            begins = _may_head(block, parts[-1][0], separator)
            after = np.append(may_begin, special[:-1])
            may_begin = bool(special[-1])
            kept &= ~special
            start = 0
            for k in np.flatnonzero(kept & (begins | after | (n != len(parts[-1][0]) - 1))):
                cells = told = cells_of(block[k], separator)
                current = parts[-1][0]
                n[k] = max(len(cells), 1) - 1  # separators in quotes part no cells
                if told == current:
                    kept[k] = False
                    continue
                if told == names or another_header(told, current):
                    parts[-1][1].append(np.flatnonzero(kept[start:k]) + start + begun)
                    most[-1] = max(most[-1], int(n[start:k][kept[start:k]].max(initial=0)) + 1)
                    parts.append((told, []))
                    most.append(len(told))
                    kept[k], start = False, int(k)
                    continue
                if not any(told) or _is_footer(told) or _SUMMARY.match(block[k]):
                    kept[k] = False
                    continue
                expected = len(current)
                same = len(cells) in (0, expected) or (len(cells) == expected + 1 and not cells[-1]) or '"' in block[k]
                if not same:
                    raise DataError(
                        f"{path}, line {begun + k + 1}: has {len(cells)} cells, the line of column names "
                        f"{expected}: mend "
                        "or remove it (a decimal comma? a file that is still being written?)"
                    )
            parts[-1][1].append(np.flatnonzero(kept[start:]) + start + begun)
            most[-1] = max(most[-1], int(n[start:][kept[start:]].max(initial=0)) + 1)
            begun += len(block)
    return [
        (told, np.concatenate([np.empty(0, dtype=np.int64), *rows]), min(cells, len(told) + 1))
        for (told, rows), cells in zip(parts, most, strict=True)
    ]


def _may_head(lines: Sequence[str], names: Sequence[str], separator: str) -> NDArray[np.bool_]:
    """Which lines (n,) below a header of `names` may be another one, or begin a summary."""
    again, cell = _starts(names, separator), names[0] or "\n"  # of the lines below a header only another one has it
    named = cell + separator, separator + cell, f'"{cell}"'
    return np.array(
        [
            any(one in line for one in named) or line.startswith(again) or _SUMMARY.match(line) is not None
            for line in lines
        ]
    )


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of a line, without spaces around; what stands in quotes is one. Raises `csv.Error` for a huge one."""
    line = line.rstrip("\r\n")
    if '"' not in line and len(line) <= csv.field_size_limit():
        return [cell.strip() for cell in line.split(separator)] if line else []
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def another_header(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Whether the cells of a line name columns as the header above it does, of which half and more are its `names`."""
    shared = len(set(cells) & set(names) - {""})
    return shared > 1 and 2 * shared >= len(set(cells))


def _is_footer(cells: Sequence[str]) -> bool:
    """Whether a line is words alone, as "End of Report" below a table."""
    return not any(cells[1:]) and bool(re.fullmatch(r"[^\d\x00-\x1f]*[A-Za-z][^\d\x00-\x1f]*", cells[0]))


def _starts(names: Sequence[str], separator: str) -> tuple[str, str]:
    """How a header that comes again begins, without quotes and with."""
    return separator.join(names[:2]), separator.join(f'"{name}"' for name in names[:2])


def header_of(path: Path, form: CsvFormat) -> tuple[str, list[str], int, list[str]]:
    """Separator, names of the columns, the line (from 0) where these stand, and what stands there.

    Columns of the same name are told apart by what the line above says of each, as of groups of columns, else by
    numbers.
    """
    at, header, called, above = form.skip_lines, "", dict[str, str](), ""
    try:
        with reading(path, but=(UnicodeError,)), opened(path, "rt", form.encoding) as lines:
            parts = iter(lambda: lines.readline(_BLOCK), "")  # not the whole of a line without end
            for line in itertools.islice(parts, form.skip_lines):
                called |= _POINTS.findall(line)
                above = line
            for line in parts:
                header = line.lstrip("\ufeff").rstrip("\r\n")
                if header.strip() and not (form.comment and header.startswith(form.comment)):
                    break
                at += 1
            else:
                raise DataError(
                    f"{path}: the file is empty" if not form.skip_lines and not header.strip() else
                    f"{path}, line {form.skip_lines + 1}: no names of columns; set csv.skip_lines of the map"
                )  # fmt: skip
    except UnicodeError as error:
        with reading(path), opened(path) as file:
            _check_text(path, file.read(1000))
        raise DataError(
            f"{path}: is not {form.encoding} ({_short(error)}); set csv.encoding of the map: "
            "cp1252 for a file of Excel, utf-16 for its Unicode text"
        ) from error
    separator = form.separator or max(SEPARATORS, key=header.count)
    with reading(path, " as CSV"):
        cells, groups = (cells_of(line, separator) for line in (header, above))
    return separator, _told_apart([called.get(name, name) for name in cells], groups), at, cells


def _told_apart(names: list[str], groups: list[str]) -> list[str]:
    """Names of columns, of which none comes twice but an empty one; `groups`: the cells above them."""
    twice = {name for name, times in Counter(names).items() if times > 1 and name}
    if twice and len(groups) == len(names):
        group: list[str] = []
        for told in groups:  # merged cells are empty
            group.append(told or (group[-1] if group else ""))
        names = [f"{told} {name}".strip() if name in twice else name for told, name in zip(group, names, strict=True)]
        twice = {name for name, times in Counter(names).items() if times > 1 and name}
    count: Counter[str] = Counter()
    out = []
    for name in names:
        count[name] += 1
        out.append(f"{name} {count[name]}" if name in twice else name)
    return out


def is_text(path: Path) -> bool:
    """Whether a file is read as a table in text: by its suffix, and not of the line protocol."""
    if path.suffix.lower() in (*PARQUET, *WORKBOOKS):
        return False
    with reading(path), opened(path) as file:
        start = file.read(_LOOKED_AT).decode("utf-8", errors="replace").splitlines()
    return not is_line_protocol(start[:-1] or start)


# What programs write that is no table, by how it begins, and Python that makes one of it.
_PROGRAMS = (
    (
        re.compile(rb'\s*(<\?xml[^>]*>)?\s*<Statistics [^>]*Name="'),
        "Loxone's statistics",
        "import re; from pathlib import Path as P; t = P('{file}').read_text('utf-8'); rows = re.findall("
        "'T=.([-0-9: ]+). V=.([-0-9.]+)', t); P(re.search('Name=\\x22(.*?)\\x22', t)[1] + '.csv').write_text("
        "'time,value\\n' + ''.join(a + ',' + v + '\\n' for a, v in rows), 'utf-8')",
    ),
    (
        re.compile(rb'\s*\{\s*"name":\s*"[^"]*",\s*"datapoints"'),
        "what openHAB's persistence answers",
        "import json, pandas; from pathlib import Path as P; d = json.loads(P('{file}').read_text('utf-8')); "
        "pandas.DataFrame(d['data']).to_csv(d['name'] + '.csv', index=False)",
    ),
    (
        re.compile(rb"\s*\{[^\r\n]*\}\r?\n\s*\{"),
        "lines of JSON",
        "import json, pandas; from pathlib import Path as P; rows = P('{file}').read_text('utf-8').splitlines(); "
        "pandas.json_normalize([json.loads(r) for r in rows if r.strip()]).to_csv('lines.csv', index=False)",
    ),
    (
        re.compile(rb"\d{4}-\d{2}-\d{2}_\d{2}:\d{2}:\d{2} \S+ [^\s:]+: "),
        "a log of FHEM",
        "from pathlib import Path as P; rows = map(str.split, P('{file}').read_text('utf-8').splitlines()); "
        "P('fhem.csv').write_text('time;device;reading;value\\n' + ''.join(';'.join([r[0].replace('_', ' '), r[1], "
        "r[2][:-1], ' '.join(r[3:])]) + '\\n' for r in rows if len(r) > 3 and r[2][-1] == ':'), 'utf-8')",
    ),
)


def _check_text(path: Path, start: bytes) -> None:
    """Refuse what is no text and says so by how it begins: a picture is no code page."""
    if what := next((what for magic, what in _MAGIC.items() if start.startswith(magic)), ""):
        raise DataError(f"{path}: is no table but {what}")
    if start[:2] not in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) and start[:1000].count(b"\0") > 20:
        raise DataError(f"{path}: is no text: a table is CSV, Parquet or a workbook")
    for begins, what, code in _PROGRAMS:
        if begins.match(start):
            made = code.format(file=path.name)
            raise DataError(f'{path}: is {what}, no table. Make one of it, and of others: python -c "{made}"')
    if what := next((what for begins, what in _NO_TABLE.items() if begins.match(start)), ""):
        raise DataError(
            f"{path}: is {what}, no table: export it as CSV, a line of column names and then one of readings for each "
            "time; in Python `read_measurements` takes a data frame"
        )


def sample(path: Path) -> tuple[str, list[str]]:
    """Encoding and first lines of a text file: UTF-8, else UTF-16 or the code page of Excel.

    Raises `DataError` for one that is no text.
    """
    with reading(path), opened(path) as file:
        start = file.read(_BLOCK)
    _check_text(path, start)
    encoding = "utf-16" if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(start)  # the last character may be cut
    except UnicodeError:
        encoding, text = "cp1252", start.decode("cp1252", errors="replace")
    lines = text.lstrip("\ufeff").splitlines()
    return encoding, lines if len(start) < _BLOCK else lines[:-1]


def opened(path: Path, mode: str = "rb", encoding: str | None = None) -> Any:
    """A file, opened as it is packed."""
    return _COMPRESSED.get(path.suffix, open)(path, mode, encoding=encoding)


@contextmanager
def reading(path: Path, how: str = "", but: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Say which file is damaged; errors `but` go through."""
    try:
        yield
    except _DAMAGED as error:
        if isinstance(error, but):
            raise
        raise DataError(f"{path}: cannot be read{how} ({_short(error)})") from error


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
