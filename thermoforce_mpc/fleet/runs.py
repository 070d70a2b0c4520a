"""The runs and identifications of a fleet as tasks, its trajectories, the verdicts on its models, and its dataset.

The dataset has one row a run, as Parquet with a schema of its own.
"""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from thermoforce_mpc.comparison.cells import Cell, Inputs, expand
from thermoforce_mpc.comparison.input_files import NO_FILES, SentFiles, input_files, task_of
from thermoforce_mpc.comparison.store import DONE, Identified, Store
from thermoforce_mpc.comparison.tasks import tasks_of as cell_tasks
from thermoforce_mpc.data import PlanStatus
from thermoforce_mpc.errors import ArtifactError, ConfigError, DataError, InputError, counted
from thermoforce_mpc.execution import Task, content_key
from thermoforce_mpc.experiment.measured_model import model_of_measurements
from thermoforce_mpc.files import pyarrow_for, storage_errors, write_plain
from thermoforce_mpc.fleet.file import FleetBuilding, FleetFile
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.plants.registry import check_surroundings
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import merge, validate


@dataclass(frozen=True)
class FleetRun:
    """One run of a fleet: a cell of a comparison on one building.

    `refused`: why it cannot be run; such a run has no key.
    """

    building: FleetBuilding
    cell: Cell
    refused: str = ""


def check_surroundings_of(file: FleetFile, buildings: Iterable[FleetBuilding], path: Path) -> None:
    """Read the files of weather and prices of all buildings; raises `ConfigError` that names all that are wrong."""
    users: dict[tuple[str, str], list[str]] = {}
    for building in buildings:
        plant = merge(dict(file.scenario), dict(building.scenario)).get("plant", {})
        for key in ("weather", "prices_file"):
            if building.runs and plant.get(key) not in (None, "synthetic"):
                users.setdefault((key, str(plant[key])), []).append(building.name)
    wrong = []
    for (key, named), names in users.items():
        try:
            check_surroundings(validate(PlantSpec, {key: named}, "plant"))
        except InputError as error:
            more = f" and {counted(len(names) - 1, 'other')}" if len(names) > 1 else ""
            wrong.append(f"building '{names[0]}'{more}: plant.{key}: {error}")
    if wrong:
        raise ConfigError(f"{path}:\n  " + "\n  ".join(wrong))


def runs_of(file: FleetFile, buildings: Iterable[FleetBuilding], path: Path) -> list[FleetRun]:
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
            for cell in cells:
                if building.no_model and cell.needs_model:
                    # As a cell without a model it would be probed; its key may be that of another building's run.
                    without = replace(cell, trajectory=file.trajectories, key="", task=None, identification_key=None)
                    runs.append(FleetRun(building, without, f"no model from its measurements: {building.no_model}"))
                else:
                    runs.append(FleetRun(building, replace(cell, trajectory=file.trajectories)))
    return runs


def tasks_of(runs: Sequence[FleetRun]) -> list[Task]:
    """A task for each run, with the files and the identification that it needs, which runs share."""
    return [_named(task, run) for run, task in zip(runs, cell_tasks([run.cell for run in runs]), strict=True)]


def _named(task: Task, run: FleetRun) -> Task:
    """The task of a run, and of its identification, under the name of the building."""
    needs = [_named(need, run) if need.key == run.cell.identification_key else need for need in task.needs]
    return replace(task, title=f"{run.building.name} · {task.title}", needs=tuple(needs))


def models_again(runs: Iterable[FleetRun], records: Mapping[str, Mapping[str, Any]], store: Store) -> list[Task]:
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


def place_trajectories(store: Store, runs: Iterable[FleetRun]) -> None:
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


MODELS = "models.parquet"
_LEAD_H = (1, 6, 24)


_FIGURES = ("effect_K", "effect_sd_K", "sign_probability", "log_odds")
_FORECASTS = ("model", "persistence", "weather")


def _schema(pa: Any) -> Any:
    """Columns and types of the verdicts; `pa` is pyarrow."""
    places = ("building", "window", "from", "actuator", "key")
    numbers = [*_FIGURES, *(f"{what}_{h}h_K" for h in _LEAD_H for what in _FORECASTS)]
    columns = [
        *(pa.field(name, pa.string(), nullable=False) for name in places),
        pa.field("seed", pa.int64()),
        pa.field("competent", pa.bool_()),
        pa.field("verdict", pa.string(), nullable=False),
        *(pa.field(name, pa.float64()) for name in numbers),
    ]
    return pa.schema(columns)


@dataclass(frozen=True)
class Measured:
    """Measurements of a building: files of the record and of its map."""

    building: str
    record: str
    map: str


