"""`tf-mpc report`: the report of a run, made again from its folder."""

from __future__ import annotations

import shlex
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="File to write.  [default: report.html in RUN]")
def command(run: Path, out: Path | None) -> None:
    """Make the interactive report of the run in folder RUN again, from its journal and files.

    Nothing is simulated or planned again. A run that was cut off, or is under way, is shown as far as it came, and the
    page says so; `tf-mpc resume` goes on with it. A report made by an older release becomes one of this release.

    \b
    Exit codes: 0 done, 2 no journal or a damaged one, 6 it cannot be written.

    \b
    Example:
      tf-mpc report runs/my-run --out /tmp/so_far.html
    """
    from thermoforce_mpc.simulation.views.report_again import report_again

    path, notes = report_again(run, out)
    for line in notes:
        click.echo(line)
    click.echo(f"Report: {shlex.quote(str(path))}")
