"""Probing of a real building by the loop that controls it, until a model of it may act."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import Block, Layout, PlantInfo
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.keys import canonical, digest
from thermoforce_mpc.experiment.identifying import settings_for
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.probing.probe import ProbingConfig, ProbingController, ProbingState
from thermoforce_mpc.live.building import LiveBuilding
from thermoforce_mpc.live.control import Clock, WallClock, control
from thermoforce_mpc.loop.probing import Identifying, Probed, UntilKnown
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.scenario import ProbingSpec
from thermoforce_mpc.version import VERSION

# A building is read four weeks back: what was probed before would be lost.
_MOST_DAYS = 27.0


@dataclass(frozen=True)
class RealBuilding:
    """What is known of a real building that is probed (`ProbedBuilding`)."""

    layout: Layout
    step_s: float
    currency: str = "currency"


@dataclass(frozen=True)
class ProbingPlan:
    """How a building is to be probed: `spec` as in a scenario, settings of draws and identification, and the seed."""

    spec: ProbingSpec
    probing: ProbingConfig
    identification: IdentificationConfig
    seed: int = 1

    @classmethod
    def of(cls, spec: ProbingSpec, options: MPCConfig, rules: MeasurementMap) -> ProbingPlan:
        """The plan for a controller with these `options`, at a building of this map.

        Raises `ConfigError` for settings that a building cannot be probed with; names the key.
        """
        if spec.model is not None or spec.probed is not None:
            raise ConfigError("identification: model and probed take the place of probing: leave them out, or --mode")
        if max(spec.days, spec.most_days) > _MOST_DAYS:
            raise ConfigError(f"identification.most_days: at most {_MOST_DAYS:g} at a real building")
        for name, actuator in rules.actuators.items():
            set_by = rules.command_of(name)
            if set_by is not None or actuator.mode == "both":
                what = set_by[1].name_in_words if set_by is not None else "room set-points"
                raise ConfigError(
                    f"actuators.{name}: is set by {what}, and probing sets levels: record some weeks in which it was "
                    "changed, and use `tf-mpc identify`"
                )
        metered = all(actuator.heat is not None for actuator in rules.actuators.values())
        step_s = {} if "step_s" in spec.probing or options.step_s is None else {"step_s": options.step_s}
        probing, identification = settings_for(options.actuation, metered, spec, cls.seed, step_s)
        return cls(spec, probing, identification, cls.seed)


def probing_key(plan: ProbingPlan, rules: MeasurementMap) -> str:
    """Key by which a kept state tells probings apart: of the same settings and actuators the same."""
    return digest({"probing": canonical((plan.probing.model_dump(mode="json"), plan.seed, rules.names.actuators))})


def probe_building(
    building: LiveBuilding,
    plan: ProbingPlan,
    *,
    clock: Clock | None = None,
    say: Callable[[str], None] = lambda text: None,
    **options: Any,
) -> ThermalModel | None:
    """Probe a building as `plan` says, with the politeness and the end rule of simulated plants, and identify a model.

    Args:
        building: at the step of the probing.
        options: those of `control`.

    Returns:
        The model, with its verdicts; None where the loop ended before the probing (`steps`).

    Raises:
        InputError, PlantError: as `control`.
        DataError: no model can be identified from what was probed.
    """
    clock = clock or WallClock()
    now = clock.now()
    building.record(building.instant(now), now=now)
    step_s = plan.probing.step_s
    where, info = RealBuilding(building.layout, step_s), PlantInfo("real", "the building", "", "measured", VERSION)
    identifying = Identifying(where, plan.identification, step_s, say)
    spec = plan.spec
    until = UntilKnown(
        identifying,
        info,
        step_s,
        days=spec.days,
        most_days=max(spec.days, spec.most_days),
        end_early=spec.end_early,
    )
    controller = ProbingController(building.layout, plan.probing, plan.seed, until)
    state = control(building, controller, clock=clock, **options)
    if not until.why:
        return None
    assert isinstance(state, ProbingState)
    assert until.record is not None
    return identifying.conclude(Probed(until.record, _asked(state, step_s), info, until.why), until.look)


def _asked(state: ProbingState, step_s: float) -> tuple[Block, ...]:
    """What was asked for in each step of a probing."""
    return tuple(
        Block(tuple(None if math.isnan(u) else float(u) for u in levels), step_s)
        for levels in np.transpose(state.asked)
    )
