"""The forced state as time goes on: what past heat still adds, corrected by what the measurements say.

Predicted by the operator (paper, below eq:arx) from the heat that was given; the rest of the temperature is the free
response, so heat is counted once, whatever the state is: T = F + (T − F). An error of F is an error of that split. The
frozen forecaster said one step ago where the free part would be, and how surely; the operator is about as sure of the
heat's effect as of its gain. A Kalman filter (Kalman 1960) divides the surprise between the two. Without it all of the
surprise goes to the free part, which acts as an output disturbance; either way a constant error of the model leaves no
lasting offset, because the free forecast starts from the last T − F.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from thermoforce_mpc.data import Array, FreeForecast, Record
from thermoforce_mpc.model.forced_history import InitialForce, forced_history, heat_drive
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.scenario.settings import StrictModel

# A forecast is never surer than a sensor, K.
_LEAST_SD_K = 0.01
# Width of the 80 % interval of a normal distribution in standard deviations.
_SD_PER_80_PERCENT = 2.563


class EstimatorConfig(StrictModel):
    """How the forced state is estimated."""

    correct: bool = Field(False, description="divide each surprise between free and forced part (Kalman filter)")
    heat_error: float = Field(
        0.15, gt=0, le=1, description="standard deviation of the effect of a step's heat, as a share of it"
    )


@dataclass(frozen=True)
class ForcedState:
    """What is known of the forced state of one run so far.

    `time_s` (n + 1,) are the boundaries of the history taken in, `forced_K` (n + 1, r) the forced state of each mode
    there, K. `covariance` (r, r) K² is that of the last of them. `expected` is the free response that was forecast for
    one boundary to come: its time s, median °C and standard deviation K.
    """

    time_s: Array
    forced_K: Array
    covariance: Array
    expected: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for array in (self.time_s, self.forced_K, self.covariance):
            array.setflags(write=False)


class ForcedStateEstimator:
    """Follows runs step by step: from the state of a run and its history so far to its state now.

    Only what is new since the state is computed; without a state the whole history is rolled out.

    Args:
        operator: at any step length.
        initial_force: how F starts, see `Predictor`.
        config: whether surprises correct F.
    """

    def __init__(
        self,
        operator: OperatorParameters,
        initial_force: InitialForce = "steady",
        config: EstimatorConfig | None = None,
    ) -> None:
        self._operator, self._initial_force = operator, initial_force
        self.config = config or EstimatorConfig()

    def update(self, state: ForcedState | None, history: Record) -> ForcedState:
        """The state after all of `history`; one that does not continue `state` is rolled out from its beginning.

        Raises:
            DataError: see `forced_history`.
        """
        known = state.time_s.size if state else 0
        if (
            state is None
            or known > history.time_s.size
            or not np.array_equal(history.time_s[:known], state.time_s)
            or (known == 1 and history.n_steps)  # the first day sets the start, and only its first instant was known
        ):
            forced = forced_history(self._operator, history, initial_force=self._initial_force)
            return ForcedState(history.time_s, forced, np.zeros((self._operator.order, self._operator.order)))
        if known == history.time_s.size:
            return state
        operator = self._operator.resampled(history.step_s)
        rows, covariance = [state.forced_K[-1]], state.covariance
        for t in range(known - 1, history.n_steps):
            forced, covariance = self._advanced(operator, history, t, rows[-1], covariance, state.expected)
            rows.append(forced)
        return ForcedState(history.time_s, np.vstack([state.forced_K, *rows[1:]]), covariance, state.expected)

    def expect(self, state: ForcedState, time_s: float, free: FreeForecast) -> ForcedState:
        """`state` with the free response that was forecast for the boundary at `time_s`, the first of `free`."""
        spread = float(free.quantile_C(0.9)[0] - free.quantile_C(0.1)[0])
        return replace(state, expected=(time_s, float(free.median_C[0]), max(spread / _SD_PER_80_PERCENT, _LEAST_SD_K)))

    def _advanced(
        self,
        operator: OperatorParameters,
        history: Record,
        t: int,
        before: Array,
        covariance: Array,
        expected: tuple[float, float, float] | None,
    ) -> tuple[Array, Array]:
        """Forced state (r,) and its covariance (r, r) after step `t` of `history`, from those `before` it."""
        heat = heat_drive(operator, history, t, t + 1)
        T_zone = history.T_zone_C[: t + 1]
        T_zone = T_zone[np.isfinite(T_zone)]
        free_C = (float(T_zone[-1]) if T_zone.size else 0.0) - before.sum()
        features = feature_matrix(
            np.array([free_C]), history.T_out_C[t : t + 1], history.solar_W_m2[t : t + 1], history.time_s[t : t + 1]
        )
        added = operator.gains * operator.modulation(operator.seen(features, before)) * heat
        forced = operator.poles * before + added
        if not self.config.correct:
            return np.asarray(forced), covariance
        # The gain is wrong for all modes alike, so their errors go together.
        error = self.config.heat_error * added
        covariance = np.outer(operator.poles, operator.poles) * covariance + np.outer(error, error)
        T_now = float(history.T_zone_C[t + 1])
        if expected is None or not math.isfinite(T_now) or abs(expected[0] - history.time_s[t + 1]) > 1.0:
            return np.asarray(forced), covariance
        _, free_C, free_sd = expected
        share = covariance.sum(axis=1)
        gain = share / (share.sum() + free_sd**2)
        corrected = forced + gain * (T_now - free_C - forced.sum())
        return np.asarray(corrected), covariance - np.outer(gain, share)
