"""Parallel execution of the cells of a comparison, one process per cell.

A process that dies (out of memory, crash inside a solver) fails one cell only. Every process computes on one thread, so
that parallel cells do not compete for cores and their results do not depend on the number of jobs.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol

from thermoforce_mpc.simulation.comparison import worker
from thermoforce_mpc.simulation.comparison.cells import Cell
from thermoforce_mpc.simulation.comparison.store import DONE, FAILED, Store

_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
_LEAVE_S = 5.0


class Watcher(Protocol):
    """Receives progress of a comparison."""

    def begun(self, title: str, days: float) -> None:
        """A process has started; it will simulate `days`."""
        ...

    def day(self, title: str, day: float) -> None:
        """A process has reached simulated day `day`."""
        ...

    def ended(self, title: str, record: Mapping[str, Any] | None, reason: str, seconds: float) -> None:
        """A process has ended after `seconds`. `record` is None for an identification; `reason` is empty on success."""
        ...


@dataclass(frozen=True)
class _Task:
    """One process: the closed loop of `cell`, or, if `learns`, the identification it needs."""

    cell: Cell
    learns: bool = False

    @property
    def title(self) -> str:
        return self.cell.identification_title if self.learns else self.cell.title


@dataclass
class _Running:
    task: _Task
    process: SpawnProcess
    channel: Connection
    began: float = field(default_factory=time.monotonic)
    answer: tuple[str, str] | None = None


def run_cells(cells: Sequence[Cell], store: Store, jobs: int, watcher: Watcher) -> dict[str, dict[str, Any]]:
    """Run `cells`, at most `jobs` at a time; identifications run first, each once.

    Returns:
        The record of each cell by key: its result, or the reason of its failure.

    Raises:
        KeyboardInterrupt: processes are terminated; finished cells are in the store.
    """
    ready: deque[_Task] = deque()
    waiting: dict[str, list[_Task]] = {}
    for cell in {cell.key: cell for cell in cells}.values():
        identification_key, task = cell.identification_key, _Task(cell)
        if identification_key is None or store.model_path(identification_key).exists():
            ready.append(task)
            continue
        if identification_key not in waiting:
            waiting[identification_key] = []
            ready.appendleft(_Task(cell, learns=True))
        waiting[identification_key].append(task)
    records: dict[str, dict[str, Any]] = {}

    def fail(cell: Cell, reason: str) -> dict[str, Any]:
        record = worker.failure(cell, reason)
        store.write(cell, record)
        return record

    def finish(task: _Task, reason: str, seconds: float) -> None:
        cell = task.cell
        if task.learns:
            watcher.ended(task.title, None, reason, seconds)
            for then in waiting.pop(str(cell.identification_key)):
                if reason:
                    records[then.cell.key] = fail(then.cell, f"its model could not be identified: {reason}")
                    watcher.ended(then.title, records[then.cell.key], reason, 0.0)
                else:
                    ready.append(then)
            return
        found = None if reason else store.finished(cell)
        if found is None:
            reason = reason or f"the process succeeded but wrote no result to {store.cell_path(cell)}"
        records[cell.key] = found or fail(cell, reason)
        watcher.ended(task.title, records[cell.key], reason, seconds)

    running: list[_Running] = []
    try:
        with one_thread_each():
            while ready or running:
                while ready and len(running) < jobs:
                    task = ready.popleft()
                    running.append(_start(task, store))
                    watcher.begun(task.title, 0.0 if task.learns else task.cell.scenario.days)
                wait([r.process.sentinel for r in running] + [r.channel for r in running if not r.channel.closed], 1.0)
                for r in list(running):
                    alive = r.process.is_alive()
                    _listen(r, watcher)
                    if not alive:
                        running.remove(r)
                        finish(r.task, _outcome(r), time.monotonic() - r.began)
    finally:
        _end(running)
    return records


def _start(task: _Task, store: Store) -> _Running:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    target = worker.learn if task.learns else worker.run
    process = context.Process(target=target, args=(task.cell, store.folder, there), daemon=True)
    process.start()
    there.close()
    return _Running(task, process, here)


def _listen(running: _Running, watcher: Watcher) -> None:
    """Receive all pending messages of a process."""
    while not running.channel.closed and running.channel.poll():
        try:
            kind, value = running.channel.recv()
        except EOFError:
            running.channel.close()
            return
        if kind == "day":
            watcher.day(running.task.title, float(value))
        else:
            running.answer = (kind, str(value))


def _outcome(running: _Running) -> str:
    """Empty if the process succeeded, else the reason of its failure."""
    if running.answer is None:
        code = running.process.exitcode
        return f"its process died ({f'signal {-code}' if code and code < 0 else f'exit code {code}'})"
    kind, reason = running.answer
    return "" if kind == DONE else reason or FAILED


def _end(running: Sequence[_Running]) -> None:
    """Terminate running processes; kill those that are alive after `_LEAVE_S` seconds."""
    for r in running:
        r.process.terminate()
    for r in running:
        r.process.join(_LEAVE_S)
        if r.process.is_alive():
            r.process.kill()
            r.process.join()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Set the variables that limit processes started inside to one thread (read when libraries are loaded)."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
