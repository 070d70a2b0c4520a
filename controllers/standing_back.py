"""Controller of a run for which no model could be identified: native control or the on/off rule, never a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from controllers.actuation import Actuation, ActuationState
from controllers.fallback import FallbackPolicy
from controllers.inputs import check_observation, checked_state
from controllers.mpc_config import MPCConfig
from thermoforce_mpc.data import HOUR_S, Observation, Plan, PlanStatus


@dataclass(frozen=True)
class StandingBackState:
    """State of the machine between two steps."""

    actuation: ActuationState = field(default_factory=ActuationState)


class StandingBack:
    """Takes the place of an MPC that has no model; its plans have the status `gate`."""

    def __init__(self, reason: str, config: MPCConfig, mode: str, step_s: float, *, name: str) -> None:
        """Set up the rule.

        Args:
            reason: why there is no model.
            config: options of the MPC whose place is taken; `fallback`, `actuation` and `step_s` count.
            mode: 'heating' or 'cooling'.
            step_s: control step where `config` has none, s.
            name: name in reports.

        Raises:
            ControllerConfigError: the actuation does not fit the step.
        """
        self.reason, self.config, self._name = reason, config, name
        self._step_s = config.step_s or step_s
        self._actuation = Actuation(config.actuation)
        self._actuation.check_step(self._step_s)
        self._fallback = FallbackPolicy(config.fallback, self._step_s, self._actuation.highest, mode)

    @property
    def name(self) -> str:
        """Name in reports."""
        return self._name

    @property
    def step_s(self) -> float:
        """Control step, s."""
        return self._step_s

    @property
    def horizon_s(self) -> float:
        """As far as the on/off rule looks, s."""
        return max(1, math.ceil(self.config.fallback.look_ahead_h * HOUR_S / self._step_s)) * self._step_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of native control, or of the on/off rule (`fallback.stand_back`).

        Raises:
            DataError: the boundary forecast does not fit `horizon_s` and `step_s`, or `state` is another controller's.
        """
        before = checked_state(state, StandingBackState)
        check_observation(observation, self._step_s, round(self.horizon_s / self._step_s))
        actuation = self._actuation.now(before.actuation if before else None, observation.history)
        u, who = self._fallback.standing_back(observation)
        blocks, actuation = self._actuation.realise(u, self._step_s, actuation)
        why = f"gate: no model could be identified ({self.reason}): {who}"
        return Plan(blocks, PlanStatus.GATE, why, state=StandingBackState(actuation))
