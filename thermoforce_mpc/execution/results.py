"""Where results are kept, and a folder with one JSON file for each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

from thermoforce_mpc.execution.task import Task
from thermoforce_mpc.files import storage_errors, write_whole


class Results(Protocol):
    """Where results are kept; called in the process that executes, so that workers share no disk."""

    def get(self, task: Task) -> Any:
        """The value of a task; raises `KeyError` where there is none."""
        ...

    def put(self, task: Task, value: Any) -> None:
        """Keep the value of a task, whole or not at all."""
        ...


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
