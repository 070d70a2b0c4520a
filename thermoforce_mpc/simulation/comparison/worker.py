"""Processes of a comparison: identify a model, or run one closed loop and store its result."""

from __future__ import annotations

import signal
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from controllers.registry import build_controller, find_entry, has_gate
from thermoforce_mpc.data import DAY_S, PlantInfo
from thermoforce_mpc.errors import DataError, ThermoForceError
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario, load_testcase
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, run_closed_loop
from thermoforce_mpc.simulation.comparison.cells import FORMAT, Cell, source_fingerprint
from thermoforce_mpc.simulation.comparison.store import DONE, FAILED, Store
from thermoforce_mpc.simulation.composition import build_plant, controller_options, scored_period
from thermoforce_mpc.simulation.identifying import model_for, run_identification
from thermoforce_mpc.version import VERSION

# Message of a worker to the parent: ("day", days simulated), and at the end ("done", "") or ("failed", reason).
Message = tuple[str, float | str]


def learn(cell: Cell, folder: Path, channel: Connection) -> None:
    """Process: probe and identify for `cell` and save the model in the comparison's folder."""
    _answer(channel, lambda: _identify(cell, Store(folder)))


def run(cell: Cell, folder: Path, channel: Connection) -> None:
    """Process: run the closed loop of `cell` and store its result; a failure is sent to the parent."""
    _answer(channel, lambda: _run(cell, Store(folder), channel))


def failure(cell: Cell, reason: str) -> dict[str, Any]:
    """Record of a failed cell."""
    return _head(cell) | {"status": FAILED, "reason": reason}


def _answer(channel: Connection, work: Callable[[], None]) -> None:
    """Do `work` and send its outcome to the parent.

    SIGINT is ignored: the parent handles interrupts, and ends this process by SIGTERM.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the plant is released
    message: Message = (DONE, "")
    try:
        work()
    except ThermoForceError as error:
        message = (FAILED, str(error))
    except Exception as error:  # recorded as failure of this cell; other cells continue
        message = (FAILED, f"{type(error).__name__}: {error}")
    with suppress(OSError):  # the parent has exited
        channel.send(message)
        channel.close()


def _identify(cell: Cell, store: Store) -> None:
    """Identify and save the model of `cell`; uses only `cell.task`, whose hash is the model's key.

    Where the data cannot be fitted, a file with the reason takes the model's place: controllers with a gate stand back.
    """
    task = cell.task
    assert task is not None
    assert cell.identification_key is not None
    path = store.model_path(cell.identification_key)
    try:
        with closing(build_plant(task.plant, task.testcase, task.seed)) as plant:
            model = run_identification(task, plant)
    except DataError as error:
        write_whole(path, str(error))
        return
    model.save(path, overwrite=path.exists())


def _run(cell: Cell, store: Store, channel: Connection) -> None:
    scenario = cell.scenario
    name = scenario.controller.name
    testcase = load_testcase(scenario.testcase)
    if cell.identification_key is not None:
        identified = scenario.identification.model_copy(
            update={"model": str(store.model_path(cell.identification_key))}
        )
        scenario = scenario.model_copy(update={"identification": identified})
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        period = scored_period(plant, scenario.period, scenario.days)
        model = _model(scenario, testcase, plant) if find_entry(name).needs_model else None
        controller = build_controller(name, controller_options(scenario, name), testcase, model)
        told = time.monotonic()

        def on_step(record: StepRecord) -> None:
            nonlocal told
            if time.monotonic() - told > 0.5:
                told = time.monotonic()
                with suppress(OSError):
                    channel.send(("day", (record.time_s - period.start_s) / DAY_S))

        allowed = limits_of(controller, testcase.area_m2, min(testcase.layout.lowest))
        result = run_closed_loop(plant, controller, period, scenario.price, on_step, allowed, testcase.layout.lowest)
        store.write(cell, _record(cell, result, plant.info))


def _model(scenario: Scenario, testcase: TestCase, plant: Plant) -> ThermalModel | str:
    """The model of the scenario's controller, or why there is none; raises `DataError` where it has no gate."""
    saved = scenario.identification.model
    if saved is None or not Path(saved).is_file():
        return model_for(scenario, testcase, plant)
    refused = Path(saved).read_text(encoding="utf-8")
    name = scenario.controller.name
    if not has_gate(name, controller_options(scenario, name), testcase):
        raise DataError(refused)
    return refused


def _head(cell: Cell) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "key": cell.key,
        "version": VERSION,
        "source": source_fingerprint(),
        "variant": cell.variant,
        "controller": cell.scenario.controller.name,
        "needs_model": find_entry(cell.scenario.controller.name).needs_model,
        "window": cell.window,
        "price": cell.price,
        "uncertainty": cell.uncertainty,
        "model": cell.identification_key or cell.scenario.identification.model,
        "scenario": cell.scenario.model_dump(mode="json"),
    }


def _record(cell: Cell, result: RunResult, plant: PlantInfo) -> dict[str, Any]:
    kpis = {name: value for name, value in result.kpis.items() if name != "time_rat"}
    return _head(cell) | {
        "status": DONE,
        "reason": "",
        "start_day": result.period.start_s / DAY_S,
        "scored_days": result.period.scored_s / DAY_S,
        "plant": asdict(plant),
        "kpis": kpis,
        "fallback_levels": result.fallback_levels(),
        "seconds": _seconds(result.steps, result.seconds),
    }


def _seconds(steps: Sequence[StepRecord], total: float) -> dict[str, float]:
    """Computing times, s: totals over the run, and medians per step of the plan and its parts."""
    plans = [step.plan_seconds for step in steps]
    parts = {name for step in steps for name in step.plan.seconds}
    medians = {
        f"{name}_median": statistics.median(step.plan.seconds.get(name, 0.0) for step in steps)
        for name in sorted(parts)
    }
    return {
        "total": total,
        "controller": sum(plans),
        "plant": sum(step.plant_seconds for step in steps),
        "plan_median": statistics.median(plans),
        "plan_longest": max(plans),
        **medians,
    }
