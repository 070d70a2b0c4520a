"""State that an MPC passes from step to step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from controllers.actuation.actuator import ActuationState
from controllers.monitoring.meters import MeterState
from controllers.monitoring.sun_on_sensors import SunState
from controllers.monitoring.watch_state import ScaledModel, WatchState
from controllers.monitoring.zone_sensor_state import SensorState
from controllers.mpc.margins import Margins
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import Boundary, Names, Observation
from thermoforce_mpc.model.predictor import PredictorState


@dataclass(frozen=True)
class MPCState:
    """Controller state passed from one plan to the next.

    `first_s`: time of the first plan, s; `peak_W`: highest mean power of the building over a step since, W; `good`:
    last solved plan that was followed; `predictor`: state of the predictor. Of each actuator (A,): `actuation` (state
    of its machine), `adaptation` (None at the start of a run) and `watch` (what the watch knows of its predictions).
    `margins`: what was learned of bounds, predictions and capacities. `sensors` (Z,): what is known of the zone
    sensors, and `sun` of the sun on them; `meters`: of weather sensors and meters. `boundary`: the last forecast of the
    boundary conditions without gaps. `failures`: consecutive failed plans. `last_s`: time of the last plan, s.
    """

    first_s: float
    peak_W: float = 0.0
    actuation: tuple[ActuationState, ...] = (ActuationState(),)
    good: GoodPlan | None = None
    predictor: PredictorState | None = None
    adaptation: tuple[ScaledModel | None, ...] = (None,)
    watch: tuple[WatchState, ...] = (WatchState(),)
    margins: Margins = field(default_factory=Margins)
    sensors: tuple[SensorState, ...] = (SensorState(),)
    meters: tuple[MeterState, ...] = ()
    sun: SunState = field(default_factory=SunState)
    boundary: Boundary | None = None
    failures: int = 0
    last_s: float | None = None

    @classmethod
    def begin(
        cls, time_s: float, names: Names, watch: tuple[WatchState, ...], meters: tuple[MeterState, ...]
    ) -> MPCState:
        """The state at the begin of a run of a building."""
        actuators, zones = len(names.actuators), len(names.zones)
        return cls(
            time_s,
            adaptation=(None,) * actuators,
            watch=watch,
            margins=Margins.nothing(zones, len(names.machines)),
            sensors=(SensorState(),) * zones,
            meters=meters,
        )

    @property
    def rows(self) -> dict[str, int]:
        """How many zones, actuators and machines it is of."""
        return {"zones": len(self.sensors), "actuators": len(self.actuation), "machines": self.margins.unused.size}

    def without_forced(self) -> MPCState:
        """Without the forced state so far, where what it was estimated from does not hold any more."""
        return self if self.predictor is None else replace(self, predictor=replace(self.predictor, forced=None))

    def peak_after(self, observation: Observation) -> float:
        """Highest mean power of the building over a step since the first plan, with the last step, W."""
        power = observation.history.power_W
        if power.shape[1] and observation.time_s > self.first_s and np.isfinite(power[:, -1]).all():
            return max(self.peak_W, float(power[:, -1].sum()))
        return self.peak_W
