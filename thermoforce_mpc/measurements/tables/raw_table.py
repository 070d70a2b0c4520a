"""Columns of one table as they stand there: numbers, and time stamps of any kind."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.tables.forms import TableForm, TimeStampRules
from thermoforce_mpc.measurements.units import UNITS, Unit, in_unit, unit_named, unit_of_map
from thermoforce_mpc.scenario.settings import suggestion

# Words of a column that says on or off, in the languages of the maps.
_ON = (
    "on", "ein", "an", "true", "open", "opened", "auf", "offen", "ouvert", "marche", "aan", "active", "running", "yes",
    "på", "til", "tændt", "åben", "öppen", "åpen", "päällä", "käynnissä",
)  # fmt: skip
_OFF = (
    "off", "aus", "false", "closed", "zu", "geschlossen", "fermé", "arrêt", "uit", "inactive", "idle", "stopped", "no",
    "av", "fra", "slukket", "lukket", "stängd", "pois", "seis",
)  # fmt: skip
SWITCH = dict.fromkeys(_ON, 1.0) | dict.fromkeys(_OFF, 0.0)
"""Numbers of words that say on or off."""
# Names of what a thermostat does now (Zigbee2MQTT, Home Assistant), and its words beside `idle` and `off`; those of a
# mode, which it was asked for, say nothing of that.
_ACTION = re.compile(r"(?:running_state|hvac_action)$")
_ACTIONS = {"heat": 1.0, "heating": 1.0, "cool": 1.0, "cooling": 1.0, "fan_only": 0.0, "fan": 0.0}
# A number and the unit behind it.
_QUANTITY = re.compile(r"([+-]?\d[\d.,'’\s]*?)\s*([^\d\s.,'’+-][^\d]{0,10}2?)")
# A number and its status, and what says that it is none.
_STATUS_BEHIND = re.compile(r"(.*\S)\s*\{([^{}]*)\}(?: @ \w+)?")
_NOT_GOOD = frozenset(("fault", "down", "stale", "null", "disabled"))
# A telegram in front of what it says, as '0C 3F | 21.3 °C'.
_TELEGRAM = re.compile(r"[$0-9a-fA-F ]+\| *")
# Words of programs for a reading that there is not, beside those that pandas knows.
MISSING = ("unavailable", "unknown", "undefined", "undef", "uninitialized", "no data", "-", "--", "---")
ISO = re.compile(r"\s*\d{4}-\d{2}-\d{2}")
"""How stamps begin that are of the form 2025-01-31T14:30."""
OFFSET = "(?:[+-][0-9]{2}(?::?[0-9]{2})?|Z) *$"
"""How stamps end that have an offset from UTC; databases leave minutes out where there are none."""
_LOOKED_AT, _MOST_WORDS, _SHOWN_WORDS = 50, 20, 4
# One that says a state or mode.
_WORD = re.compile(r"\s*[^\W\d_][^\W\d]*(?:[ -][^\W\d]+)*\s*")
QUESTION = "GroupValueRead"
"""What a telegram of KNX is that asks for a reading."""
MOST_BESIDE = 2000
"""So many readings are kept of a signal that nobody asked for: what it is can be told from them."""
_NONE = frozenset((*MISSING, "", "nan", "null", "none", "n/a", "na"))


@dataclass(frozen=True)
class RawTable:
    """Columns of one file as they stand there: `stamps` (n,) of any kind, `columns` by name (n,) numbers.

    `line`: that of its first row in file `name` (1 where rows are counted, as in Parquet files and data frames), or the
    lines of all rows (n,). Where each row is one reading, `points` names the signals and `codes` (n,) says whose a
    row's is; the one column is named ''. `beside`: first readings of other signals; `outages`: from when to when
    nothing at all was stored, where the stamps are instants; `wordy`: words that signals hold, with how many.
    `clock`: how its stamps are read, where that is not as the map says of all.
    """

    name: str
    stamps: pd.Series
    columns: dict[str, Array]
    line: int | NDArray[np.int64] = 1
    points: tuple[str, ...] = ()
    codes: NDArray[np.int32] | None = None
    beside: dict[str, Array] = field(default_factory=dict)
    outages: tuple[tuple[pd.Timestamp, pd.Timestamp], ...] = ()
    wordy: dict[str, dict[str, int]] = field(default_factory=dict)
    clock: TimeStampRules | None = None

    def where(self, row: int) -> str:
        """Name of the file and place of a row in it."""
        if isinstance(self.line, int):
            return f"{self.name}, {'row' if self.line == 1 else 'line'} {row + self.line}"
        return f"{self.name}, line {self.line[row]}"

    def with_instants(self) -> RawTable:
        """This table with stamps of the form 2025-01-31T14:30 as instants, which take a tenth of the memory of text."""
        if pd.api.types.is_numeric_dtype(self.stamps) or pd.api.types.is_datetime64_any_dtype(self.stamps):
            return self
        text = self.stamps.astype(str)
        if not ISO.match(str(text.iloc[0])):
            return self
        offsets = with_offset(text)
        if not (offsets.all() or not offsets.any()):
            return self
        try:
            return replace(self, stamps=pd.to_datetime(full_offsets(text), format="ISO8601", utc=bool(offsets.all())))
        except (ValueError, OverflowError):
            return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its signals."""
        return tuple(self.columns) if self.codes is None else self.points


