"""What an MPC and the controller in its place share: step, horizon, actuators, and standing back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypeVar

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.checks import check_later, check_observation, checked_state
from controllers.safety.fallback_policy import FallbackConfig, FallbackPolicy
from thermoforce_mpc.data import Layout, Observation


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
    ) -> None:
        """Set up what acts.

        Args:
            name: name in reports.
            step_s: control step, s.
            n_steps: steps of boundary forecast that are needed.
            layout: what acts where.
            actuations: conversion of levels into blocks, of each actuator (A,).
            fallback: options of the fallback policy.

        Raises:
            ControllerConfigError: an actuation does not fit the step.
        """
        self._actuators = Actuators(layout, actuations)
        self._actuators.check_step(step_s)
        self._name, self._step_s, self._n_steps, self._layout = name, step_s, n_steps, layout
        self._fallbacks = tuple(
            FallbackPolicy(fallback, step_s, actuation.highest, layout.mode(a), zone)
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
