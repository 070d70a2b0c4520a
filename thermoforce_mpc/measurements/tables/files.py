"""Files of measurements to columns of numbers: CSV and Parquet, one file or many, bounded in size."""

from __future__ import annotations

import bz2
import codecs
import csv
import glob
import gzip
import itertools
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.files import check_regular, pyarrow_for
from thermoforce_mpc.measurements.map.entries import CsvFormat
from thermoforce_mpc.measurements.tables.raw_table import RawTable, known_column, raw_table

# What is read at once, bytes when unpacked: about 15 million rows of six columns, in 4 GB of memory.
MOST_BYTES = 1_000_000_000
_COMPRESSED: dict[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
_BLOCK = 1_000_000
PARQUET = (".parquet", ".pq")
# Bytes of one value of a table; a Parquet file may pack a million equal ones into a few.
_CELL = 8
_SEPARATORS = ",;\t"
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


def read_table(path: Path, stamps: str | None, columns: Sequence[str], form: CsvFormat) -> RawTable:
    """The time stamps (column `stamps`, by default the first or the index) and `columns` of a file.

    Raises `DataError`, with column and line, for one that cannot be read, is empty, lacks a column or holds text in
    one.
    """
    if path.suffix in PARQUET:
        df, line = _parquet(path, stamps, columns), 1
    else:
        df, line = _csv(path, stamps, columns, form)
    return raw_table(df, stamps, columns, str(path), line, form.decimal)


def check_columns(path: Path, stamps: str | None, columns: Sequence[str], form: CsvFormat) -> None:
    """Refuse a file that lacks a column or is too large; raises `DataError` as `found_files` and `read_table`."""
    found_files([path])
    if path.suffix not in PARQUET:
        header_of(path, stamps, columns, form)
        return
    pyarrow = pyarrow_for(path, DataError)
    try:
        names = pyarrow.parquet.read_schema(path).names
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: no Parquet file that can be read ({_short(error)})") from error
    for key in (*([stamps] if stamps else []), *columns):
        known_column(key, pd.Index(names), str(path))


def _parquet(path: Path, stamps: str | None, columns: Sequence[str] | None) -> pd.DataFrame:
    """The table with time stamps (or index) and `columns`; None: all of them."""
    pyarrow = pyarrow_for(path, DataError)
    try:
        told = pyarrow.parquet.read_metadata(path)
        schema = told.schema.to_arrow_schema()
        # The index of a data frame stands among the columns of its file.
        index = [name for name in (schema.pandas_metadata or {}).get("index_columns", []) if isinstance(name, str)]
        stamp_columns = [stamps] if stamps else index or schema.names[:1]
        columns = schema.names if columns is None else columns
        present = [name for name in dict.fromkeys([*stamp_columns, *columns]) if name in schema.names]
        if told.num_rows * len(present) * _CELL > MOST_BYTES:
            raise DataError(
                f"{path}: {told.num_rows:,} rows, more than {MOST_BYTES / 1e9:.0f} GB; write means or a part"
            )
        table = pyarrow.parquet.read_table(path, columns=present).to_pandas()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: no Parquet file that can be read ({_short(error)})") from error
    missing = [name for name in columns if name not in schema.names]
    if missing:
        known_column(missing[0], pd.Index(schema.names), str(path))
    return table


def _csv(path: Path, stamps: str | None, columns: Sequence[str], form: CsvFormat) -> tuple[pd.DataFrame, int]:
    separator, names, keys = header_of(path, stamps, columns, form)
    places = sorted(names.index(key) for key in keys)
    with reading(path, " as CSV"):
        _check_lines(path, form, separator, len(names))
    # Blank lines are kept, so that the number of a row tells its line.
    more: dict[str, Any] = {
        "usecols": places,
        "na_values": list(form.missing),
        "skip_blank_lines": False,
        "low_memory": False,
    }
    df = _frame(path, form, separator, **more).set_axis([names[place] for place in places], axis=1)
    filled = df.notna().any(axis=1).to_numpy().nonzero()[0]
    return df.iloc[: filled[-1] + 1 if filled.size else 0], form.skip_lines + 2


def header_of(
    path: Path, stamps: str | None, columns: Sequence[str], form: CsvFormat
) -> tuple[str, list[str], list[str]]:
    """Separator and names of the columns, and those that are read; raises `DataError` where one is not there."""
    separator, names = _header(path, form)
    keys = list(dict.fromkeys([names[0] if stamps is None else stamps, *columns]))
    for key in keys:
        known_column(key, pd.Index(names), str(path))
        if names.count(key) > 1:
            raise DataError(f"{path}: there are {names.count(key)} columns '{key}'; give each a name of its own")
    return separator, names, keys


def _check_lines(path: Path, form: CsvFormat, separator: str, n: int) -> None:
    """Refuse lines with more or fewer than `n` cells, whose values would land in wrong columns."""
    with opened(path, "rt", form.encoding) as lines:
        begun = 1
        while block := lines.readlines(_BLOCK):
            for k in np.flatnonzero(np.array([line.count(separator) for line in block]) != n - 1):
                cells = next(csv.reader([block[k].rstrip("\r\n")], delimiter=separator), [])
                same = len(cells) in (0, n) or (len(cells) == n + 1 and not cells[-1]) or '"' in block[k]
                if begun + k > form.skip_lines + 1 and not same:
                    raise DataError(
                        f"{path}, line {begun + k}: has {len(cells)} cells, the line of column names {n}: mend or "
                        "remove it (a decimal comma? a file that is still being written?)"
                    )
            begun += len(block)


def head_of(path: Path, rows: int, form: CsvFormat) -> pd.DataFrame:
    """The first `rows` rows of a file with all its columns, stamps (or index) first; raises `DataError`."""
    if path.suffix in PARQUET:
        df = _parquet(path, None, None).iloc[:rows]
        return df.reset_index() if isinstance(df.index, pd.DatetimeIndex) else df
    separator, names = _header(path, form)
    with reading(path, " as CSV"):  # its columns may be fewer than the names
        return _frame(path, form, separator, nrows=rows, index_col=False).set_axis(names, axis=1)


def _frame(path: Path, form: CsvFormat, separator: str, **more: Any) -> pd.DataFrame:
    with reading(path, " as CSV"):
        rules: dict[str, Any] = {"decimal": form.decimal, "encoding": form.encoding, "skiprows": form.skip_lines}
        return pd.read_csv(path, sep=separator, **rules, **more)


def guessed_form(path: Path) -> CsvFormat:
    """How a CSV file seems to be written: UTF-8, else UTF-16 or the code page of Excel; decimal point or comma."""
    if path.suffix in PARQUET:
        return CsvFormat()
    with reading(path), opened(path) as file:
        start = file.read(_BLOCK)
    encoding = "utf-16" if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8"
    decoder = codecs.getincrementaldecoder(encoding)
    try:
        text = decoder().decode(start)  # the last character may be cut
    except UnicodeError:
        encoding, text = "cp1252", start.decode("cp1252", errors="replace")
    form = CsvFormat(encoding=encoding)
    separator, _ = _header(path, form)
    cells = "" if separator == "," else text.partition("\n")[2]
    cell = rf"(?:^|[{separator}\"])-?\d+{{}}\d+(?=[{separator}\"\r\n]|$)"
    points, commas = (len(re.findall(cell.format(mark), cells, re.M)) for mark in (r"\.", ","))
    return CsvFormat(encoding=encoding, decimal="," if commas > points else ".")


def _header(path: Path, form: CsvFormat) -> tuple[str, list[str]]:
    try:
        with reading(path, but=(UnicodeError,)), opened(path, "rt", form.encoding) as lines:
            parts = iter(lambda: lines.readline(_BLOCK), "")  # not the whole of a line without end
            header = next(itertools.islice(parts, form.skip_lines, None), "").lstrip("\ufeff").rstrip("\r\n")
            if not header.strip():
                if not any(line.strip() for line in lines):
                    raise DataError(f"{path}: the file is empty")
                raise DataError(
                    f"{path}, line {form.skip_lines + 1}: no names of columns; set csv.skip_lines of the map"
                )
    except UnicodeError as error:
        raise DataError(
            f"{path}: is not {form.encoding} ({_short(error)}); set csv.encoding of the map: "
            "cp1252 for a file of Excel, utf-16 for its Unicode text"
        ) from error
    separator = form.separator or max(_SEPARATORS, key=header.count)
    with reading(path, " as CSV"):
        names = next(csv.reader([header], delimiter=separator, skipinitialspace=True))
    return separator, [name.strip() for name in names]


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
