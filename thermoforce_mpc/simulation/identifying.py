"""Identification before a scored window: settings, probing of the plant, and the identified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from pydantic import BaseModel

from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Period, Record
from thermoforce_mpc.protocols import Plant, RoomSetpointPlant
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario, load_testcase
from thermoforce_mpc.scenario.settings import merge, validate
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.composition import check_window, controller_options

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig
    from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class IdentificationTask:
    """All inputs of an identification before a window; `run_identification` uses nothing else.

    `period`: scored window, which is not probed; `days`: days of probing, which end where its warm-up begins;
    `step_s`: step of the model, s; `seed`: seed of the probing and of the forecast errors in `plant`, which the
    probing design uses.
    """

    testcase: TestCase
    plant: PlantSpec
    period: str
    days: float
    step_s: float
    seed: int
    probing: ProbingConfig
    identification: IdentificationConfig

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values, for a hash key or a file."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            name: value.model_dump(mode="json") if isinstance(value, BaseModel) else value
            for name, value in values.items()
        }


@dataclass(frozen=True)
class IdentifiedModel:
    """A model and its origin, for the manifest."""

    model: ThermalModel
    origin: Mapping[str, Any]


def identify_on(
    plant: Plant,
    *,
    before: Period,
    days: float,
    testcase: TestCase | None = None,
    step_s: float | None = None,
    seed: int = 1,
    probing: ProbingConfig | None = None,
    config: IdentificationConfig | None = None,
    on_step: Callable[[float], None] | None = None,
    on_record: Callable[[Record], None] | None = None,
) -> ThermalModel:
    """Probe `plant` for `days` that end where the warm-up of `before` begins, and identify a model from them.

    If they would begin before the start of the year, the last days of the year are probed instead.

    Args:
        testcase: mode, floor area and default step; by default those of `bestest_hydronic_heat_pump`.
        step_s: step of the model; by default the test case's.
        on_step: called with the share of the probing done.
        on_record: called with the record before identification.

    Raises:
        DataError: the record is not sufficient for identification; the message has numbers and advice.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.identification.pipeline import identify
    from thermoforce_mpc.identification.probing.probe import probe, probe_room

    testcase = testcase or load_testcase("bestest_hydronic_heat_pump")
    start_s = before.start_s - before.warmup_s - days * DAY_S
    if start_s < 0:
        start_s = 365 * DAY_S - days * DAY_S
    if testcase.mode == "both":
        record = probe_room(
            cast(RoomSetpointPlant, plant),
            start_s,
            days,
            seed=seed,
            lowest=testcase.lowest_level,
            config=probing,
            on_step=on_step,
        )
    else:
        record = probe(
            plant, start_s, days, seed=seed, mode=testcase.mode, config=probing, identification=config, on_step=on_step
        )
    if on_record:
        on_record(record)
    info = plant.info
    first = start_s / DAY_S
    return identify(
        [record],
        config=config,
        mode=testcase.mode,
        lowest=testcase.lowest_level,
        floor_area_m2=testcase.floor_area_m2,
        step_s=step_s or testcase.step_s,
        source=f"{days:g} days of probing (days {first:g} to {first + days:g}) on {info.kind} {info.testcase}, "
        f"{info.weather}",
    )


def identification_settings(
    scenario: Scenario, testcase: TestCase, controller: str | None = None
) -> tuple[ProbingConfig, IdentificationConfig]:
    """Probing and identification settings for `controller`, by default the scenario's; `ConfigError` names wrong keys.

    By default the machine is probed at the levels that this controller uses.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig

    spec, name = scenario.identification, controller or scenario.controller.name
    actuation = getattr(controller_config(name, controller_options(scenario, name), testcase), "actuation", None)
    defaults: dict[str, Any] = {}
    if actuation is not None and actuation.mode == "modulating":
        # Probe the intermediate levels that a plan can use.
        defaults["levels"] = (0.0, *np.linspace(actuation.lowest_level, 1.0, 5).round(3).tolist())
    elif actuation is not None:
        defaults["levels"] = (0.0, actuation.level)
    own = testcase.defaults
    probing = validate(ProbingConfig, merge(merge(defaults, own.probing), spec.probing), "identification.probing")
    options = merge(merge({"seed": scenario.seed}, own.identification), spec.options)
    config = validate(IdentificationConfig, options, "identification.options")
    return probing, config


def identification_task(scenario: Scenario, testcase: TestCase, controller: str | None = None) -> IdentificationTask:
    """Identification task of `controller`, by default the scenario's own.

    Raises:
        ConfigError: a setting of the identification is wrong.
    """
    probing, config = identification_settings(scenario, testcase, controller)
    return IdentificationTask(
        testcase=testcase,
        plant=scenario.plant,
        period=scenario.period,
        days=scenario.identification.days,
        step_s=scenario.step_s or testcase.step_s,
        seed=scenario.seed,
        probing=probing,
        identification=config,
    )


def run_identification(
    task: IdentificationTask, plant: Plant, on_record: Callable[[Record], None] | None = None
) -> ThermalModel:
    """Probe `plant`, which must be that of `task`, and identify a model.

    Args:
        on_record: called with the record before identification.

    Raises:
        DataError: the record is not sufficient for identification.
        PlantError: the plant failed.
    """
    check_window(task.period)
    return identify_on(
        plant,
        before=plant.period(task.period),
        days=task.days,
        testcase=task.testcase,
        step_s=task.step_s,
        seed=task.seed,
        probing=task.probing,
        config=task.identification,
        on_record=on_record,
    )


def model_for(scenario: Scenario, testcase: TestCase, plant: Plant, controller: str | None = None) -> ThermalModel:
    """Model of `controller`: the saved one named in the scenario, resampled to its step, or a newly identified one.

    Raises:
        ArtifactError: the saved model cannot be used.
        DataError: the record is not sufficient for identification.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.model.thermal_model import load_model

    spec = scenario.identification
    if spec.model is None:
        return run_identification(identification_task(scenario, testcase, controller), plant)
    step_s = scenario.step_s or testcase.step_s
    model = load_model(Path(spec.model))
    if model.operator.step_s != step_s:
        model = replace(model, operator=model.operator.resampled(step_s))
    return model
