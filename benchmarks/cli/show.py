"""Print a bench's result: its rows as tables, its targets as lines."""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks.cases import revision

_WIDTH_OF_FILES = 160
_BEGAN_S = time.monotonic()  # of the command, which imports this first


def show(result: Mapping[str, Any], json_file: Path | None) -> None:
    """Print the rows and targets of a benchmark; write its JSON where `json_file` is given."""
    from rich.console import Console
    from rich.table import Table

    from thermoforce_mpc.records.run_folder import write_json

    console = Console(highlight=False)
    if not console.is_terminal:  # do not wrap tables in files
        console.width = _WIDTH_OF_FILES
    # Consecutive rows with the same columns share a table.
    columns: tuple[str, ...]
    for columns, group in groupby(result["rows"], key=tuple):
        table = Table(title=f"bench {result['bench']}", title_justify="left")
        for column in columns:
            table.add_column(column, overflow="fold")
        for row in group:
            table.add_row(*(_cell(row[column]) for column in columns))
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


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
