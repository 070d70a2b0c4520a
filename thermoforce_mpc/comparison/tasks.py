"""Tasks of a comparison: identify a model, run one closed loop, search thermostats that are as comfortable."""

from __future__ import annotations

import io
import statistics
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from thermoforce_mpc.comparison.cells import FORMAT, Cell, Inputs, varied
from thermoforce_mpc.comparison.input_files import NO_FILES, SentFiles, input_files, moved, paths_of, task_of
from thermoforce_mpc.comparison.store import DONE, FAILED, Identified, Ran, Store
from thermoforce_mpc.data import DAY_S, PlantInfo
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Task, source_fingerprint, tell
from thermoforce_mpc.experiment.equal_comfort import SET_POINTS, THERMOSTAT, as_comfortable, raised
from thermoforce_mpc.experiment.experiment import Contestant, Experiment, Setting
from thermoforce_mpc.experiment.identifying import IdentificationTask, SavedModel, model_for, run_identification
from thermoforce_mpc.files import write_folder
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.records.run_folder import trajectory_frame, with_own_kpis
from thermoforce_mpc.report.findings import COST, DISCOMFORT
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.version import VERSION


def tasks_of(cells: Iterable[Cell]) -> list[Task]:
    """A task for each cell, with the files and the identification it needs, which cells share; raises `ConfigError`."""
    files: dict[tuple[str, ...], tuple[Task, ...]] = {}

    def file_tasks(paths: Iterable[str]) -> tuple[Task, ...]:
        key = tuple(sorted(set(paths)))
        if key not in files:
            inputs = input_files(key)
            files[key] = (task_of(inputs),) if inputs else ()
        return files[key]

    tasks = []
    for cell in cells:
        needs = file_tasks(paths_of(cell.scenario))
        if cell.task is not None and cell.identification_key is not None:
            read = file_tasks(paths_of(cell.task))
            needs += (Task(cell.identification_key, cell.identification_title, identified, cell.task, read),)
        tasks.append(Task(cell.key, cell.title, follow, cell, needs))
    return tasks


def failure(cell: Cell, reason: str) -> dict[str, Any]:
    """Record of a failed cell."""
    return _head(cell) | {"status": FAILED, "reason": reason}


def identified(task: IdentificationTask, files: SentFiles = NO_FILES) -> Identified:
    """Probe and identify; where the data cannot be fitted, the reason takes the model's place. Raises `PlantError`."""
    try:
        with files.at_hand() as where:
            task = moved(task, where)
            with closing(build_plant(task.plant, task.testcase, task.seed, task.comfort)) as plant:
                model = run_identification(task, plant, on_progress=lambda p: tell(p.days / p.planned_days))
    except DataError as error:
        return Identified(refused=str(error))
    return Identified.of(model)


def follow(cell: Cell, *needs: SentFiles | Identified) -> Ran:
    """Run the closed loop of `cell`, with the files and the model it needs.

    Raises:
        DataError: the data of the identification could not be fitted, and the controller has no gate.
        ArtifactError: a saved model cannot be used.
        PlantError: the plant failed.
    """
    files = next((need for need in needs if isinstance(need, SentFiles)), NO_FILES)
    model = next((need for need in needs if isinstance(need, Identified)), None)
    with files.at_hand() as where:
        experiment = Experiment.of(moved(cell.scenario, where))
        with closing(experiment.plant.build()) as plant:
            setting, own = Setting.of(plant, experiment), experiment.own
            acts_on = None if own.model_from is None else _model(own, plant, model)

            def on_step(record: StepRecord) -> None:
                tell((record.time_s - setting.period.start_s) / setting.period.scored_s)

            result = setting.run(own.chosen.build(acts_on), on_step)
            record = _record(cell, with_own_kpis(result, experiment.kpis), plant.info)
            return Ran(record, _parquet(cell, result.steps) if cell.trajectory else b"")


def _parquet(cell: Cell, steps: Sequence[StepRecord]) -> bytes:
    frame = trajectory_frame(steps)
    # No names of this run: another of the same inputs, called otherwise, has the same course.
    for place, name in enumerate(("window", "price", "key")):
        frame.insert(place, name, getattr(cell, name))
    content = io.BytesIO()
    frame.to_parquet(content, index=False)
    return content.getvalue()