def raw_table(
    df: pd.DataFrame,
    stamps: str | tuple[str, ...] | None,
    columns: Sequence[str],
    name: str,
    line: int | NDArray[np.int64] = 1,
    decimal: str = ".",
    units: Mapping[str, str] | None = None,
) -> RawTable:
    """The time stamps and `columns` of a data frame (text with the mark `decimal`); raises as `read_tables` does.

    `units` by column: that its numbers get where its cells say one; default: that of the first such cell.
    """
    at = _stamps(df, stamps, name)
    if not len(df):
        raise DataError(f"{name}: the table has no rows")
    table = RawTable(name, at, {}, line)
    for key in dict.fromkeys(columns):
        unit = (units or {}).get(key, "")
        table.columns[key] = _numbers(df[known_column(key, df.columns, name)], key, table, decimal, unit)
    return table


def tables_of(
    df: pd.DataFrame,
    stamps: str | tuple[str, ...] | None,
    wanted: Sequence[str],
    form: TableForm,
    name: str,
    lines: NDArray[np.int64] | None = None,
    *,
    strict: bool = True,
    units: Mapping[str, str] | None = None,
) -> list[RawTable]:
    """The time stamps and `wanted` signals of a data frame by its form; raises as `read_tables` does.

    `lines` (n,): of the file where its rows stand. Where not `strict`, some signals may be missing. `units` by signal:
    see `raw_table`.
    """
    df = in_units(df, units)
    if form.point is None:
        return [raw_table(df, stamps, wanted, name, 1 if lines is None else lines, units=units)]
    if (asks := questions(df, form)).any():
        df, lines = df[~asks], (np.arange(1, len(df) + 1) if lines is None else lines)[~asks]
    table = readings_table(df, stamps, form, name, wanted=wanted, units=units)
    for key in wanted if strict else ():
        known_column(key, pd.Index(table.points), name)
    assert table.codes is not None
    beside = {
        point: table.columns[""][table.codes == k][:MOST_BESIDE]
        for k, point in enumerate(table.points)
        if point not in wanted
    }
    lines = np.arange(1, len(df) + 1) if lines is None else lines
    ours = np.array([point in wanted for point in table.points])[table.codes]
    codes = np.array([wanted.index(p) if p in wanted else -1 for p in table.points], dtype=np.int32)[table.codes]
    stamps_of = table.stamps[ours].reset_index(drop=True)
    return [
        replace(
            table,
            stamps=stamps_of,
            columns={"": table.columns[""][ours]},
            points=tuple(wanted),
            codes=codes[ours],
            line=lines[ours],
            beside=beside,
        )
    ]


