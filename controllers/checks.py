"""Checks of a controller's inputs; a violation is an error of the caller and raises `DataError`, in an option
`ControllerConfigError`.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from thermoforce_mpc.data import Array, Names, Observation
from thermoforce_mpc.data.clock import CLOCK_TOLERANCE_S
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.errors import ConfigError, DataError, ThermoForceError


@dataclass(frozen=True, eq=False)
class PackedState:
    """A controller's state in bytes (`packed`: pickled). It may be pickled, as any state.

    `name`: of no other state; the process that packed it still keeps it by this name for a while.
    """

    name: str
    packed: bytes | memoryview

    def unpacked(self) -> object:
        """The state itself."""
        return pickle.loads(self.packed)

    def __reduce__(self) -> tuple[type[PackedState], tuple[str, bytes]]:
        return PackedState, (self.name, bytes(self.packed))


class ControllerConfigError(ConfigError):
    """The options or the model do not fit the controller."""


def message_of(error: Exception) -> str:
    """Message of an error, with the class name if it is not an exception of this package."""
    return str(error) if isinstance(error, ThermoForceError) else f"{type(error).__name__}: {error}"


class _Rows(Protocol):
    @property
    def rows(self) -> Mapping[str, int]: ...


State = TypeVar("State", bound=_Rows)


def checked_state(state: object, kind: type[State], names: Names) -> State | None:
    """`state` if it is None, or of class `kind` and of as many as there are of `names`; raises `DataError` otherwise.

    `rows` of a state says how many zones, actuators or machines it is of.
    """
    if isinstance(state, PackedState):
        state = state.unpacked()
    if state is None:
        return None
    hint = f"expected None (a run begins) or the Plan.state of the last plan of the same controller ({kind.__name__})"
    if not isinstance(state, kind):
        raise DataError(f"state is a {type(state).__name__}, {hint}")
    for what, n in state.rows.items():
        if n != len(getattr(names, what)):
            raise DataError(f"state is of {n} {what}, the controller of {names}: another building? {hint}")
    return state


def check_later(last_s: float | None, now_s: float) -> None:
    """Raise `DataError` where the plan that a state is from, of `last_s`, comes after `now_s`: it holds nothing of now.

    What is kept by its time (readings validated, predictions to come true) would be waited for until then.
    """
    if last_s is not None and last_s > now_s + CLOCK_TOLERANCE_S:
        raise DataError(
            f"state is of a plan at {last_s:.10g} s, later than the observation at {now_s:.10g} s: of another run, of "
            "a record whose seconds count from another new year, or was the clock set back? Begin anew with None"
        )


def check_names(option: str, names: Iterable[str], what: str, existing: Sequence[str]) -> None:
    """Raise `ControllerConfigError` where `option` names one, of `what`, that is not among the `existing`."""
    for unknown in [name for name in names if name not in existing]:
        raise ControllerConfigError(
            f"controller.options.{option}: there is no {what} '{unknown}'; the building has {', '.join(existing)}"
        )


def check_observation(observation: Observation, step_s: float, n_steps: int, names: Names) -> None:
    """Check that an observation of `names` fits a controller with `n_steps` steps of `step_s` seconds ahead.

    Raises:
        DataError: it is of another building, the boundary forecast does not begin now or is too short, or its step or
            that of the history is not `step_s`.
    """
    boundary, history = observation.boundary, observation.history
    for what, of_part in (("history: it", history.names), ("boundary forecast: it", boundary.names)):
        check_same_building(what, of_part, "the controller", names, single_alike=True)
    observation.check_begin()
    _check_steps("history", history.time_s, step_s)
    if boundary.n_steps < n_steps:
        raise DataError(
            f"boundary forecast has {boundary.n_steps} steps, the horizon needs {n_steps} of {step_s:g} s:"
            " give `horizon_s` of the controller, or set the option `horizon_h` to less"
        )
    _check_steps("boundary forecast", boundary.time_s[: n_steps + 1], step_s)


def _check_steps(what: str, time_s: Array, step_s: float) -> None:
    steps = np.diff(time_s)
    wrong = np.flatnonzero(~(np.abs(steps - step_s) <= CLOCK_TOLERANCE_S))
    if wrong.size:
        first = float(steps[wrong[0]])
        raise DataError(
            f"{what}: step {wrong[0]} of {steps.size} is {first:g} s long, expected {step_s:g} s, the controller's"
            f" step: set its option, step_s={first:g}, or give the {what} in steps of {step_s:g} s"
        )
