"""Many independent cases on the engine of a bench: their values in order; the first failure ends the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any, TypeVar

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.execution import Engine, Outcome, Task, Watcher, execute

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
) -> list[Any]:
    """The values of all tasks, in their order; the first failure ends the rest. `on_value` is told them as they come.

    Raises:
        ThermoForceError: that of the task, of its kind.
        TaskFailed: any other error in a task, or its worker died at every attempt.
    """
    wanted = {task.key for task in tasks}
    values = {}
    with closing(execute(tasks, engine, watcher=watcher)) as outcomes:
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
) -> list[R]:
    """`function` of every case, in the order of `cases`; nothing is kept, and the first failure ends the rest.

    `on_done` is told the number of cases done so far and the value of the latest.

    Raises:
        ThermoForceError, TaskFailed: as `collect`.
    """
    tasks = [Task(str(n), f"{function.__name__} {n + 1} of {len(cases)}", function, one) for n, one in enumerate(cases)]
    done = 0

    def count(value: R) -> None:
        nonlocal done
        done += 1
        on_done(done, value)

    return collect(tasks, engine, on_value=count)