def told_points(df: pd.DataFrame, points: Sequence[str]) -> pd.Series[str]:
    """The name of the signal of each row (n,): its cells in the columns `points` that are not empty, and a space."""
    told = df[points[0]].astype(str).str.strip()
    if len(points) == 1:
        return told
    parts = [df[point].astype(object).where(df[point].notna(), "").astype(str).str.strip() for point in points]
    told = parts[0]
    for more in parts[1:]:
        told = told + np.where((told != "") & (more != ""), " ", "") + more
    return told


def readings_table(
    df: pd.DataFrame,
    stamps: str | tuple[str, ...] | None,
    form: TableForm,
    name: str,
    line: int | NDArray[np.int64] = 1,
    decimal: str = ".",
    wanted: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> RawTable:
    """A data frame in which each row is one reading; raises `DataError` where one of a `wanted` signal is text.

    `units` by signal: see `raw_table`.
    """
    points, values = form.points, form.values
    for key in (*points, *values[:1]):
        known_column(key, df.columns, name)
    at = _stamps(df, stamps, name)
    if not len(df):
        raise DataError(f"{name}: the table has no rows")
    codes, names = pd.factorize(told_points(df, points))
    readings, wordy = np.full(len(df), np.nan), dict[str, dict[str, int]]()
    table = RawTable(name, at, {"": readings}, line, tuple(map(str, names)), codes.astype(np.int32))
    for key in values:
        if key not in df:
            continue
        empty = np.isnan(readings)
        told = [(units or {}).get(point, "") for point in table.points]
        numbers, texts = _with_texts(df[key], decimal, table.codes, told, table.points)
        for code in np.unique(codes[texts]):
            cells = df[key][texts & (codes == code)].astype(str).str.strip().value_counts()
            wordy[str(names[code])] = dict(zip(cells.index[:_MOST_WORDS], cells.tolist(), strict=False)) | {
                "": int(cells[_MOST_WORDS:].sum())
            }
        readings[empty] = numbers[empty]
        of_wanted = [int(row) for row in np.flatnonzero(texts) if table.points[codes[row]] in wanted]
        if of_wanted:
            first = int(codes[of_wanted[0]])
            _refuse(df[key], of_wanted, table.points[first], table, decimal, told[first])
    readings[bad_status(df, form)] = np.nan
    return replace(table, wordy=wordy)


def of_one_signal(table: RawTable, name: str, columns: dict[str, Array]) -> RawTable:
    """A table of one column as one of readings, each row a reading of the signal `name`."""
    codes = np.zeros(len(table.stamps), dtype=np.int32)
    return replace(table, columns={"": columns[name]}, points=(name,), codes=codes)


def questions(df: pd.DataFrame, form: TableForm) -> NDArray[np.bool_]:
    """Which rows (n,) of a bus monitor ask for a reading, and hold none (`QUESTION` in the column of status)."""
    if form.status is None or form.status not in df:
        return np.zeros(len(df), dtype=bool)
    return np.asarray(df[form.status].astype(str).str.strip() == QUESTION)


def bad_status(df: pd.DataFrame, form: TableForm) -> NDArray[np.bool_]:
    """Which rows (n,) have a status that says that their reading is none."""
    if form.status is None or form.status not in df:
        return np.zeros(len(df), dtype=bool)
    codes, told = pd.factorize(df[form.status].astype(str))
    bad = {word.lower() for word in form.bad}
    are = [not bad.isdisjoint(re.findall(r"\w+", str(words).lower())) for words in told]
    return np.asarray(np.array([*are, False])[codes])


def with_offset(text: pd.Series) -> NDArray[np.bool_]:
    """Which stamps (n,) end with a time of day and an offset from UTC."""
    return np.asarray(
        text.str.contains(rf"(?::[0-9.,]+(?: ?[AaPp]\.?[Mm]\.?)?|T[0-9.]+) ?{OFFSET}", regex=True), dtype=bool
    )


def full_offsets(text: pd.Series) -> pd.Series:
    """Stamps whose offsets have minutes, as +01:00 for +01: pandas reads no others over a change of summer time."""
    hours = text.str.contains("[:T][0-9.]+ ?[+-][0-9]{2} *$", regex=True)
    return text.where(~hours, text.str.rstrip() + ":00") if hours.any() else text


def _stamps(df: pd.DataFrame, stamps: str | tuple[str, ...] | None, name: str) -> pd.Series:
    # A column of stamps whose offset changes, as with summer time, is left as text by pandas.
    of_stamps = isinstance(df.index, pd.DatetimeIndex) or not pd.api.types.is_numeric_dtype(df.index)
    if of_stamps and (stamps is None or stamps == df.index.name):
        return df.index.to_series().reset_index(drop=True)
    if not len(df.columns):
        raise DataError(f"{name}: the table has no columns")
    keys = (str(df.columns[0]) if stamps is None else stamps,) if not isinstance(stamps, tuple) else stamps
    parts = [df[known_column(key, df.columns, name)].reset_index(drop=True) for key in keys]
    if len(parts) == 1:
        return parts[0]
    empty = pd.concat(parts, axis=1).isna().any(axis=1)
    joined = _day(parts[0])
    for part in parts[1:]:
        joined = joined + " " + part.astype(str).str.strip()
    return joined.mask(empty)


def _day(column: pd.Series) -> pd.Series:
    """The days of a column as text; a workbook has them as instants, at midnight."""
    if pd.api.types.is_datetime64_any_dtype(column):
        return column.dt.strftime("%Y-%m-%d")
    return column.astype(str).str.strip().str.removesuffix(" 00:00:00")


class NoColumn(DataError):
    """A table lacks a column that the map names."""


def known_column(key: str, columns: pd.Index, name: str) -> str:
    """`key` if it is among `columns` of the table `name`; else raises `NoColumn`."""
    names = [str(column) for column in columns]
    if key not in names:
        first = "; if that is not the line of column names, set csv.skip_lines or csv.separator of the map"
        hint = first if len(names) == 1 else ""
        if key == "FILL IN":
            raise NoColumn(f"{name}: the map still says FILL IN; name a column there, one of {', '.join(names)}")
        numbered = [one for one in names if re.fullmatch(re.escape(key) + r" \d+", one)]
        if len(numbered) > 1:
            raise NoColumn(
                f"{name}: no column '{key}', but {', '.join(map(repr, numbered))} (columns of the same name are "
                "numbered from left to right): name one of these"
            )
        raise NoColumn(f"{name}: no column '{key}'{suggestion(key, names)}; there are {', '.join(names)}{hint}")
    return key


def as_numbers(
    column: pd.Series,
    decimal: str = ".",
    points: pd.Series[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> pd.Series:
    """The numbers of a column of text, 1 and 0 where it holds nothing but on and off; NaN for what is none.

    With the mark ',' a point is none of a number: it may stand between thousands. `points` (n,): whose each cell is,
    where they are of several signals; `units` by signal (or by the column's name): see `raw_table`.
    """
    codes, names = (None, [column.name]) if points is None else pd.factorize(points)
    told = [(units or {}).get(str(name), "") for name in names]
    of = None if codes is None else codes.astype(np.int32)
    return pd.Series(_with_texts(column, decimal, of, told, [str(name) for name in names])[0], index=column.index)


def told_by_others(column: pd.Series, decimal: str) -> bool:
    """Whether cells of a column of text are read by what stands in others: have a unit, or a mark between thousands."""
    if pd.api.types.is_numeric_dtype(column):
        return False
    cells = column[pd.to_numeric(column, errors="coerce").isna() & column.notna()].unique()
    thousands = _thousands(decimal)
    return any(thousands.fullmatch(str(cell).strip()) or quantity_of(str(cell), decimal) is not None for cell in cells)


def with_numbers(df: pd.DataFrame, words: Mapping[str, float], decimal: str) -> pd.DataFrame:
    """A data frame with numbers, as text, in the place of `words`, whatever their case, in its columns of text."""
    if not words:
        return df
    numbers = {word.strip().lower(): f"{number:.10g}".replace(".", decimal) for word, number in words.items()}
    out = df.copy(deep=False)
    for key in df.columns:
        if pd.api.types.is_numeric_dtype(df[key]) or pd.api.types.is_datetime64_any_dtype(df[key]):
            continue
        codes, cells = pd.factorize(df[key].astype(object))
        to = [numbers.get(str(cell).strip().lower(), cell) for cell in cells]
        if to != list(cells):
            out[key] = pd.Series(np.array([*to, None], dtype=object)[codes], index=df.index, dtype=object)
    return out


def _with_texts(
    column: pd.Series,
    decimal: str,
    of: NDArray[np.int32] | None = None,
    told: Sequence[str] = ("",),
    names: Sequence[str] = ("",),
) -> tuple[Array, NDArray[np.bool_]]:
    """Numbers (n,) of a column, and which of its cells hold text that is no number, no on or off and not 'missing'.

    `of` (n,): the signal of each cell, where they are of several; `told` (k,): the unit of each signal, '' for none;
    `names` (k,): theirs.
    """
    if pd.api.types.is_bool_dtype(column):
        column = column.astype(float)
    if pd.api.types.is_numeric_dtype(column):
        return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan)), np.zeros(len(column), dtype=bool)
    if pd.api.types.is_datetime64_any_dtype(column):
        return np.full(len(column), np.nan), column.notna().to_numpy()
    text = column
    if decimal == ",":
        text = column.astype(str)
        text = text.str.replace(",", ".").where(column.notna() & ~text.str.contains(".", regex=False))
    numbers = np.array(pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan))
    rest = np.flatnonzero(np.isnan(numbers) & column.notna().to_numpy())
    texts = np.zeros(len(column), dtype=bool)
    if rest.size:
        codes, words = pd.factorize(column.iloc[rest].astype(str).str.strip())
        cells = [_without_status(str(word).replace("\u2212", "-")) for word in words]  # a true minus sign
        small = [cell.lower() for cell in cells]
        found = np.array([SWITCH.get(word, np.nan) for word in small])
        of_text = np.array([word not in SWITCH and word not in _NONE for word in small])
        if of_text.any():
            found = np.where(of_text, [_grouped(cell, decimal) for cell in cells], found)
            found = np.where(np.isnan(found), _of_thousands(cells, decimal, numbers), found)
            of_text &= np.isnan(found)
        if of_text.any():
            found = _of_quantities(codes, cells, found, None if of is None else of[rest], decimal, told)
            of_text = of_text[codes] & np.isnan(found)
            numbers[rest], texts[rest] = found, of_text
        else:
            numbers[rest] = found[codes]
        acts = np.array([bool(_ACTION.search(name)) for name in names])
        if acts.any():
            said = np.array([_ACTIONS.get(word, np.nan) for word in small])[codes]
            of_action = texts[rest] & np.isfinite(said) & (acts[0] if of is None else acts[of[rest]])
            numbers[rest[of_action]], texts[rest[of_action]] = said[of_action], False
    return numbers, texts


