"""The limit of any free response: the true future with the machine off, from a branch of the plant's state.

It knows the plant, its people, the weather to come and what was done so far, which no forecaster may. So it is no
method of the product, where a controller knows observations alone and the same ones give the same plan: benches hand
it to the controller as a forecaster of the user's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Levels, Measurement, Record
from thermoforce_mpc.data.superposition import control_free
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.model.free_response.checks import LEVELS
from thermoforce_mpc.model.free_response.linear_weather import Persistence
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.predictor import Predictor, PredictorState


@runtime_checkable
class BranchingPlant(Protocol):
    """Plant whose state can be kept and put back: the embedded one and the drawn houses."""

    def snapshot(self) -> Any:
        """State, clock and record now."""
        ...

    def restore(self, snapshot: Any) -> None:
        """Put a snapshot back."""
        ...

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """See `Plant.advance`."""
        ...


class Oracle:
    """`FreeResponse` of a zone that is known: its future with every machine off, less what is left of past control."""

    name = "oracle"

    def __init__(self, plant: BranchingPlant, operator: BuildingOperator, zone: int = 0) -> None:
        self._plant, self._zone = plant, zone
        self._predictor = Predictor(operator, Persistence())

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; what `history` has of control is needed as well, and the plant has to be there.

        Raises:
            InputError: the plant stands at another time than the history ends.
        """
        return self.follow(free_C, history, boundary, None)[0]

    def follow(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> tuple[FreeForecast, PredictorState]:
        """See `FollowingFreeResponse.follow`; follows the forced state as the controller does. Raises as `forecast`."""
        off_C = self._without_control(boundary)
        followed = self._predictor.followed(history, cast(PredictorState | None, state))
        operator = self._predictor.operator.resampled(boundary.step_s)
        nothing = np.zeros((len(operator.actuators), boundary.n_steps))
        left_K = operator.driven(followed.forced_K[:, :, -1], nothing).sum(axis=(-3, -1))
        known_C = control_free(off_C, left_K[self._zone])
        return FreeForecast(LEVELS, np.tile(known_C, (len(LEVELS), 1)), "known"), PredictorState(followed)

    def _without_control(self, boundary: Boundary) -> Array:
        """Temperature of the zone at the end of each step with all machines off, °C, shape (N,)."""
        here = self._plant.snapshot()
        off = (0.0,) * len(self._predictor.operator.actuators)
        try:
            course = [self._plant.advance(off, boundary.step_s) for _ in range(boundary.n_steps)]
        finally:
            self._plant.restore(here)
        if course[0].time_s != boundary.time_s[1]:
            raise InputError(
                f"oracle: the plant stands at {course[0].time_s - boundary.step_s:g} s, the forecast begins at "
                f"{boundary.time_s[0]:g} s: hand it the plant that is controlled"
            )
        return np.array([float(now.T_zone_C[self._zone]) for now in course])


def oracles(plant: object, operator: BuildingOperator) -> Sequence[Oracle]:
    """The oracle of each zone (Z,) of `plant`.

    Raises:
        InputError: the plant cannot be branched.
    """
    if not isinstance(plant, BranchingPlant):
        raise InputError(
            f"oracle: {type(plant).__name__} keeps its state to itself: the true future is known of the embedded plant "
            "and of drawn houses alone"
        )
    return [Oracle(plant, operator, zone) for zone in range(len(operator.zones))]
