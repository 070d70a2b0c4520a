"""A table that a machine appends to: what cannot be read is left out, with a note that names line and reason.

A power failure tears a line or leaves a block of NUL, a restart writes the header again or a stamp of 1970, a sensor
writes ERR. A person who hands in a table mends it; here the rest goes on.
"""

from __future__ import annotations

import csv
import io
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.errors import DataError, counted
from thermoforce_mpc.measurements.map.entries import Clock, CsvFormat
from thermoforce_mpc.measurements.tables.clock import parsed_or_nat
from thermoforce_mpc.measurements.tables.files import PARQUET, header_of, opened, read_table, reading
from thermoforce_mpc.measurements.tables.raw_table import RawTable, as_numbers, known_column, raw_table

# A stamp so far from its place in the file is none, s; after the clock it is none where few rows have such.
_FAR_S, _FEW = 86400.0, 0.01
_SHOWN = 60
# Cells that are empty, in the words of pandas and of databases.
_EMPTY = ("", "nan", "NaN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A")


@dataclass
class _Left:
    """What was left out of a file: lines and reasons."""

    name: str
    unit: str
    lines: dict[str, list[tuple[int, str]]] = field(default_factory=dict)

    def add(self, reason: str, line: int, what: str = "") -> None:
        self.lines.setdefault(reason, []).append((line, what[:_SHOWN]))

    def notes(self) -> list[str]:
        """A note per reason, which names its last line."""
        out = []
        for reason, found in self.lines.items():
            line, what = found[-1]
            more = f" ({counted(len(found), f'such {self.unit}')})" if len(found) > 1 else ""
            out.append(f"{self.name}, {self.unit} {line}: {reason}{f', {what!r}' if what else ''}{more}: left out")
        return out


def read_appended(
    path: Path, columns: Sequence[str], clock: Clock, form: CsvFormat, latest: pd.Timestamp, notes: list[str]
) -> RawTable:
    """As `read_table`, without the lines and cells that cannot be read; `notes` collects them.

    Of rows stamped after `latest` few are wrong, and many left as they are.

    Raises `DataError` where no row is left, or a column is missing.
    """
    if path.suffix in PARQUET:
        return read_table(path, clock.column, columns, form)
    with reading(path):
        separator, names, keys = header_of(path, clock.column, columns, form)
        with opened(path) as file:
            content = file.read()
    left = _Left(str(path), "line")
    lines, rows = _rows(content, form, separator, names, left)
    frame = pd.DataFrame(rows, columns=names, dtype=str)[keys]
    frame = frame.mask(frame.isin({*_EMPTY, *form.missing}))
    return _cleaned(frame, keys[0], columns, clock, latest, lines, left, notes, form.decimal)


def frame_appended(
    df: pd.DataFrame, columns: Sequence[str], clock: Clock, latest: pd.Timestamp, notes: list[str]
) -> RawTable:
    """As `raw_table` of a data frame, without the rows and cells that cannot be read; `notes` collects them."""
    of_stamps = isinstance(df.index, pd.DatetimeIndex) or df.index.dtype.kind == "O"
    if of_stamps and clock.column in (None, df.index.name):
        df = df.rename_axis(index=str(df.index.name or "time")).reset_index()
    elif not len(df.columns):
        raise DataError("table: the table has no columns")
    stamps = str(df.columns[0]) if clock.column is None else clock.column
    keys = [known_column(key, df.columns, "table") for key in dict.fromkeys([stamps, *columns])]
    left = _Left("table", "row")
    return _cleaned(
        df[keys].reset_index(drop=True), stamps, columns, clock, latest, np.arange(1, len(df) + 1), left, notes, "."
    )


def _cleaned(
    frame: pd.DataFrame,
    stamps: str,
    columns: Sequence[str],
    clock: Clock,
    latest: pd.Timestamp,
    lines: NDArray[np.intp],
    left: _Left,
    notes: list[str],
    decimal: str,
) -> RawTable:
    """The rows of `frame`, which stand at `lines` (n,), whose time can be read, and what is a number in them."""
    frame = frame.copy()
    for key in frame.columns:
        if key != stamps and not pd.api.types.is_numeric_dtype(frame[key]):
            frame[key] = _numbers(frame[key], key, decimal, lines, left)
    keep = _with_stamps(frame[stamps], clock, latest, lines, left)
    frame, lines = frame[keep].reset_index(drop=True), lines[keep]
    notes += left.notes()
    if frame.empty:
        raise DataError(f"{left.name}: nothing of it can be read ({'; '.join(left.notes()[:3]) or 'it has no rows'})")
    if clock.unit is not None:
        frame[stamps] = pd.to_numeric(frame[stamps])
    return raw_table(frame, stamps, columns, left.name, lines if left.unit == "line" else 1)


def _rows(
    content: bytes, form: CsvFormat, separator: str, names: list[str], left: _Left
) -> tuple[NDArray[np.intp], list[list[str]]]:
    """Line numbers and cells of the lines that can be split into as many cells as there are `names`."""
    rows: list[list[str]] = []
    numbers: list[int] = []
    text = content.decode(form.encoding, errors="replace")
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if number <= form.skip_lines + 1 or not line.strip():
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
        cells = line.split(separator) if '"' not in line else next(csv.reader([line], delimiter=separator), [])
        if len(cells) == len(names) + 1 and not cells[-1].strip():
            cells.pop()
        cells = [cell.strip() for cell in cells]
        if cells == names:
            left.add("the header again", number)
        elif len(cells) != len(names):
            left.add(f"{counted(len(cells), 'cell')}, the header has {len(names)}", number, line)
        else:
            rows.append(cells)
            numbers.append(number)
    return np.array(numbers, dtype=np.intp), rows


def _numbers(column: pd.Series, key: str, decimal: str, lines: NDArray[np.intp], left: _Left) -> pd.Series:
    column = column.mask(column.isin(_EMPTY))
    numbers = as_numbers(column, decimal)
    for row in np.flatnonzero((numbers.isna() & column.notna()).to_numpy()):
        left.add(f"column '{key}' holds no number", int(lines[row]), str(column.iloc[row]))
    return numbers.astype(float)


def _with_stamps(
    text: pd.Series, clock: Clock, latest: pd.Timestamp, lines: NDArray[np.intp], left: _Left
) -> NDArray[np.bool_]:
    """Which rows (n,) have a stamp that is a time, and not far from the rows before and after it."""
    if pd.api.types.is_datetime64_any_dtype(text):
        at = text.dt.tz_localize("UTC") if text.dt.tz is None else text.dt.tz_convert("UTC")
    else:
        at = parsed_or_nat(text, clock)
    keep = np.array(at.notna())
    for row in np.flatnonzero(~keep):
        left.add("no time stamp", int(lines[row]), str(text.iloc[row]) if isinstance(text.iloc[row], str) else "")
    rows = np.flatnonzero(keep)
    at_s = np.asarray((at[keep] - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), dtype=np.float64)
    far = _far(at_s)
    late = at_s > latest.timestamp()
    if late.any() and late.sum() <= max(1, _FEW * late.size):
        far |= late
    for row in rows[far]:
        left.add("a time far from those of the rows around", int(lines[row]), str(text.iloc[row]))
    keep[rows[far]] = False
    return keep


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
