"""The runs of a fleet as tasks, and where their results are kept."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from controllers.registry import find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution import Task
from thermoforce_mpc.files import storage_errors
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import merge, validate
from thermoforce_mpc.simulation.comparison.cells import Cell, Inputs, expand
from thermoforce_mpc.simulation.comparison.input_files import InputFiles, SentFiles
from thermoforce_mpc.simulation.comparison.store import Identified, create_folder, finished_record
from thermoforce_mpc.simulation.comparison.tasks import failure, followed, run_record
from thermoforce_mpc.simulation.comparison.tasks import tasks_of as cell_tasks
from thermoforce_mpc.simulation.fleet.buildings import Building
from thermoforce_mpc.simulation.fleet.file import FleetFile
from thermoforce_mpc.simulation.folder.plain_files import write_plain
from thermoforce_mpc.simulation.folder.run_folder import trajectory_frame, write_json


@dataclass(frozen=True)
class Run:
    """One run of a fleet: a cell of a comparison on one building; `trajectory`: whether its course is kept.

    `refused`: why it cannot be run; such a run has no key.
    """

    building: Building
    cell: Cell
    trajectory: bool
    refused: str = ""

    @property
    def title(self) -> str:
        """Name in progress output."""
        return f"{self.building.name} · {self.cell.title}"


@dataclass(frozen=True)
class Ran:
    """What a run returns: its record, and its trajectory as a Parquet file, empty where it is not kept."""

    record: dict[str, Any]
    trajectory: bytes = b""


def runs_of(file: FleetFile, buildings: Iterable[Building], path: Path) -> list[Run]:
    """All runs of a fleet, validated; raises `ConfigError` naming the file, the building and the wrong key."""
    runs, inputs = [], Inputs()
    for building in buildings:
        for seed in file.seeds:
            own = {"days": file.days, "seed": seed}
            data = merge(merge(dict(file.scenario), own), dict(building.scenario))
            try:
                base = validate(Scenario, data, "scenario")
                cells = expand(
                    base, file.variants, file.windows, file.prices, [base.plant.forecast_uncertainty], inputs
                )
            except ConfigError as error:
                raise ConfigError(f"{path}: building '{building.name}': {error}") from error
            runs += [_run(building, cell, file.trajectories) for cell in cells]
    return runs


def _run(building: Building, cell: Cell, trajectory: bool) -> Run:
    if not (building.no_model and find_entry(cell.scenario.controller.name).needs_model):
        return Run(building, cell, trajectory)
    # As a cell without a model it would be probed; its key may be that of another building's run.
    without = replace(cell, key="", task=None, identification_key=None)
    return Run(building, without, trajectory, f"no model from its measurements: {building.no_model}")


def tasks_of(runs: Sequence[Run]) -> list[Task]:
    """A task for each run, with the files and the identification that it needs, which runs share.

    Raises:
        ConfigError: an input file cannot be read.
    """
    tasks = []
    for run, task in zip(runs, cell_tasks([run.cell for run in runs]), strict=True):
        needs = tuple(
            replace(need, title=f"{run.building.name} · {need.title}")
            if need.key == run.cell.identification_key
            else need
            for need in task.needs
        )
        tasks.append(replace(task, title=run.title, function=follow, inputs=run, needs=needs))
    return tasks


def models_again(runs: Iterable[Run], records: Mapping[str, Mapping[str, Any]], results: FleetResults) -> list[Task]:
    """Identifications that finished runs were made with, and whose model is not there or cannot be read.

    Not those of other source code, which gave another model. Raises as `tasks_of`.
    """
    missing = {}
    for run in runs:
        key = run.cell.identification_key
        same_model = records.get(run.cell.key, {}).get("model") == key
        if key is not None and same_model and key not in missing and Identified.read(results.model_path(key)) is None:
            missing[key] = run
    return [need for task in tasks_of(list(missing.values())) for need in task.needs if need.key in missing]


def follow(run: Run, *needs: SentFiles | Identified) -> Ran:
    """Run the closed loop; raises as `comparison.tasks.followed`."""
    result, info = followed(run.cell, *needs)
    record = run_record(run.cell, result, info)
    if not run.trajectory:
        return Ran(record)
    frame = trajectory_frame(result.steps)
    # No names of this run: another of the same inputs, called otherwise, has the same course.
    for place, name in enumerate(("window", "price", "key")):
        frame.insert(place, name, getattr(run.cell, name))
    content = io.BytesIO()
    frame.to_parquet(content, index=False)
    return Ran(record, content.getvalue())


class FleetResults:
    """The folder of a fleet: a file for each run and its trajectory, a folder for each model.

    Found by key, in subfolders of its first two digits, so that a folder of 100,000 runs stays quick.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def create(self) -> None:
        """Create the folder; raises `StorageError` if that fails, `ConfigError` where there is a link in it."""
        create_folder(self.folder)

    def record_path(self, key: str) -> Path:
        """The record of a run."""
        return self.folder / "runs" / key[:2] / f"{key}.json"

    def model_path(self, key: str) -> Path:
        """The model of an identification, or a file with the reason why there is none."""
        return self.folder / "models" / key[:2] / key

    def trajectory_path(self, key: str) -> Path:
        """The trajectory of a run."""
        return self.folder / "runs" / key[:2] / f"{key}.parquet"

    def place_trajectories(self, runs: Iterable[Run]) -> None:
        """Make `trajectories` anew: those of `runs` as one Parquet dataset, in partitions of buildings and variants.

        Links where the disk has them, else copies. Raises `StorageError`.
        """
        top = self.folder / "trajectories"
        with storage_errors(top):
            for old in top.glob("building=*"):
                shutil.rmtree(old)
            for run in runs:
                trajectory = self.trajectory_path(run.cell.key)
                if not trajectory.is_file():
                    continue
                place = top / f"building={quote(run.building.name, safe='')}"
                place /= f"variant={quote(run.cell.variant, safe='')}"
                place.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(trajectory, place / trajectory.name)
                except OSError:
                    shutil.copyfile(trajectory, place / trajectory.name)

    def record(self, run: Run) -> dict[str, Any] | None:
        """The record of a finished run; None if it failed, was not run or cannot be read."""
        if run.trajectory and not self.trajectory_path(run.cell.key).is_file():
            return None
        return finished_record(self.record_path(run.cell.key), run.cell)

    def get(self, task: Task) -> Any:
        """What a run or an identification gave, or the content of input files.

        Raises:
            KeyError: there is nothing.
            ConfigError: an input file cannot be read.
        """
        if isinstance(task.inputs, InputFiles):
            return task.inputs.read()
        if isinstance(task.inputs, Run):
            if (record := self.record(task.inputs)) is None:
                raise KeyError(task.key)
            return Ran(record)
        if (model := Identified.read(self.model_path(task.key))) is None:
            raise KeyError(task.key)
        return model

    def put(self, task: Task, value: Any) -> None:
        """Keep it; raises `StorageError`."""
        if isinstance(task.inputs, Run):
            if value.trajectory:
                write_plain(_in_folder(self.trajectory_path(task.key)), value.trajectory)
            write_json(_in_folder(self.record_path(task.key)), value.record)
        else:
            value.write(_in_folder(self.model_path(task.key)))

    def put_failure(self, run: Run, reason: str) -> dict[str, Any]:
        """Keep the record of a failed run, which the next invocation runs again, and return it."""
        record = failure(run.cell, reason)
        write_json(_in_folder(self.record_path(run.cell.key)), record)
        return record


def _in_folder(path: Path) -> Path:
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path
