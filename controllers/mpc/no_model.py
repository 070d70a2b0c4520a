"""Controller of a run for which no model could be identified: native control or the on/off rule, never a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.checks import check_names
from controllers.mpc.config import MPCConfig
from controllers.safety.base import ActuatedController
from thermoforce_mpc.data import HOUR_S, Layout, Observation, Plan, PlanStatus


@dataclass(frozen=True)
class NoModelState:
    """States of the actuators between two steps (A,), and the time of the last plan, s."""

    actuation: tuple[ActuationState, ...] = ()
    last_s: float | None = None

    @property
    def rows(self) -> dict[str, int]:
        """How many actuators it is of."""
        return {"actuators": len(self.actuation)}


class NoModelController(ActuatedController):
    """Takes the place of an MPC that has no model; its plans have the status `gate`."""

    def __init__(self, reason: str, config: MPCConfig, layout: Layout, step_s: float, *, name: str) -> None:
        """Set up the rule.

        Args:
            reason: why there is no model.
            config: options of the MPC whose place is taken; `fallback`, `actuation` and `step_s` count.
            layout: what acts where.
            step_s: control step where `config` has none, s.
            name: name in reports.

        Raises:
            ControllerConfigError: the actuation does not fit the step, or is of an actuator that there is not.
        """
        self.reason, self.config = reason, config
        step_s = config.step_s or step_s
        # As far as the on/off rule looks.
        n_steps = max(1, math.ceil(config.fallback.look_ahead_h * HOUR_S / step_s))
        check_names("actuations", config.actuations, "actuator", layout.names.actuators)
        actuations = [Actuation(config.actuation_of(actuator)) for actuator in layout.names.actuators]
        super().__init__(name, step_s, n_steps, layout, actuations, config.fallback)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of native control, or of the on/off rule (`fallback.stand_back`).

        Raises:
            DataError: the boundary forecast does not fit `horizon_s` and `step_s`, or `state` is another controller's.
        """
        _, states = self._resume(observation, state, NoModelState)
        demands, actors = zip(*(fallback.standing_back(observation) for fallback in self._fallbacks), strict=True)
        realised = self._actuators.realise(demands, self._step_s, states)
        acting = "; ".join(self._layout.names.of_actuator(a, actor) for a, actor in enumerate(actors))
        if len(set(actors)) == 1:
            acting = actors[0]
        acting = "; ".join([acting, *self._actuators.excluded_in_words(realised)])
        why = f"gate: no model could be identified ({self.reason}): {acting}"
        after = NoModelState(realised.states, observation.time_s)
        return Plan(realised.together(), PlanStatus.GATE, why, names=self._layout.names, state=after)
