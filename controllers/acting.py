"""What an MPC and the controller in its place share: step, horizon, actuation, and standing back."""

from __future__ import annotations

from typing import Protocol, TypeVar

from controllers.actuation import Actuation, ActuationState
from controllers.fallback import FallbackConfig, FallbackPolicy
from controllers.inputs import check_observation, checked_state
from thermoforce_mpc.data import Block, Observation


class _ActingState(Protocol):
    @property
    def actuation(self) -> ActuationState: ...


State = TypeVar("State", bound=_ActingState)


class Acting:
    """A controller that acts by an `Actuation`, and can leave the step to native control or to the on/off rule."""

    def __init__(
        self, name: str, step_s: float, n_steps: int, actuation: Actuation, fallback: FallbackConfig, mode: str
    ) -> None:
        """Set up what acts.

        Args:
            name: name in reports.
            step_s: control step, s.
            n_steps: steps of boundary forecast that are needed.
            actuation: conversion of levels into blocks.
            fallback: options of the fallback policy.
            mode: 'heating', 'cooling' or 'both'.

        Raises:
            ControllerConfigError: the actuation does not fit the step.
        """
        actuation.check_step(step_s)
        self._name, self._step_s, self._n_steps, self._actuation = name, step_s, n_steps, actuation
        self._fallback = FallbackPolicy(fallback, step_s, actuation.highest, mode)

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

    def _begun(self, observation: Observation, state: object, kind: type[State]) -> tuple[State | None, ActuationState]:
        """The state after the last step (None: a run begins) and the machine's now; raises `DataError` as `plan`."""
        before = checked_state(state, kind)
        check_observation(observation, self._step_s, self._n_steps)
        return before, self._actuation.now(before.actuation if before else None, observation.history)

    def _ahead(self, observation: Observation) -> Observation:
        """The observation with the boundary forecast of the horizon only."""
        return Observation(observation.history, observation.boundary.head(self._n_steps))

    def _standing_back(
        self, observation: Observation, actuation: ActuationState
    ) -> tuple[tuple[Block, ...], ActuationState, str]:
        """Blocks of a step of native control or of the on/off rule, the state after them, and who acts."""
        u, who = self._fallback.standing_back(observation)
        return *self._actuation.realise(u, self._step_s, actuation), who
