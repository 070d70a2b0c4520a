"""Where results are kept."""

from __future__ import annotations

from typing import Any, Protocol

from thermoforce_mpc.execution.task import Task


class Results(Protocol):
    """Where results are kept; called in the process that executes, so that workers share no disk."""

    def get(self, task: Task) -> Any:
        """The value of a task; raises `KeyError` where there is none."""
        ...

    def put(self, task: Task, value: Any) -> None:
        """Keep the value of a task, whole or not at all."""
        ...
