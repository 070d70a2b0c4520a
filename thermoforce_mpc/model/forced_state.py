"""Estimator of the forced state F during a run, optionally corrected by the measured temperature.

The operator predicts F from the delivered heat (paper, below eq:arx); the rest of the temperature is the free response,
T = F + (T − F), so heat is counted once for any F. With correction, a Kalman filter (Kalman 1960) divides the one-step
prediction residual between the free part, with the quantiles of its last forecast, and F, with the uncertainty of the
gain. Without correction the whole residual goes to the free part, an output disturbance. In both cases a constant model
error leaves no lasting offset, because the free forecast starts from the last T − F.
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

# Lower limit of the forecast's standard deviation, K: that of a sensor.
_LEAST_SD_K = 0.01
# Width of the 80 % interval of a normal distribution in standard deviations.
_SD_PER_80_PERCENT = 2.563


class EstimatorConfig(StrictModel):
    """Options of the forced-state estimator."""

    correct: bool = Field(False, description="divide each residual between free and forced part (Kalman filter)")
    heat_error: float = Field(
        0.15, gt=0, le=1, description="relative standard deviation of the effect of a step's heat"
    )


@dataclass(frozen=True)
class ForcedState:
    """Estimated forced state of a run so far.

    `time_s` (n + 1,): boundaries of the processed history. `forced_K` (n + 1, r): forced state of each mode there.
    `covariance` (r, r) K²: that of the last one. `expected`: free response forecast for a later boundary, as time s,
    median °C and standard deviation K.
    """

    time_s: Array
    forced_K: Array
    covariance: Array
    expected: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for array in (self.time_s, self.forced_K, self.covariance):
            array.setflags(write=False)


class ForcedStateEstimator:
    """Recursive estimator of the forced state.

    Only steps since the given state are computed; without a state the whole history is rolled out.

    Args:
        operator: operator at any step length.
        initial_force: initial value of F, see `Predictor`.
        config: whether residuals correct F.
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
        """Return the state after all of `history`; a history that does not continue `state` is rolled out anew.

        Raises:
            DataError: see `forced_history`.
        """
        known = state.time_s.size if state else 0
        if (
            state is None
            or known > history.time_s.size
            or not np.array_equal(history.time_s[:known], state.time_s)
            or (known == 1 and history.n_steps)  # F starts from the first day, not yet known
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
        """Return `state` with the free response forecast for the boundary at `time_s`, the first of `free`."""
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
        """Return forced state (r,) and covariance (r, r) after step `t` of `history`, from those before it."""
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
        # The gain error is common to all modes, so their errors are fully correlated.
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