def tasks_of_records(buildings: Iterable[FleetBuilding]) -> dict[str, Task]:
    """The identification of each building with measurements, by name; raises `ConfigError` for an unreadable file."""
    tasks = {}
    for building in buildings:
        if building.record is None:
            continue
        files = input_files(building.record)
        assert files is not None  # there are two paths
        content = sorted(str(dict(hashes)) for hashes in files.hashes.values())
        key = content_key(identified_from, [building.name, *content])
        title = f"{building.name} · identifying from measurements"
        tasks[building.name] = Task(
            key, title, identified_from, Measured(building.name, *building.record), (task_of(files),)
        )
    return tasks


def identified_from(measured: Measured, files: SentFiles = NO_FILES) -> Identified:
    """The model of measurements, or why they cannot be used or fitted; raises `ConfigError` for a wrong map."""
    try:
        with files.at_hand() as where:
            paths = [where.get(path, path) for path in (measured.record, measured.map)]
            model, _ = model_of_measurements([paths[0]], paths[1])
    except DataError as error:
        return Identified(refused=str(error))
    return Identified.of(model)


def with_models(
    buildings: Iterable[FleetBuilding], models: Mapping[str, Path], no_model: Mapping[str, str]
) -> list[FleetBuilding]:
    """The buildings that can be run: those with measurements act on their model, or have none and say why."""
    runnable = []
    for building in buildings:
        if building.record is None:
            runnable.append(building)
        elif building.runs and building.name in models:
            model = {"identification": {"model": str(models[building.name])}}
            runnable.append(replace(building, scenario=merge(dict(building.scenario), model)))
        elif building.runs:
            runnable.append(replace(building, no_model=no_model[building.name]))
    return runnable


def write_models(
    store: Store,
    runs: Sequence[FleetRun],
    records: Mapping[str, Mapping[str, Any]],
    measured: Mapping[str, Task],
    no_model: Mapping[str, str],
) -> Path:
    """Write `models.parquet`: a row for each actuator of each identification; raises `StorageError`.

    `records` by key name the model that a run had; `measured`, by building: identifications from measurements;
    `no_model`: verdicts where one of them gave none.
    """
    rows = []
    for name, task in measured.items():
        place = {"building": name, "window": "", "from": "record", "key": task.key}
        if name in no_model:
            rows.append({**place, "actuator": "", "competent": False, "verdict": no_model[name]})
        else:
            rows += _rows(store.model_path(task.key), place)
    first: dict[str, FleetRun] = {}
    for run in (run for run in runs if run.cell.identification_key is not None):
        first.setdefault(records[run.cell.key]["model"], run)
    for key, run in first.items():
        place = {"building": run.building.name, "window": run.cell.window, "from": "probing", "key": key}
        rows += _rows(store.model_path(key), {**place, "seed": run.cell.scenario.seed})
    content, path = io.BytesIO(), store.folder / MODELS
    pa = pyarrow_for(path, ConfigError)
    pa.parquet.write_table(pa.Table.from_pylist(rows, schema=_schema(pa)), content)
    write_plain(path, content.getvalue())
    return path


