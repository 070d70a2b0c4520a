"""The folder of a comparison: one JSON file per finished cell and one saved model per identification.

Files are written atomically, so a comparison can be stopped at any time and resumed.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import ArtifactError, StorageError
from thermoforce_mpc.execution import Task
from thermoforce_mpc.files import storage_errors, write_folder, write_whole
from thermoforce_mpc.model.saved.model_file import read_model_file
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.simulation.comparison.cells import FORMAT, Cell
from thermoforce_mpc.simulation.comparison.input_files import InputFiles
from thermoforce_mpc.simulation.folder.plain_files import check_plain
from thermoforce_mpc.simulation.folder.run_folder import write_json

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


def create_folder(folder: Path, *below: str) -> None:
    """Create a folder and those `below`; raises `StorageError` if that fails, `ConfigError` where it holds a link."""
    check_plain(folder)
    try:
        for path in (folder, *(folder / name for name in below)):
            path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"--out {folder}: cannot be created ({error.strerror or error})") from error


def finished_record(path: Path, cell: Cell) -> dict[str, Any] | None:
    """The result of a cell in a file; None if it failed, was not run or cannot be read."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    expected = {"format": FORMAT, "key": cell.key, "status": DONE}
    if not isinstance(record, dict) or {name: record.get(name) for name in expected} != expected:
        return None
    return record | {"variant": cell.variant}


class Store:
    """Stored cells and models of one comparison: the `Results` of its tasks."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def create(self) -> None:
        """Create the folder; raises `StorageError` if that fails, `ConfigError` where there is a link in it."""
        create_folder(self.folder, "cells", "models")

    def cell_path(self, cell: Cell) -> Path:
        """Path of a cell's result."""
        stem = "-".join(re.sub(r"[^A-Za-z0-9_.=]+", "_", word) for word in (cell.variant, cell.window, cell.price))
        return self.folder / "cells" / f"{stem[:100]}-{cell.key}.json"

    def model_path(self, identification_key: str) -> Path:
        """Path of the model of an identification."""
        return self.folder / "models" / identification_key

    def finished(self, cell: Cell) -> dict[str, Any] | None:
        """Stored result of this cell, or None if it failed, was not run or cannot be read."""
        # Found by key alone: the variant name does not affect the result.
        for path in sorted((self.folder / "cells").glob(f"*-{cell.key}.json")):
            if (record := finished_record(path, cell)) is not None:
                return record
        return None

    def get(self, task: Task) -> Any:
        """The record of a finished cell, what was identified, or the content of input files.

        Raises:
            KeyError: there is none.
            ConfigError: an input file cannot be read.
        """
        if isinstance(task.inputs, InputFiles):
            return task.inputs.read()
        stored = (
            self.finished(task.inputs) if isinstance(task.inputs, Cell) else Identified.read(self.model_path(task.key))
        )
        if stored is None:
            raise KeyError(task.key)
        return stored

    def put(self, task: Task, value: Any) -> None:
        """Store the record of a cell, or what was identified; raises `StorageError`."""
        if isinstance(task.inputs, Cell):
            self.write(task.inputs, value)
        else:
            value.write(self.model_path(task.key))

    def write(self, cell: Cell, record: Mapping[str, Any]) -> None:
        """Store a cell's record atomically."""
        write_json(self.cell_path(cell), record)
