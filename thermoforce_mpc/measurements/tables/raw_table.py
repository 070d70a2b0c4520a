"""Columns of one table as they stand there: numbers, and time stamps of any kind."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.scenario.settings import suggestion

# Words of a column that says on or off.
_SWITCH = {"on": 1.0, "off": 0.0, "ein": 1.0, "an": 1.0, "aus": 0.0, "true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class RawTable:
    """Columns of one file as they stand there: `stamps` (n,) of any kind, `columns` by name (n,) numbers.

    `line`: that of its first row in file `name` (1 where rows are counted, as in Parquet files and data frames), or of
    each row (n,).
    """

    name: str
    stamps: pd.Series
    columns: dict[str, Array]
    line: int | NDArray[np.intp]

    def where(self, row: int) -> str:
        """Name of the file and place of a row in it."""
        if isinstance(self.line, np.ndarray):
            return f"{self.name}, line {self.line[row]}"
        return f"{self.name}, {'row' if self.line == 1 else 'line'} {row + self.line}"


def raw_table(
    df: pd.DataFrame,
    stamps: str | None,
    columns: Sequence[str],
    name: str,
    line: int | NDArray[np.intp] = 1,
    decimal: str = ".",
) -> RawTable:
    """The time stamps and `columns` of a data frame (text with the mark `decimal`); raises as `read_table` does."""
    # A column of stamps whose offset changes, as with summer time, is left as text by pandas.
    of_stamps = isinstance(df.index, pd.DatetimeIndex) or df.index.dtype.kind == "O"
    if of_stamps and (stamps is None or stamps == df.index.name):
        at = df.index.to_series().reset_index(drop=True)
    elif not len(df.columns):
        raise DataError(f"{name}: the table has no columns")
    else:
        at = df[known_column(str(df.columns[0]) if stamps is None else stamps, df.columns, name)].reset_index(drop=True)
    if not len(df):
        raise DataError(f"{name}: the table has no rows")
    table = RawTable(name, at, {}, line)
    for key in dict.fromkeys(columns):
        table.columns[key] = _numbers(df[known_column(key, df.columns, name)], key, table, decimal)
    return table


def known_column(key: str, columns: pd.Index, name: str) -> str:
    """`key` if it is among `columns` of the table `name`; else raises `DataError`."""
    names = [str(column) for column in columns]
    if key not in names:
        first = "; if that is not the line of column names, set csv.skip_lines or csv.separator of the map"
        hint = first if len(names) == 1 else ""
        if key == "FILL IN":
            raise DataError(f"{name}: the map still says FILL IN; name a column there, one of {', '.join(names)}")
        raise DataError(f"{name}: no column '{key}'{suggestion(key, names)}; there are {', '.join(names)}{hint}")
    return key


def as_numbers(column: pd.Series, decimal: str = ".") -> pd.Series:
    """The numbers of a column of text, 1 and 0 where it holds nothing but on and off; NaN for what is none.

    With the mark ',' a point is none of a number: it may stand between thousands.
    """
    switch = column.dropna().astype(str).str.strip().str.lower()
    if len(switch) and switch.isin(_SWITCH).all():
        return column.astype(str).str.strip().str.lower().map(_SWITCH)
    if decimal == "," and not pd.api.types.is_numeric_dtype(column):
        text = column.astype(str)
        column = text.str.replace(",", ".").where(column.notna() & ~text.str.contains(".", regex=False))
    return pd.to_numeric(column, errors="coerce")


def _numbers(column: pd.Series, key: str, table: RawTable, decimal: str) -> Array:
    if isinstance(column, pd.DataFrame):
        raise DataError(f"{table.name}: there are {column.shape[1]} columns '{key}'; give each a name of its own")
    if pd.api.types.is_numeric_dtype(column):
        return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan))
    numbers = as_numbers(column, decimal)
    wrong = np.flatnonzero((numbers.isna() & column.notna()).to_numpy())
    if wrong.size:
        more = f" ({wrong.size} such cells)" if wrong.size > 1 else ""
        first = str(column.iloc[wrong[0]])
        advice = "if it stands for an empty cell, name it in csv.missing of the map"
        if decimal == "." and re.fullmatch(r"\s*-?\d+,\d+\s*", first):
            advice = "a decimal comma: set csv: {decimal: ','} in the map"
        elif re.fullmatch(r"\s*-?\d+([.,' ]\d+)+\s*", first):
            advice = f"write numbers without marks between thousands, with '{decimal}' as decimal mark (csv.decimal)"
        raise DataError(
            f"{table.where(int(wrong[0]))}: column '{key}' holds {first!r}, which is no number{more}; {advice}"
        )
    return np.asarray(numbers.to_numpy(dtype=np.float64, na_value=np.nan))
