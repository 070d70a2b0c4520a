"""Runs of `tf-mpc compare`, `sweep` and `fleet`: shown while they are made, and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import click
from rich.console import Console

from thermoforce_mpc.cli.options import Opening
from thermoforce_mpc.comparison.cells import Cell
from thermoforce_mpc.comparison.store import DONE, Ran, Store
from thermoforce_mpc.comparison.tasks import failure
from thermoforce_mpc.execution import Task, TaskOutcome, TaskProgress, execute, source_fingerprint
from thermoforce_mpc.execution.progress import summary
from thermoforce_mpc.report.findings import COST, DISCOMFORT

FAILED = 3
"""Exit code where a run has no result."""


def sayer(console: Console, quiet: bool) -> Callable[[str], None]:
    """Prints a line unless `quiet`."""
    return lambda text: None if quiet else console.print(text, soft_wrap=True)


def outcomes_of(
    tasks: Iterable[Task], store: Store, console: Console, engine: Opening, quiet: bool
) -> Iterator[TaskOutcome]:
    """The outcomes of tasks as they come; raises as `execute`."""
    with TaskProgress(console, quiet=quiet, line=_line) as progress, engine(sayer(console, quiet)) as where:
        store.create()  # not before: a cluster that cannot be used leaves no folder
        yield from execute(tasks, where, store, progress)


def run_cells(
    tasks: Sequence[Task],
    store: Store,
    console: Console,
    engine: Opening,
    quiet: bool,
    records: dict[str, dict[str, Any]],
) -> None:
    """Run tasks; the record of each cell, its result or the reason of its failure, goes into `records` by key.

    An interrupt says how many of all are kept.
    """
    everyone = {*records, *(task.key for task in tasks if isinstance(task.inputs, Cell))}
    try:
        for outcome in outcomes_of(tasks, store, console, engine, quiet) if tasks else ():
            cell = outcome.task.inputs
            if isinstance(cell, Cell):
                ran = Ran(failure(cell, outcome.reason)) if outcome.reason else outcome.value
                if outcome.reason:
                    store.write(cell, ran)
                records[cell.key] = ran.record
    except KeyboardInterrupt:
        kept = sum(record["status"] == DONE for record in records.values())
        click.echo(f"{kept} of {len(everyone)} runs are kept in {store.folder}; repeat the command to resume", err=True)
        raise


def note_other_code(sources: Iterable[str], say: Callable[[str], None], anew: str = "take another --out") -> None:
    """Say how many kept runs were made by other source code of this version, and what runs them `anew`."""
    if stale := sum(source != source_fingerprint() for source in sources):
        say(f"Note: {stale} of them made by other source code of this version; to run all anew, {anew}")


def _line(outcome: TaskOutcome) -> str:
    if not isinstance(outcome.value, Ran):
        return summary(outcome)
    kpis = outcome.value.record["kpis"]
    return f"{outcome.task.title}: {kpis[COST]:.4f} / {kpis[DISCOMFORT]:.2f} K·h ({outcome.seconds:.0f} s)"