def _without_status(cell: str) -> str:
    """A cell without the status behind its number, as '21.3 {ok}' of a Niagara station; 'nan' where that is bad."""
    found = _STATUS_BEHIND.fullmatch(cell)
    if found is None:
        return cell
    return "nan" if set(re.findall(r"[a-z]+", found[2].lower())) & _NOT_GOOD else found[1]


def _grouped(cell: str, decimal: str) -> float:
    """A number, with or without marks between thousands, that can be read in one way only; NaN for others.

    Such as 2,435.0 (with the other decimal mark 2.435,0), and 2 435 or 2'435,0.
    """
    if re.fullmatch(rf"[+-]?\d+(?:\{decimal}\d+)?", cell):
        return float(cell.replace(decimal, "."))
    other = "," if decimal == "." else "."
    by_mark = rf"[+-]?\d{{1,3}}(?:\{other}\d{{3}})+\{decimal}\d+"
    by_space = rf"[+-]?\d{{1,3}}(?:([\s'’])\d{{3}})(?:\1\d{{3}})*(?:\{decimal}\d+)?"
    if not (re.fullmatch(by_mark, cell) or re.fullmatch(by_space, cell)):
        return np.nan
    return float(re.sub(rf"[\s'’\{other}]", "", cell).replace(decimal, "."))


