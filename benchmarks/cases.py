"""Many independent cases on the engine of a bench: their values in order; the first failure ends the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.execution import (
    Engine,
    JsonResults,
    Outcome,
    Results,
    Task,
    Watcher,
    content_key,
    execute,
    source_fingerprint,
)

C = TypeVar("C")
R = TypeVar("R")


class TaskFailed(ThermoForceError):
    """A task has no result, since of an unexpected error or since its worker died at every attempt."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(
            f"{outcome.task.title}: {outcome.reason}" + (f"\n{outcome.details}" if outcome.details else "")
        )
        self.outcome = outcome


def collect(
    tasks: Sequence[Task],
    engine: Engine,
    watcher: Watcher | None = None,
    on_value: Callable[[Any], None] = lambda value: None,
    results: Results | None = None,
) -> list[Any]:
    """The values of all tasks, in their order; the first failure ends the rest. `on_value` is told them as they come.
    What is in `results` is taken from there, and what is not is kept there.

    Raises:
        ThermoForceError: that of the task, of its kind.
        TaskFailed: any other error in a task, or its worker died at every attempt.
    """
    wanted = {task.key for task in tasks}
    values = {}
    with closing(execute(tasks, engine, results, watcher)) as outcomes:
        for outcome in outcomes:
            if outcome.error is not None:
                raise outcome.error(outcome.reason)
            if outcome.reason:
                raise TaskFailed(outcome)
            if outcome.task.key in wanted:
                values[outcome.task.key] = outcome.value
                on_value(outcome.value)
    return [values[task.key] for task in tasks]


def run_all(
    function: Callable[[C], R],
    cases: Sequence[C],
    engine: Engine,
    on_done: Callable[[int, R], None] = lambda n, value: None,
    keep: Path | None = None,
) -> list[R]:
    """`function` of every case, in the order of `cases`; the first failure ends the rest.

    `on_done` is told the number of cases done so far and the value of the latest. Values are kept in the folder `keep`,
    where they are JSON, so that a run that was cut off goes on; without it nothing is kept.

    Raises:
        ThermoForceError, TaskFailed: as `collect`.
    """
    source = source_fingerprint("benchmarks") if keep else ""
    tasks = [
        Task(
            content_key(function, one, source=source) if keep else str(n),
            f"{function.__name__} {n + 1} of {len(cases)}",
            function,
            one,
        )
        for n, one in enumerate(cases)
    ]
    done = 0

    def count(value: R) -> None:
        nonlocal done
        done += 1
        on_done(done, value)

    return collect(tasks, engine, on_value=count, results=JsonResults(keep) if keep else None)
