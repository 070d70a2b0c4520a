"""Progress of many tasks on a console: bars on a terminal, else a line for each start and end."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from thermoforce_mpc.execution.execute import Task, TaskOutcome

# More bars than this would push the first off the screen.
_MOST_BARS = 12
# Tasks done before a rate means anything: the first begin slowly.
_LEAST_DONE = 0.2


def summary(outcome: TaskOutcome) -> str:
    """Title and computing time of a task."""
    return f"{outcome.task.title} ({outcome.seconds:.0f} s)"


def figure(value: float) -> str:
    """A number with four digits, and all of those before the decimal point: 0.3482, 1234, 18570."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"


def duration(seconds: float) -> str:
    """A time for people, in s, min, h or days."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 3.0 * 86400.0 else f"{seconds / 86400.0:.1f} days"


class TaskProgress:
    """A `Watcher` that shows how far tasks are and how long the rest takes; `line`: text for one that is done."""

    def __init__(self, console: Console, *, quiet: bool = False, line: Callable[[TaskOutcome], str] = summary) -> None:
        self._console, self._quiet, self._line = console, quiet, line
        self._n, self._ended, self._since = 0, 0, time.monotonic()
        self._shares: dict[str, float] = {}
        self._bars: dict[str, TaskID] = {}
        self._drawn = console.is_terminal and not quiet
        described, left = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[left]}")
        columns = described, BarColumn(), TimeElapsedColumn(), left
        self._progress = Progress(*columns, console=console, transient=True, disable=not self._drawn)
        self._all = self._progress.add_task("", visible=False, left="")

    def __enter__(self) -> TaskProgress:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._drawn:
            self._progress.stop()

    def planned(self, n: int) -> None:
        """`n` tasks will be run."""
        self._n, self._since = n, time.monotonic()
        self._progress.update(self._all, total=n, visible=bool(n))
        self._show_all()

    def begun(self, task: Task) -> None:
        """A worker has begun `task`, perhaps not the first."""
        again = " again" if task.key in self._shares else ""
        self._shares[task.key] = 0.0
        if task.key in self._bars:
            self._progress.reset(self._bars[task.key], total=None)
        elif len(self._bars) < _MOST_BARS:
            self._bars[task.key] = self._progress.add_task(task.title, total=None, left="")
        if not self._drawn and not self._quiet:
            self._print(f"started {task.title}{again}")

    def told(self, task: Task, share: float) -> None:
        """A share of `task` is done."""
        self._shares[task.key] = share
        if task.key in self._bars:
            self._progress.update(self._bars[task.key], total=1.0, completed=share)
        self._show_all()

    def ended(self, outcome: TaskOutcome) -> None:
        """A task has ended."""
        self._shares.pop(outcome.task.key, None)
        self._ended += 1
        if outcome.task.key in self._bars:
            self._progress.remove_task(self._bars.pop(outcome.task.key))
        self._show_all()
        if self._quiet:
            return
        left = "" if self._drawn or not self._left() else f"; {self._left()}"
        said = f"{outcome.task.title}: {outcome.reason}" if outcome.reason else self._line(outcome)
        self._print(f"{'FAILED' if outcome.reason else 'done':8}[{self._ended}/{self._n}] {said}{left}")

    def _show_all(self) -> None:
        done = self._ended + sum(self._shares.values())
        said = f"{self._ended} of {self._n} done"
        self._progress.update(self._all, description=said, completed=done, left=self._left())

    def _left(self) -> str:
        """Time left at the rate so far; empty as long as there is none to speak of, and at the end."""
        done = self._ended + sum(self._shares.values())
        if done < _LEAST_DONE or self._ended >= self._n:
            return ""
        return f"about {duration((time.monotonic() - self._since) * (self._n - done) / done)} left"

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)
