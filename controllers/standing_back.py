"""Controller of a run for which no model could be identified: native control or the on/off rule, never a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from controllers.acting import Acting
from controllers.actuation import Actuation, ActuationState
from controllers.mpc_config import MPCConfig
from thermoforce_mpc.data import HOUR_S, Observation, Plan, PlanStatus


@dataclass(frozen=True)
class StandingBackState:
    """State of the machine between two steps."""

    actuation: ActuationState = field(default_factory=ActuationState)


class StandingBack(Acting):
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
        self.reason, self.config = reason, config
        step_s = config.step_s or step_s
        # As far as the on/off rule looks.
        n_steps = max(1, math.ceil(config.fallback.look_ahead_h * HOUR_S / step_s))
        super().__init__(name, step_s, n_steps, Actuation(config.actuation), config.fallback, mode)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of native control, or of the on/off rule (`fallback.stand_back`).

        Raises:
            DataError: the boundary forecast does not fit `horizon_s` and `step_s`, or `state` is another controller's.
        """
        _, actuation = self._begun(observation, state, StandingBackState)
        blocks, actuation, who = self._standing_back(observation, actuation)
        why = f"gate: no model could be identified ({self.reason}): {who}"
        return Plan(blocks, PlanStatus.GATE, why, state=StandingBackState(actuation))