def _model(contestant: Contestant, plant: Plant, model: Identified | None) -> ThermalModel | str:
    """What the controller acts on: a model, or why there is none; raises `DataError` where it has no gate."""
    source = contestant.model_from
    assert source is not None  # it needs one
    if model is None:
        return model_for(source, plant)
    if model.refused:
        if not contestant.chosen.has_gate:
            raise DataError(model.refused)
        return model.refused
    with tempfile.TemporaryDirectory() as folder:
        write_folder(saved := Path(folder) / "model", model.files)
        return SavedModel(str(saved), source.step_s).load()


def _head(cell: Cell) -> dict[str, Any]:
    scenario = cell.scenario
    return {
        "format": FORMAT,
        "key": cell.key,
        "version": VERSION,
        "source": source_fingerprint(),
        "variant": cell.variant,
        "controller": scenario.controller.name,
        "needs_model": cell.needs_model,
        "window": cell.window,
        "price": cell.price,
        "uncertainty": cell.uncertainty,
        "model": cell.identification_key or scenario.identification.model,
        "scenario": scenario.model_dump(mode="json"),
    }


def _record(cell: Cell, result: RunResult, plant: PlantInfo) -> dict[str, Any]:
    """Record of a finished cell: what it is, its KPIs, plans by status and computing times, s."""
    steps, plans = result.steps, [step.plan_seconds for step in result.steps]
    parts = {name for step in steps for name in step.plan.seconds}
    return _head(cell) | {
        "status": DONE,
        "reason": "",
        "start_day": result.period.start_s / DAY_S,
        "scored_days": result.period.scored_s / DAY_S,
        "plant": asdict(plant),
        "kpis": {name: value for name, value in result.kpis.items() if name != "time_rat"},
        "fallback_levels": result.fallback_levels(),
        "seconds": {
            "total": result.seconds,
            "controller": sum(plans),
            "plant": sum(step.plant_seconds for step in steps),
            "plan_median": statistics.median(plans),
            "plan_longest": max(plans),
        }
        | {
            f"{name}_median": statistics.median(step.plan.seconds.get(name, 0.0) for step in steps)
            for name in sorted(parts)
        },
    }


Record = Mapping[str, Any]


@dataclass(frozen=True)
class EqualComfort:
    """Searches thermostats for the cells of a comparison; `say` is told of each."""

    store: Store
    inputs: Inputs
    testcase: TestCase
    say: Callable[[str], None]

    def beside(self, cells: Sequence[Cell], records: Sequence[Record]) -> list[dict[str, Any]]:
        """The records (of `cells`), those of controllers with a model with the thermostat that is as comfortable.

        It is searched from the first thermostat of the same window, tariff and forecast error, by runs that are cells
        of the comparison too: stored, found again. Raises `PlantError`.
        """
        pairs = list(zip(cells, map(dict[str, Any], records), strict=True))
        done = [(cell, record) for cell, record in pairs if record["status"] == DONE]
        thermostats = {c.group: (c, record) for c, record in reversed(done) if record["controller"] == THERMOSTAT}
        for cell, record in done:
            if record["needs_model"] and cell.group in thermostats:
                thermostat, at_its_own = thermostats[cell.group]
                run = partial(self._shifted, thermostat)
                equal = as_comfortable(run, at_its_own["kpis"], record["kpis"][DISCOMFORT])
                record["equal_comfort"] = equal.to_json(record["kpis"][COST], self.testcase.currency)
                self.say(f"{cell.title}: {record['equal_comfort']['in_words']}")
        return [record for _, record in pairs]

    def _shifted(self, thermostat: Cell, shift_K: float) -> Mapping[str, float]:
        """KPIs of a thermostat with other set-points, run in this process where they are not stored."""
        # Its own step and set-backs, and the set-points that it has where it is not shifted.
        config = raised(Experiment.of(thermostat.scenario).own.chosen, shift_K).config
        options = thermostat.scenario.controller.options | config.model_dump(include=SET_POINTS)
        cell = varied(thermostat, f"{THERMOSTAT} {shift_K:+.2f} K", options, self.inputs)
        record = self.store.finished(cell)
        if record is None:
            self.store.write(cell, ran := follow(cell))
            record = ran.record
        return dict(record["kpis"])
