"""Print a bench's result: its rows as tables, its targets as lines."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks.cases import revision

_WIDTH_OF_FILES = 160
# Widest column, characters, beyond which it is folded where a table has to be cut; most columns of words at its left
# that are told again in each part.
_FOLDED, _MOST_NAMES = 40, 2
_BEGAN_S = time.monotonic()  # of the command, which imports this first


def show(result: Mapping[str, Any], json_file: Path | None) -> None:
    """Print the rows and targets of a benchmark; write its JSON where `json_file` is given."""
    from rich.console import Console
    from rich.table import Table

    from thermoforce_mpc.files import write_json

    console = Console(highlight=False)
    if not console.is_terminal:  # do not wrap tables in files
        console.width = _WIDTH_OF_FILES
    # Consecutive rows with the same columns share a table.
    columns: tuple[str, ...]
    for columns, group in groupby(result["rows"], key=tuple):
        values = list(group)
        rows = [{column: _cell(row[column]) for column in columns} for row in values]
        named = [column for column in columns[:_MOST_NAMES] if isinstance(values[0][column], str)] or [columns[0]]
        for part in _parts(columns, named, rows, console.width):
            table = Table(title=f"bench {result['bench']}", title_justify="left")
            for column in part:
                table.add_column(column, overflow="fold")
            for row in rows:
                table.add_row(*(row[column] for column in part))
            console.print(table)
    for target in result["targets"]:
        mark = "holds      " if target["holds"] else "DOES NOT HOLD"
        console.print(f"{mark}  {target['name']}: {_cell(target['value'])} ({target['sense']} {target['goal']:g})")
    if json_file:
        of = {
            "revision": revision(),
            "date": datetime.now(UTC).date().isoformat(),
            "minutes": (time.monotonic() - _BEGAN_S) / 60,
        }
        write_json(json_file, dict(result) | of)
        console.print(f"JSON: {json_file}")


def _parts(
    columns: Sequence[str], named: Sequence[str], rows: Sequence[Mapping[str, str]], width: int
) -> list[list[str]]:
    """The columns of tables that fit into `width` characters, each with those first ones that name the rows."""
    wide = {column: min(max(len(column), *(len(row[column]) for row in rows)), _FOLDED) + 3 for column in columns}
    if sum(wide.values()) + 1 <= width:
        return [list(columns)]
    parts, left = [list(named)], width - 1 - sum(wide[column] for column in named)
    room = left
    for column in columns[len(named) :]:
        if wide[column] > room and len(parts[-1]) > len(named):
            parts.append(list(named))
            room = left
        parts[-1].append(column)
        room -= wide[column]
    return parts


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
