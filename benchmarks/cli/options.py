"""Options that most benches share, and where they tell their progress."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click


class ResultFile(click.Path):
    """A file that a result can be written to; what cannot be is refused before a bench that takes hours."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, dir_okay=False)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        from thermoforce_mpc.files import check_writable

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_writable(path)
        return path


FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
NEW_FOLDER = click.Path(path_type=Path, file_okay=False)
KEEP = click.option("--keep", type=NEW_FOLDER, help="Folder of finished cases: a run that was cut off goes on.")
JSON = click.option("--json", "json_file", type=ResultFile(), help="Write the result to this JSON file.")
QUICK = click.option("--quick", is_flag=True, help="Smaller and faster version of the benchmark.")


def say(line: str) -> None:
    """Write a line of progress to stderr."""
    click.echo(line, err=True)
