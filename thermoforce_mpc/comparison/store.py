"""The folder of a comparison or a fleet: a file for each run and its trajectory, a saved model for each identification.

Files are written atomically, so it can be stopped at any time and resumed.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermoforce_mpc.comparison.cells import FORMAT, Cell
from thermoforce_mpc.comparison.input_files import InputFiles
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.execution import Task
from thermoforce_mpc.files import check_plain, storage_errors, write_folder, write_json, write_plain, write_whole
from thermoforce_mpc.model.saved import read_model_file
from thermoforce_mpc.model.thermal_model import ThermalModel

DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class Identified:
    """A saved model as its files by name, or why its data could not be fitted (`refused`)."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    refused: str = ""

    @classmethod
    def of(cls, model: ThermalModel) -> Identified:
        """A model as it is saved."""
        with tempfile.TemporaryDirectory() as folder:
            saved = model.save(Path(folder) / "model")
            return cls({path.name: path.read_bytes() for path in sorted(saved.iterdir())})

    @classmethod
    def read(cls, path: Path) -> Identified | None:
        """What `write` wrote; None where there is nothing, or what is no whole model."""
        try:
            if path.is_file():
                why = path.read_text(encoding="utf-8")
                return cls(refused=why) if why else None
            read_model_file(path)
            return cls({file.name: file.read_bytes() for file in sorted(path.iterdir())})
        except (OSError, ArtifactError, UnicodeDecodeError):
            return None

    def write(self, path: Path) -> None:
        """Write the folder of the model, or in its place a file with the reason; raises `StorageError`.

        What can be read there stays: another command wrote it meanwhile, from the same inputs.
        """
        if Identified.read(path) is not None:
            return
        # What is there may be damaged and of the other kind.
        with storage_errors(path):
            if self.refused and path.is_dir():
                shutil.rmtree(path)
            elif not self.refused and path.is_file():
                path.unlink()
        if self.refused:
            write_whole(path, self.refused)
        else:
            write_folder(path, self.files, keep=not path.exists())


@dataclass(frozen=True)
class Ran:
    """What a run gives: its record, and its trajectory as a Parquet file, empty where it is not kept."""

    record: dict[str, Any]
    trajectory: bytes = b""


class Store:
    """Stored runs and models: the `Results` of their tasks.

    Found by key, in subfolders of its first two digits, so that a folder of 100,000 runs stays quick.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def create(self) -> None:
        """Create the folder; raises `StorageError` if that fails, `ConfigError` where there is a link in it."""
        check_plain(self.folder)
        with storage_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)

    def record_path(self, key: str) -> Path:
        """The record of a run."""
        return self.folder / "runs" / key[:2] / f"{key}.json"

    def trajectory_path(self, key: str) -> Path:
        """The trajectory of a run."""
        return self.record_path(key).with_suffix(".parquet")

    def model_path(self, key: str) -> Path:
        """The model of an identification, or a file with the reason why there is none."""
        return self.folder / "models" / key[:2] / key

    def finished(self, cell: Cell) -> dict[str, Any] | None:
        """The record of a run under the name of `cell`; None if it failed, was not run or cannot be read."""
        if cell.trajectory and not self.trajectory_path(cell.key).is_file():
            return None
        try:
            record = json.loads(self.record_path(cell.key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        expected = {"format": FORMAT, "key": cell.key, "status": DONE}
        if not isinstance(record, dict) or {name: record.get(name) for name in expected} != expected:
            return None
        return record | {"variant": cell.variant}

    def get(self, task: Task) -> Any:
        """What a run or an identification gave, or the content of input files.

        Raises:
            KeyError: there is nothing.
            ConfigError: an input file cannot be read.
        """
        if isinstance(task.inputs, InputFiles):
            return task.inputs.read()
        if isinstance(task.inputs, Cell):
            if (record := self.finished(task.inputs)) is None:
                raise KeyError(task.key)
            return Ran(record)
        if (model := Identified.read(self.model_path(task.key))) is None:
            raise KeyError(task.key)
        return model

    def put(self, task: Task, value: Any) -> None:
        """Keep what a run or an identification gave; raises `StorageError`."""
        if isinstance(task.inputs, Cell):
            self.write(task.inputs, value)
        else:
            value.write(_in_folder(self.model_path(task.key)))

    def write(self, cell: Cell, ran: Ran) -> None:
        """Keep a run, also one that failed, which the next invocation runs again; raises `StorageError`."""
        if ran.trajectory:
            write_plain(_in_folder(self.trajectory_path(cell.key)), ran.trajectory)
        write_json(_in_folder(self.record_path(cell.key)), ran.record)


def _in_folder(path: Path) -> Path:
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path
