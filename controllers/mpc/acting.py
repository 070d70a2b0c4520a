"""What an MPC and the controller in its place share, and that controller, of a run without a model."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.checks import check_later, check_names, check_observation, checked_state
from controllers.mpc.config import MPCConfig
from controllers.safety.fallback_policy import FallbackConfig, FallbackPolicy
from thermoforce_mpc.data import HOUR_S, Layout, Observation, Plan, PlanStatus


class _ActingState(Protocol):
    @property
    def actuation(self) -> tuple[ActuationState, ...]: ...

    @property
    def last_s(self) -> float | None: ...

    @property
    def rows(self) -> Mapping[str, int]: ...


State = TypeVar("State", bound=_ActingState)


class ActuatedController:
    """A controller that acts through `Actuators`, and can leave one to native control or to the on/off rule."""

    def __init__(
        self,
        name: str,
        step_s: float,
        n_steps: int,
        layout: Layout,
        actuations: Sequence[Actuation],
        fallback: FallbackConfig,
        commanded: Collection[int] = (),
    ) -> None:
        """Set up what acts; raises `ControllerConfigError` where an actuation does not fit the step.

        `n_steps` of boundary forecast are needed. `actuations` (A,): how each actuator is run; `commanded`: numbers of
        those that are set by a command, which are left to their own control without a plan.
        """
        self._actuators = Actuators(layout, actuations)
        self._actuators.check_step(step_s)
        self._name, self._step_s, self._n_steps, self._layout = name, step_s, n_steps, layout
        self._fallbacks = tuple(
            FallbackPolicy(fallback, step_s, actuation.highest, "both" if a in commanded else layout.mode(a), zone)
            for a, (actuation, zone) in enumerate(zip(actuations, layout.home, strict=True))
        )

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
        """Required length of the boundary forecast, s."""
        return self._n_steps * self._step_s

    def _resume(
        self, observation: Observation, state: object, kind: type[State]
    ) -> tuple[State | None, tuple[ActuationState, ...]]:
        """The state after the last step (None: a run begins) and the actuators' now; raises `DataError` as `plan`."""
        before = checked_state(state, kind, self._layout.names)
        check_observation(observation, self._step_s, self._n_steps, self._layout.names)
        if before is None:
            return None, self._actuators.now(None, observation.history)
        check_later(before.last_s, observation.time_s)
        until_s = None if before.last_s is None else before.last_s + self._step_s
        return before, self._actuators.now(before.actuation, observation.history, until_s)


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

        `reason`: why there is no model. Of `config`, that of the MPC whose place is taken, count `fallback`,
        `actuation` and `step_s`; `step_s`: where it has none, s.

        Raises:
            ControllerConfigError: the actuation does not fit the step, or is of an actuator that there is not.
        """
        self.reason, self.config = reason, config
        step_s = config.step_s or step_s
        # As far as the on/off rule looks.
        n_steps = math.ceil(config.fallback.look_ahead_h * HOUR_S / step_s)
        check_names("actuations", config.actuations, "actuator", layout.names.actuators)
        actuations = [Actuation(config.actuation_of(actuator)) for actuator in layout.names.actuators]
        super().__init__(name, step_s, n_steps, layout, actuations, config.fallback)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of native control, or of the on/off rule (`fallback.stand_back`).

        Raises `DataError` where the boundary forecast does not fit `horizon_s` and `step_s`, or `state` is another's.
        """
        _, states = self._resume(observation, state, NoModelState)
        demands, actors = zip(*(fallback.standing_back(observation) for fallback in self._fallbacks), strict=True)
        realised = self._actuators.realise(demands, self._step_s, states)
        acting = "; ".join(self._layout.names.of_actuators(dict(enumerate(actors))))
        if len(set(actors)) == 1:
            acting = actors[0]
        acting = "; ".join([acting, *self._actuators.excluded_in_words(realised)])
        why = f"gate: no model could be identified ({self.reason}): {acting}"
        after = NoModelState(realised.states, observation.time_s)
        return Plan(realised.together(), PlanStatus.GATE, why, names=self._layout.names, state=after)