def _thousands(decimal: str) -> re.Pattern[str]:
    """A whole number with marks between thousands, which might be a decimal mark: 1,500 beside 1.5."""
    return re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{',' if decimal == '.' else '.'}\d{{3}})+")


def _of_thousands(words: list[str], decimal: str, numbers: Array) -> Array:
    """Numbers (k,) of `words` (k,) with marks between thousands, where the column tells that these are none of
    decimals; NaN else.

    It does where another of its `numbers` (n,) has decimals with the other mark; and where one is small and whole, as
    without marks, and a word ends in 0, which is not written behind a decimal mark where whole numbers have none.
    """
    marked = [_thousands(decimal).fullmatch(word) is not None for word in words]
    known = numbers[np.isfinite(numbers)]
    decimals = bool((known % 1.0 != 0.0).any())
    whole = bool((np.abs(known) < 1000.0).any()) and any(
        w.endswith("0") for w, is_one in zip(words, marked, strict=True) if is_one
    )
    if not any(marked) or not (decimals or whole) or (np.abs(known) >= 1000.0).any():
        return np.full(len(words), np.nan)
    return np.array(
        [float(re.sub(r"[.,]", "", w)) if is_one else np.nan for w, is_one in zip(words, marked, strict=True)]
    )


def _of_quantities(
    codes: NDArray[np.intp],
    words: list[str],
    known: Array,
    of: NDArray[np.int32] | None,
    decimal: str,
    told: Sequence[str],
) -> Array:
    """Numbers (n,) of cells with a unit behind, in the `told` one of each signal `of` (n,), else that of the first.

    `codes` (n,): which of `words` (k,) a cell is; `known` (k,): numbers of words that are none of a quantity. A cell of
    another quantity is no number.
    """
    quantities = [quantity_of(word, decimal) for word in words]
    out = known[codes]
    rows = np.flatnonzero([quantities[code] is not None for code in codes])
    first: dict[int, Unit] = {}
    for row in rows:
        value, name = quantities[codes[row]] or (np.nan, "0-1")
        unit = UNITS[name]
        signal = 0 if of is None else int(of[row])
        wanted = first.setdefault(signal, unit_of_map(told[signal]) if told[signal] else unit)
        out[row] = in_unit(value, unit, wanted) if wanted.quantity == unit.quantity else np.nan
    return out


