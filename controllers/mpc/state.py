"""State that an MPC passes from step to step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controllers.actuation.actuator import ActuationState
from controllers.monitoring.meters import MeterState
from controllers.monitoring.sun_on_sensors import SunState
from controllers.monitoring.watch_state import WatchState
from controllers.monitoring.zone_sensor_state import SensorState
from controllers.mpc.margins import LearnedMargin
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import Array, Boundary
from thermoforce_mpc.identification.estimation.adaptation import AdaptationState
from thermoforce_mpc.model.predictor import PredictorState


@dataclass(frozen=True)
class MPCState:
    """Controller state passed from one plan to the next.

    `first_s`: time of the first plan, s; `peak_W`: highest mean power of the building over a step since, W; `good`:
    last solved plan; `predictor`: state of the predictor. Of each actuator (A,): `actuation` (state of its machine),
    `adaptation` (None at the start of a run) and `watch` (what the watch knows of its predictions). `offset_K` (Z,):
    recent mean error of the zone temperatures planned for the end of a step. `missed`: what was learned of the bounds.
    `kept` (M,): share of each machine's capacity that plans leave unused. `sensors` (Z,): what is known of the zone
    sensors, and `sun` of the sun on them; `meters`: of weather sensors and meters. `boundary`: the last forecast of the
    boundary conditions without gaps. `failures`: consecutive failed plans. `last_s`: time of the last plan, s.
    """

    first_s: float
    peak_W: float = 0.0
    actuation: tuple[ActuationState, ...] = (ActuationState(),)
    good: GoodPlan | None = None
    predictor: PredictorState | None = None
    adaptation: tuple[AdaptationState | None, ...] = (None,)
    watch: tuple[WatchState, ...] = (WatchState(),)
    offset_K: Array = field(default_factory=lambda: np.zeros(1))
    missed: LearnedMargin = field(default_factory=lambda: LearnedMargin.nothing(1))
    kept: Array = field(default_factory=lambda: np.zeros(1))
    sensors: tuple[SensorState, ...] = (SensorState(),)
    meters: tuple[MeterState, ...] = ()
    sun: SunState = field(default_factory=SunState)
    boundary: Boundary | None = None
    failures: int = 0
    last_s: float | None = None

    @property
    def rows(self) -> dict[str, int]:
        """How many zones, actuators and machines it is of."""
        return {"zones": len(self.sensors), "actuators": len(self.actuation), "machines": self.kept.size}
