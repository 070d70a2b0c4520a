"""What a fleet costs: parallel efficiency of two workers, cost over the number of runs, and what the engine adds."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from thermoforce_mpc.comparison.cells import Cell, Variant
from thermoforce_mpc.comparison.store import Store
from thermoforce_mpc.execution import LocalEngine, Task, TaskOutcome, execute
from thermoforce_mpc.fleet.file import BuildingSource, FleetFile, Generated, buildings_of
from thermoforce_mpc.fleet.runs import runs_of, tasks_of

# A population that no table of the documentation reports.
_SEED = 7
_HERE = Path("fleet.yaml")


@dataclass(frozen=True)
class Campaign:
    """A fleet of `runs` run by `workers` processes.

    `seconds`: wall time of the runs, without the start of the processes and their first imports. `prepare_s`: to make
    the runs from the file. `bytes_per_run`: what the results take on disk.
    """

    runs: int
    workers: int
    seconds: float
    prepare_s: float
    bytes_per_run: float


def campaign(
    buildings: int, workers: int, *, days: float = 1.0, model: bool = True, progress: Callable[[str], None]
) -> Campaign:
    """Run `buildings` generated houses for `days`; with `model` identified and by our controller, else by thermostats.

    Raises:
        RuntimeError: a run failed.
    """
    began = time.perf_counter()
    tasks = _tasks(buildings, days, model, first=0)
    prepare_s = time.perf_counter() - began
    with tempfile.TemporaryDirectory() as folder, LocalEngine(workers) as engine:
        # Imports, compiled code and weights take a process seconds; other houses bring them in.
        _done(execute(_tasks(2 * workers, 0.1, model, first=buildings), engine))
        results = Store(Path(folder))
        began = time.perf_counter()
        runs = _done(
            execute(tasks, engine, results),
            lambda n: progress(f"{workers} worker{'s'[: workers - 1]}: {n} of {buildings} runs"),
        )
        seconds = time.perf_counter() - began
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    return Campaign(runs, workers, seconds, prepare_s, size / runs)


def _tasks(buildings: int, days: float, model: bool, first: int) -> list[Task]:
    name = "thermoforce_mpc" if model else "thermostat"
    file = FleetFile(
        buildings=(BuildingSource(generated=Generated(seed=_SEED, count=buildings, first=first)),),
        windows=("cold_week",),
        variants={name: Variant(controller=name)},
        reference=name,
        days=days,
    )
    return tasks_of(runs_of(file, buildings_of(file, _HERE), _HERE))


def _done(outcomes: Iterable[TaskOutcome], told: Callable[[int], None] = lambda n: None) -> int:
    """Number of runs among the outcomes."""
    n = 0
    for outcome in outcomes:
        if outcome.reason:
            raise RuntimeError(f"{outcome.task.title}: {outcome.reason}")
        if isinstance(outcome.task.inputs, Cell):
            n += 1
            told(n)
    return n


@dataclass(frozen=True)
class Overhead:
    """What the engine takes for a task that does nothing, s, with `tasks` of them on two workers."""

    tasks: int
    seconds_per_task: float


def overhead(tasks: int) -> Overhead:
    """Run tasks that do nothing."""
    with LocalEngine(2) as engine:
        _done(execute([Task(f"first {n}", "first", _nothing, n) for n in range(10)], engine))
        began = time.perf_counter()
        _done(execute([Task(f"{n}", f"task {n}", _nothing, n) for n in range(tasks)], engine))
        return Overhead(tasks, (time.perf_counter() - began) / tasks)


def _nothing(number: int) -> int:
    return number