def quantity_of(cell: str, decimal: str) -> tuple[float, str] | None:
    """Number and unit, as in `UNITS`, of a cell such as '21.3 °C'; None for other cells."""
    match = _QUANTITY.fullmatch(_TELEGRAM.sub("", cell.strip(), count=1))
    if match is None or not (name := unit_named(match[2])):
        return None
    number = _grouped(match[1], decimal)
    return None if np.isnan(number) else (number, name)


def in_units(df: pd.DataFrame, units: Mapping[str, str] | None) -> pd.DataFrame:
    """A data frame whose columns of numbers are in `units`, by column; `attrs["units"]` says in which they stand there.

    Raises `DataError` where one is of another quantity.
    """
    out, wrong = df.copy(deep=False), list[str]()
    for key, told in df.attrs.get("units", {}).items():
        wanted = (units or {}).get(key, "")
        if not wanted or not told.strip() or key not in df:
            continue
        unit, of_map = UNITS.get(unit_named(told)), unit_of_map(wanted)
        if unit is None or unit.quantity != of_map.quantity:
            known = "which is not known" if unit is None else f"which is no {of_map.quantity}"
            wrong.append(f"column '{key}' is told in {told}, {known}, and its unit in the map is {wanted}")
        elif unit != of_map:
            out[key] = in_unit(df[key].to_numpy(dtype=np.float64), unit, of_map)
    if wrong:
        raise DataError(
            f"{'; '.join(wrong)}: name another column, give the device another unit, or say in the map what one of it "
            "is, as factor (1: as the number stands)"
        )
    return out


