"""Options that most benches share, and where they tell their progress."""

from __future__ import annotations

from pathlib import Path

import click

FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the result to this JSON file.")
QUICK = click.option("--quick", is_flag=True, help="Smaller and faster version of the benchmark.")


def say(line: str) -> None:
    """Write a line of progress to stderr."""
    click.echo(line, err=True)
