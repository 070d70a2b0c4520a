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


class ForcedStateEstimator:
    """Follows one run. Every call is given the history so far; only what is new since the last call is computed.

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
        self._time_s = np.empty(0)
        self._forced = np.empty((0, operator.order))
        self._covariance = np.zeros((operator.order, operator.order))
        self._expected: tuple[float, float, float] | None = None

    def update(self, history: Record) -> Array:
        """Forced state of each mode at each boundary of `history`, shape (n + 1, r), K.

        Raises:
            DataError: see `forced_history`.
        """
        known = self._time_s.size
        continues = 0 < known <= history.time_s.size and np.array_equal(history.time_s[:known], self._time_s)
        if not continues or (known == 1 and history.n_steps):
            self._forced = forced_history(self._operator, history, initial_force=self._initial_force)
            self._covariance[:] = 0.0
            self._expected = None
        else:
            operator = self._operator.resampled(history.step_s) if history.n_steps else self._operator
            for t in range(known - 1, history.n_steps):
                self._forced = np.vstack([self._forced, self._advanced(operator, history, t)])
        self._time_s = history.time_s
        return np.array(self._forced)

    def expect(self, time_s: float, free: FreeForecast) -> None:
        """Remember the free response that was forecast for the boundary at `time_s`, the first of `free`."""
        spread = float(free.quantile_C(0.9)[0] - free.quantile_C(0.1)[0])
        self._expected = (time_s, float(free.median_C[0]), max(spread / _SD_PER_80_PERCENT, _LEAST_SD_K))

    def _advanced(self, operator: OperatorParameters, history: Record, t: int) -> Array:
        """Forced state after step `t` of `history`, shape (r,)."""
        heat = heat_drive(operator, history, t, t + 1)
        before = self._forced[-1]
        T_zone = history.T_zone_C[: t + 1]
        T_zone = T_zone[np.isfinite(T_zone)]
        free_C = (float(T_zone[-1]) if T_zone.size else 0.0) - before.sum()
        features = feature_matrix(
            np.array([free_C]), history.T_out_C[t : t + 1], history.solar_W_m2[t : t + 1], history.time_s[t : t + 1]
        )
        added = operator.gains * operator.modulation(operator.seen(features, before)) * heat
        forced = operator.poles * before + added
        if not self.config.correct:
            return np.asarray(forced)
        # The gain is wrong for all modes alike, so their errors go together.
        error = self.config.heat_error * added
        self._covariance = np.outer(operator.poles, operator.poles) * self._covariance + np.outer(error, error)
        return self._corrected(forced, history, t + 1)

    def _corrected(self, forced: Array, history: Record, boundary: int) -> Array:
        T_zone, expected = float(history.T_zone_C[boundary]), self._expected
        if expected is None or not math.isfinite(T_zone) or abs(expected[0] - history.time_s[boundary]) > 1.0:
            return forced
        _, free_C, free_sd = expected
        share = self._covariance.sum(axis=1)
        gain = share / (share.sum() + free_sd**2)
        self._covariance = self._covariance - np.outer(gain, share)
        return np.asarray(forced + gain * (T_zone - free_C - forced.sum()))
