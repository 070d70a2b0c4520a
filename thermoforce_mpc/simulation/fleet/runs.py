"""The runs of a fleet as tasks, and their trajectories as a dataset."""

from __future__ import annotations

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
from thermoforce_mpc.simulation.comparison.store import Identified, Store
from thermoforce_mpc.simulation.comparison.tasks import tasks_of as cell_tasks
from thermoforce_mpc.simulation.fleet.buildings import Building
from thermoforce_mpc.simulation.fleet.file import FleetFile


@dataclass(frozen=True)
class Run:
    """One run of a fleet: a cell of a comparison on one building.

    `refused`: why it cannot be run; such a run has no key.
    """

    building: Building
    cell: Cell
    refused: str = ""


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
            runs += [_run(building, replace(cell, trajectory=file.trajectories)) for cell in cells]
    return runs


def _run(building: Building, cell: Cell) -> Run:
    if not (building.no_model and find_entry(cell.scenario.controller.name).needs_model):
        return Run(building, cell)
    # As a cell without a model it would be probed; its key may be that of another building's run.
    without = replace(cell, key="", task=None, identification_key=None)
    return Run(building, without, f"no model from its measurements: {building.no_model}")


def tasks_of(runs: Sequence[Run]) -> list[Task]:
    """A task for each run, with the files and the identification that it needs, which runs share.

    Raises:
        ConfigError: an input file cannot be read.
    """
    return [_named(task, run) for run, task in zip(runs, cell_tasks([run.cell for run in runs]), strict=True)]


def _named(task: Task, run: Run) -> Task:
    """The task of a run, and of its identification, under the name of the building."""
    needs = [_named(need, run) if need.key == run.cell.identification_key else need for need in task.needs]
    return replace(task, title=f"{run.building.name} · {task.title}", needs=tuple(needs))


def models_again(runs: Iterable[Run], records: Mapping[str, Mapping[str, Any]], store: Store) -> list[Task]:
    """Identifications that finished runs were made with, and whose model is not there or cannot be read.

    Not those of other source code, which gave another model. Raises as `tasks_of`.
    """
    missing = {}
    for run in runs:
        key = run.cell.identification_key
        same_model = records.get(run.cell.key, {}).get("model") == key
        if key is not None and same_model and key not in missing and Identified.read(store.model_path(key)) is None:
            missing[key] = run
    return [need for task in tasks_of(list(missing.values())) for need in task.needs if need.key in missing]


def place_trajectories(store: Store, runs: Iterable[Run]) -> None:
    """Make `trajectories` anew: those of `runs` as one Parquet dataset, in partitions of buildings and variants.

    Links where the disk has them, else copies. Raises `StorageError`.
    """
    top = store.folder / "trajectories"
    with storage_errors(top):
        for old in top.glob("building=*"):
            shutil.rmtree(old)
        for run in runs:
            trajectory = store.trajectory_path(run.cell.key)
            if not trajectory.is_file():
                continue
            place = top / f"building={quote(run.building.name, safe='')}"
            place /= f"variant={quote(run.cell.variant, safe='')}"
            place.mkdir(parents=True, exist_ok=True)
            try:
                os.link(trajectory, place / trajectory.name)
            except OSError:
                shutil.copyfile(trajectory, place / trajectory.name)