def unit_of_cells(column: pd.Series, decimal: str) -> str:
    """The unit that stands in the cells of a column behind their numbers; '' where none does."""
    if not (pd.api.types.is_object_dtype(column) or pd.api.types.is_string_dtype(column)):
        return ""
    for cell in column.dropna().astype(str).iloc[:_LOOKED_AT]:
        if (found := quantity_of(cell, decimal)) is not None:
            return found[1]
    return ""


def _numbers(column: pd.Series, key: str, table: RawTable, decimal: str, unit: str) -> Array:
    if isinstance(column, pd.DataFrame):
        raise DataError(f"{table.name}: there are {column.shape[1]} columns '{key}'; give each a name of its own")
    numbers, texts = _with_texts(column, decimal, told=(unit,), names=(key,))
    if texts.any():
        _refuse(column, np.flatnonzero(texts).tolist(), key, table, decimal, unit)
    return numbers


def other_unit(cell: str, decimal: str, unit: str) -> str:
    """Why a cell such as '70.1 °F' is no number in `unit` ('': that of the cells before); '' where it says no unit."""
    if (quantity := quantity_of(cell, decimal)) is None:
        return ""
    if not unit:
        return f"says {quantity[1]}, and the cells before another unit"
    other = unit_of_map(unit).quantity != UNITS[quantity[1]].quantity
    return f"says {quantity[1]}, and its unit in the map is {unit}" if other else ""


def _refuse(column: pd.Series, rows: Sequence[int], key: str, table: RawTable, decimal: str, unit: str) -> None:
    more = f" ({len(rows)} such cells)" if len(rows) > 1 else ""
    first = str(column.iloc[rows[0]])
    if other := other_unit(first, decimal, unit):
        raise DataError(
            f"{table.where(int(rows[0]))}: column '{key}' holds {first!r}, which {other}{more}: check column and unit"
        )
    advice = "if it stands for an empty cell, name it in csv.missing of the map"
    if _WORD.fullmatch(first):
        others = column.iloc[list(rows)].astype(str).str.strip().unique()
        told = ", ".join(f"{word}: NUMBER" for word in others[:_SHOWN_WORDS] if _WORD.fullmatch(word))
        advice = f"if it says what a device does, give its number, csv: {{words: {{{told}}}}} in the map; {advice}"
    if decimal == "." and re.fullmatch(r"\s*-?[1-9]\d{0,2},\d{3}\s*", first):
        advice = "write numbers without marks between thousands, or, if it is a decimal comma, set csv: {decimal: ','}"
    elif decimal == "." and re.fullmatch(r"\s*-?\d+,\d+\s*", first):
        advice = "a decimal comma: set csv: {decimal: ','} in the map"
    elif re.fullmatch(r"\s*-?\d+([.,' ]\d+)+\s*", first):
        advice = f"write numbers without marks between thousands, with '{decimal}' as decimal mark (csv.decimal)"
    raise DataError(f"{table.where(int(rows[0]))}: column '{key}' holds {first!r}, which is no number{more}; {advice}")