def _rows(path: Path, place: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The verdicts on the model at `path`, an actuator a row; one row where there is none."""
    try:
        if path.is_dir():
            model = load_model(path)
            cards = zip(model.names.actuators, model.cards, strict=True)
            return [{**place, "actuator": name, **_judged(card.competence)} for name, card in cards]
        verdict = f"refused: {path.read_text(encoding='utf-8')}" if path.is_file() else "failed"
    except (OSError, UnicodeDecodeError, ArtifactError) as error:
        verdict = f"cannot be read: {error}"  # of other source code, or it would have been identified again
    return [{**place, "actuator": "", "competent": False, "verdict": verdict}]


def _judged(competence: Competence | None) -> dict[str, Any]:
    if competence is None:
        return {"competent": None, "verdict": "not judged"}
    row: dict[str, Any] = {"competent": competence.competent, "verdict": competence.in_words()}
    row |= {name: getattr(competence, name) for name in _FIGURES}
    for score in competence.horizons:
        row |= {f"{what}_{score.hours:g}h_K": getattr(score, f"{what}_K") for what in _FORECASTS}
    return row


RUNS = "runs.parquet"
# Increased whenever a column changes its meaning, its type or its name.
FORMAT = "1"
_FORMAT_KEY = b"thermoforce_mpc.fleet"

_TEXT = ("building", "source", "emitter", "machine", "mass", "description", "window", "price", "variant", "controller",
         "uncertainty", "status", "reason", "plant", "weather", "key", "identification", "version", "code")  # fmt: skip
# Units: areas m²; costs currency/m²; energy kWh/m²; emissions kg/m²; peaks kW/m²; discomfort K·h per zone; times s.
_NUMBERS = ("area_m2", "days", "start_day", "cost_tot", "tdis_tot", "ener_tot", "emis_tot", "pele_tot", "pgas_tot",
            "pdih_tot", "seconds", "plan_median_s", "plan_longest_s")  # fmt: skip
_PLANS = tuple(f"plans_{status.value}" for status in PlanStatus)


@cache
def schema() -> Any:
    """Columns and types of the dataset; raises `ConfigError` where pyarrow is not installed."""
    pa = pyarrow_for(RUNS, ConfigError)
    texts = [pa.field(name, pa.string(), nullable=False) for name in _TEXT]
    numbers = [pa.field(name, pa.float64()) for name in _NUMBERS]
    whole = [pa.field(name, pa.int64(), nullable=False) for name in (*_PLANS, "plans_refused")]
    seed = pa.field("seed", pa.int64(), nullable=False)
    return pa.schema([*texts, seed, *numbers, *whole], metadata={_FORMAT_KEY: FORMAT.encode()})


def row_of(run: FleetRun, record: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a run with its record; what a failed run has not is missing."""
    cell = run.cell
    plans, kpis, seconds = (record.get(name) or {} for name in ("fallback_levels", "kpis", "seconds"))
    plant = record.get("plant") or {}
    row = _place(run) | {
        "controller": cell.scenario.controller.name,
        "days": cell.scenario.days,
        "status": record["status"],
        "reason": record["reason"],
        "plant": plant.get("kind", ""),
        "weather": plant.get("weather", ""),
        "key": cell.key,
        # That of the model the run had: after a change of the source the cell's key is another.
        "identification": record["model"] if cell.identification_key else "",
        "version": record["version"],
        "code": record["source"],
        "start_day": record.get("start_day"),
        "seconds": seconds.get("total"),
        "plan_median_s": seconds.get("plan_median"),
        "plan_longest_s": seconds.get("plan_longest"),
    }
    row |= {name: kpis.get(name) for name in _NUMBERS if name.endswith("_tot")}
    return row | {name: plans.get(name.removeprefix("plans_"), 0) for name in (*_PLANS, "plans_refused")}


def _place(run: FleetRun) -> dict[str, Any]:
    """Where a run stands in its fleet: the building and the axes."""
    building, cell = run.building, run.cell
    of_building = ("source", "emitter", "machine", "mass", "description", "area_m2")
    place = {"building": building.name} | {name: getattr(building, name) for name in of_building}
    of_cell = {name: getattr(cell, name) for name in ("window", "price", "uncertainty", "variant")}
    return place | of_cell | {"seed": cell.scenario.seed}


def finished_rows(datasets: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Rows of the finished runs of datasets (folders or files), by key; raises `ConfigError` for another schema."""
    by_key: dict[str, dict[str, Any]] = {}
    for path in datasets:
        rows = read_dataset(path)
        finished = rows[rows["status"] == DONE].astype(object)
        by_key |= {row["key"]: row for row in finished.where(finished.notna(), None).to_dict("records")}
    return by_key


def reused_row(run: FleetRun, row: Mapping[str, Any]) -> dict[str, Any]:
    """The `row` of a run with the same inputs as a row of this run."""
    return {**row, **_place(run)}


def write_dataset(folder: Path, rows: Iterable[Mapping[str, Any]]) -> Path:
    """Write the rows (`row_of`) in the order given as `runs.parquet`, whole or not at all; raises `StorageError`."""
    path, content = folder / RUNS, io.BytesIO()
    pa = pyarrow_for(path, ConfigError)
    pa.parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema=schema()), content)
    write_plain(path, content.getvalue())
    return path


def check_dataset(path: Path) -> None:
    """Refuse a dataset, the file or its folder, of another schema; raises `ConfigError`."""
    pa, path = pyarrow_for(path, ConfigError), _file(path)
    if not path.exists():
        return
    try:
        found = pa.parquet.read_schema(path)
    except (OSError, pa.ArrowException) as error:
        raise ConfigError(f"{path}: is no dataset of a fleet ({error}); give another folder, or remove it") from error
    version = (found.metadata or {}).get(_FORMAT_KEY, b"none").decode(errors="replace")
    if version != FORMAT or found.names != schema().names or found.types != schema().types:
        version += " with other columns" if version == FORMAT else ""
        raise ConfigError(
            f"{path}: its schema is {version}, this release writes {FORMAT}; give another folder, or remove it to have "
            "it written anew from the runs beside it"
        )


def read_dataset(path: Path) -> pd.DataFrame:
    """The dataset in a fleet's folder or file, one row a run; raises `ConfigError` for another one."""
    path = _file(path)
    if not path.exists():
        raise ConfigError(f"{path}: is missing; make it with `tf-mpc fleet`")
    check_dataset(path)
    try:
        return pd.read_parquet(path)
    except (OSError, pyarrow_for(path, ConfigError).ArrowException) as error:
        raise ConfigError(f"{path}: is damaged ({str(error).strip()}); remove it, or give another dataset") from error


def _file(path: Path) -> Path:
    return path if path.suffix == ".parquet" else path / RUNS
