"""InfluxDB's line protocol, as `influxd inspect export-lp` and Telegraf write it, to rows of one reading each.

A line is `measurement,tag=… field=…,field=… nanoseconds`. The columns are those of InfluxDB's annotated CSV.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import pandas as pd

from thermoforce_mpc.errors import DataError

# Possessive: what matches is not tried again in other parts, which would take long for a line that is none.
_KEY = r"(?:[^\s\\]++|\\.)++"
_FIELD = r"(?:[^\s=,\\]++|\\.)++=(?:\"(?:[^\"\\]++|\\.)*+\"|[^\s,\"]++)"
_LINE = re.compile(rf"({_KEY}) ({_FIELD}(?:,{_FIELD})*+)(?: (-?\d{{1,19}}))?\s*$")
_ONE_FIELD = re.compile(r'((?:[^=,\\]++|\\.)++)=("(?:[^"\\]++|\\.)*+"|[^,]*)(?:,|$)')
_SERIES = re.compile(_KEY)
_COMMA, _EQUALS, _ESCAPED = re.compile(r"(?<!\\),"), re.compile(r"(?<!\\)="), re.compile(r"\\([ ,=\"\\])")
# What version 1 writes above the lines, beside comments.
_ABOVE = "CREATE "
# Attributes that are text stand beside each reading of Home Assistant's.
_TEXT_BESIDE = "_str"
_LOOKED_AT = 20

TIME, MEASUREMENT, FIELD, VALUE = "_time", "_measurement", "_field", "_value"


def is_line_protocol(lines: Iterable[str]) -> bool:
    """Whether the first lines of a text are of the line protocol."""
    told = [line for _, line in zip(range(_LOOKED_AT), _lines(lines), strict=False)]
    return bool(told) and all(_LINE.match(line) for _, line in told)


def columns_of_lines(lines: Iterable[str]) -> list[str]:
    """The columns of all lines: time, measurement, every tag, field and value."""
    keys = {match[0] for _, line in _lines(lines) if (match := _SERIES.match(line))}
    tags = dict.fromkeys(tag for key in sorted(keys) for tag in _tags(key))
    return [TIME, MEASUREMENT, *(tag for tag in tags if tag != MEASUREMENT), FIELD, VALUE]


def frames_of_lines(
    lines: Iterable[str], name: str, columns: list[str], most: int | None
) -> Iterator[tuple[pd.DataFrame, list[int]]]:
    """Rows of some `columns`, about `most` at once (None: all), with the line of each; raises `DataError`."""
    tags_of: dict[str, dict[str, str]] = {}
    rows: list[dict[str, object]] = []
    at: list[int] = []
    for number, line in _lines(lines):
        match = _LINE.match(line)
        if match is None or match[3] is None:
            what = "has no time" if match else "is none of the line protocol"
            raise DataError(f"{name}, line {number}: {what}, as in 'measurement,tag=a field=1.5 1736726400000000000'")
        if (tags := tags_of.get(match[1])) is None:
            tags = tags_of[match[1]] = _tags(match[1])
        for field, value in _ONE_FIELD.findall(match[2]):
            if not (field.endswith(_TEXT_BESIDE) and value.startswith('"')):
                rows.append({**tags, TIME: int(match[3]), FIELD: _plain(field), VALUE: _told(value)})
                at.append(number)
        if most is not None and len(rows) >= most:
            yield _frame(rows, columns), at
            rows, at = [], []
    yield _frame(rows, columns), at


def _frame(rows: list[dict[str, object]], columns: list[str]) -> pd.DataFrame:
    df = pd.DataFrame(rows, columns=columns)
    if VALUE in df:
        numbers = pd.to_numeric(df[VALUE], errors="coerce")
        df[VALUE] = numbers if numbers.notna().all() else df[VALUE]
    return df


def _lines(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Lines that are none of comment, with their numbers."""
    for number, line in enumerate(lines, start=1):
        if line.strip() and not line.startswith(("#", _ABOVE)):
            yield number, line


def _tags(key: str) -> dict[str, str]:
    measurement, *tags = _COMMA.split(key)
    pairs = (_EQUALS.split(tag, maxsplit=1) for tag in tags)
    return {_plain(pair[0]): _plain(pair[-1]) for pair in pairs} | {MEASUREMENT: _plain(measurement)}


def _plain(text: str) -> str:
    return _ESCAPED.sub(r"\1", text) if "\\" in text else text


def _told(value: str) -> str:
    """A value as a table has it: whole numbers end with i or u here, and words stand in quotes."""
    if value.startswith('"'):
        return _plain(value[1:-1])
    if value in ("t", "T", "f", "F"):
        return "true" if value in "tT" else "false"
    return value[:-1] if value[-1] in "iu" and value[:-1].lstrip("-").isdigit() else value
