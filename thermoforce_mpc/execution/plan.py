"""The order in which tasks can be run, by what they need."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from graphlib import TopologicalSorter
from typing import Any

from thermoforce_mpc.execution.results import Results
from thermoforce_mpc.execution.task import Outcome, Task


class Plan:
    """The order of what is to be done, and the values that some of it needs, kept as long as they are needed."""

    def __init__(self, todo: Sequence[Task], results: Results | None) -> None:
        self.tasks: dict[str, Task] = {}
        self._values: dict[str, Any] = {}
        self._failed: dict[str, str] = {}
        self._users: Counter[str] = Counter()
        self._order: TopologicalSorter[str] = TopologicalSorter()
        for task in todo:
            self._add(task, results)
        self._order.prepare()

    def _add(self, task: Task, results: Results | None) -> None:
        if task.key in self.tasks:
            return
        self.tasks[task.key] = task
        for need in task.needs:
            self._users[need.key] += 1
            if need.key not in self.tasks and need.key not in self._values:
                try:
                    self._values[need.key] = kept(results, need)
                except KeyError:
                    self._add(need, results)
        self._order.add(task.key, *(need.key for need in task.needs if need.key in self.tasks))

    @property
    def open(self) -> bool:
        """Whether anything is left to do."""
        return self._order.is_active()

    def take_ready(self) -> list[Task]:
        """Tasks with all needs done, not taken before; first those for which most others wait."""
        return [self.tasks[key] for key in sorted(self._order.get_ready(), key=lambda key: -self._users[key])]

    def missing(self, task: Task) -> str:
        """Why a need of `task` has no result; empty if all have."""
        return next((self._failed[need.key] for need in task.needs if need.key in self._failed), "")

    def results_of_needs(self, task: Task) -> tuple[Any, ...]:
        """The values of what `task` needs."""
        return tuple(self._values[need.key] for need in task.needs)

    def end(self, outcome: Outcome) -> None:
        """A task has ended."""
        task = outcome.task
        if outcome.reason:
            self._failed[task.key] = f"'{task.title}', which it needs, failed: {outcome.reason}"
        elif self._users[task.key]:
            self._values[task.key] = outcome.value
        for need in task.needs:
            self._users[need.key] -= 1
            if not self._users[need.key]:
                self._values.pop(need.key, None)
        self._order.done(task.key)


def kept(results: Results | None, task: Task) -> Any:
    """The value of a task that is kept; raises `KeyError` where there is none."""
    if results is None:
        raise KeyError(task.key)
    return results.get(task)
