"""The models of a fleet: identified from measurements before the runs, and the verdicts on all of them as a dataset."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import ArtifactError, ConfigError, DataError
from thermoforce_mpc.execution import Task, content_key
from thermoforce_mpc.files import pyarrow_for
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.scenario.settings import merge
from thermoforce_mpc.simulation.comparison.input_files import NO_FILES, SentFiles, input_files, task_of
from thermoforce_mpc.simulation.comparison.store import Identified, Store
from thermoforce_mpc.simulation.fleet.buildings import Building
from thermoforce_mpc.simulation.fleet.runs import Run
from thermoforce_mpc.simulation.folder.plain_files import write_plain
from thermoforce_mpc.simulation.models.measured_model import model_of_measurements

NAME = "models.parquet"
_LEAD_H = (1, 6, 24)


def _schema(pa: Any) -> Any:
    """Columns and types of the verdicts; `pa` is pyarrow."""
    places = ("building", "window", "from", "actuator", "key")
    errors = [f"{what}_{h}h_K" for h in _LEAD_H for what in ("model", "persistence", "weather")]
    numbers = ["effect_K", "effect_sd_K", "sign_probability", "log_odds", *errors]
    return pa.schema(
        [
            *(pa.field(name, pa.string(), nullable=False) for name in places),
            pa.field("seed", pa.int64()),
            pa.field("competent", pa.bool_()),
            pa.field("verdict", pa.string(), nullable=False),
            *(pa.field(name, pa.float64()) for name in numbers),
        ]
    )


@dataclass(frozen=True)
class Measured:
    """Measurements of a building: files of the record and of its map."""

    building: str
    record: str
    map: str


def tasks_of_records(buildings: Iterable[Building]) -> dict[str, Task]:
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
    """The model of measurements; where they cannot be used or fitted, the reason takes its place.

    Raises:
        ConfigError: the map is wrong.
    """
    try:
        with files.at_hand() as where:
            paths = [where.get(path, path) for path in (measured.record, measured.map)]
            model, _ = model_of_measurements([paths[0]], paths[1])
    except DataError as error:
        return Identified(refused=str(error))
    return Identified.of(model)


def with_models(
    buildings: Iterable[Building], models: Mapping[str, Path], no_model: Mapping[str, str]
) -> list[Building]:
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
    runs: Sequence[Run],
    records: Mapping[str, Mapping[str, Any]],
    measured: Mapping[str, Task],
    no_model: Mapping[str, str],
) -> Path:
    """Write `models.parquet`: a row for each actuator of each identification; raises `StorageError`.

    Args:
        store: the folder of the fleet, where its models are.
        runs: runs that were made here, now or before.
        records: their records by key; they name the model that a run had.
        measured: identifications from measurements by building.
        no_model: verdict where one of them gave no model, by building.
    """
    rows, written = [], set[str]()
    for name, task in measured.items():
        place = {"building": name, "window": "", "from": "record", "key": task.key}
        if name in no_model:
            rows.append({**place, "actuator": "", "competent": False, "verdict": no_model[name]})
        else:
            rows += _rows(store.model_path(task.key), place)
    for run in runs:
        if run.cell.identification_key is None:
            continue
        key = records[run.cell.key]["model"]
        if key not in written:
            written.add(key)
            rows += _rows(
                store.model_path(key),
                {"building": run.building.name, "window": run.cell.window, "from": "probing", "key": key}
                | {"seed": run.cell.scenario.seed},
            )
    content, path = io.BytesIO(), store.folder / NAME
    pa = pyarrow_for(path, ConfigError)
    pa.parquet.write_table(pa.Table.from_pylist(rows, schema=_schema(pa)), content)
    write_plain(path, content.getvalue())
    return path


def _rows(path: Path, place: Mapping[str, Any]) -> list[dict[str, Any]]:
    none = {**place, "actuator": "", "competent": False}
    try:
        if path.is_file():
            return [{**none, "verdict": f"refused: {path.read_text(encoding='utf-8')}"}]
        if not path.is_dir():
            return [{**none, "verdict": "failed"}]
        model = load_model(path)
    except (OSError, UnicodeDecodeError, ArtifactError) as error:
        # Of other source code, or it would have been identified again.
        return [{**none, "verdict": f"cannot be read: {error}"}]
    rows = []
    for actuator, card in zip(model.names.actuators, model.cards, strict=True):
        competence = card.competence
        row = {**place, "actuator": actuator, "competent": None, "verdict": "not judged"}
        if competence is not None:
            row |= {"competent": competence.competent, "verdict": competence.in_words()}
            figures = ("effect_K", "effect_sd_K", "sign_probability", "log_odds")
            row |= {name: getattr(competence, name) for name in figures}
            for score in competence.horizons:
                row |= {
                    f"{what}_{score.hours:g}h_K": getattr(score, f"{what}_K")
                    for what in ("model", "persistence", "weather")
                }
        rows.append(row)
    return rows
