"""Many independent cases on the engine of a bench: their values in order; the first failure ends the rest."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.execution import (
    Engine,
    Results,
    Task,
    TaskOutcome,
    Watcher,
    content_key,
    execute,
    source_fingerprint,
)
from thermoforce_mpc.files import storage_errors, write_whole

C = TypeVar("C")
R = TypeVar("R")


class JsonResults:
    """Values that are JSON, in files of `folder` named by key; a file that cannot be read does not count."""

    def __init__(self, folder: Path) -> None:
        """Make the folder; raises `StorageError` if that fails."""
        self.folder = folder
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)

    def path(self, task: Task) -> Path:
        """The file of a task's value."""
        return self.folder / f"{task.key}.json"

    def get(self, task: Task) -> Any:
        """The value of a task; raises `KeyError` where there is none."""
        try:
            return json.loads(self.path(task).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise KeyError(task.key) from None

    def put(self, task: Task, value: Any) -> None:
        """Write the value of a task; raises `StorageError`."""
        write_whole(self.path(task), json.dumps(value, sort_keys=True) + "\n")


class TaskFailed(ThermoForceError):
    """A task has no result, since of an unexpected error or since its worker died at every attempt."""

    def __init__(self, outcome: TaskOutcome) -> None:
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


def revision() -> str:
    """The commit of this checkout, -dirty where files differ from it; '' where there is none."""
    asked = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(asked, capture_output=True, text=True, timeout=10.0, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
