"""`tf-mpc bench NAME`: every figure in the documentation can be made again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from thermoforce_mpc.run_folder import write_json


@click.group(short_help="Measure parts of the package against their targets.")
def command() -> None:
    """Measure parts of the package against their targets: tables, plots and JSON, failed targets shown as such."""


def show(result: Mapping[str, Any], json_file: Path | None) -> None:
    """Print a bench's rows and targets, and write its JSON where asked."""
    console = Console(highlight=False)
    rows = result["rows"]
    if rows:
        table = Table(title=f"bench {result['bench']}", title_justify="left")
        columns = list(dict.fromkeys(key for row in rows for key in row))
        for column in columns:
            table.add_column(column, overflow="fold")
        for row in rows:
            table.add_row(*(_cell(row.get(column)) for column in columns))
        console.print(table)
    for target in result["targets"]:
        mark = "holds      " if target["holds"] else "DOES NOT HOLD"
        console.print(f"{mark}  {target['name']}: {_cell(target['value'])} ({target['sense']} {target['goal']:g})")
    if json_file:
        write_json(json_file, result)
        console.print(f"JSON: {json_file}")


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


_REFERENCE = click.option(
    "--reference",
    required=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of reference trajectories in the layout of docs/plant.md.",
)
_JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the result here.")
_OUT = click.option("--out", type=click.Path(path_type=Path), default=Path("bench"), help="Folder for plots.")
_QUICK = click.option("--quick", is_flag=True, help="A smaller version, for a first look.")
