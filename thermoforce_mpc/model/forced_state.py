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
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.features import feature_matrix
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

    `time_s` (n + 1,): boundaries of the processed history. `forced_K` (Z, A, n + 1, r): forced state of each pair.
    `covariance` (Z, A r, A r) K²: that of the last one, zone by zone. `expected`: free response forecast for a later
    boundary, as time s, medians °C (Z,) and standard deviations K (Z,).
    """

    time_s: Array
    forced_K: Array
    covariance: Array
    expected: tuple[float, Array, Array] | None = None

    def __post_init__(self) -> None:
        for array in (self.time_s, self.forced_K, self.covariance):
            array.setflags(write=False)

    def since(self, time_s: float) -> ForcedState:
        """Without what was before `time_s`, s; itself where nothing was, or nothing would be left."""
        first = int(np.searchsorted(self.time_s, time_s - 0.5))
        if first == 0 or first >= self.time_s.size:
            return self
        return replace(self, time_s=self.time_s[first:], forced_K=self.forced_K[:, :, first:])


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
        operator: BuildingOperator,
        initial_force: InitialForce = "steady",
        config: EstimatorConfig | None = None,
    ) -> None:
        self._operator, self._initial_force = operator, initial_force
        self.config = config or EstimatorConfig()

    def update(self, state: ForcedState | None, history: Record) -> ForcedState:
        """Return the state after all of `history`; a history that does not continue `state` is rolled out anew.

        A history that begins later than `state` did continues it.

        Raises:
            DataError: see `forced_history`.
        """
        state = state.since(float(history.time_s[0])) if state else None
        n_known = state.time_s.size if state else 0
        if (
            state is None
            or n_known > history.time_s.size
            or not np.array_equal(history.time_s[:n_known], state.time_s)
            or (n_known == 1 and history.n_steps)  # F starts from the first day, not yet known
        ):
            forced = forced_history(self._operator, history, initial_force=self._initial_force)
            zones, actuators, order = self._operator.shape
            return ForcedState(history.time_s, forced, np.zeros((zones, actuators * order, actuators * order)))
        if n_known == history.time_s.size:
            return state
        operator = self._operator.resampled(history.step_s)
        rows, covariance = [state.forced_K[:, :, -1]], state.covariance
        for t in range(n_known - 1, history.n_steps):
            forced, covariance = self._advanced(operator, history, t, rows[-1], covariance, state.expected)
            rows.append(forced)
        forced_K = np.concatenate([state.forced_K, np.stack(rows[1:], axis=2)], axis=2)
        return ForcedState(history.time_s, forced_K, covariance, state.expected)

    def expect(self, state: ForcedState, time_s: float, free: FreeForecast) -> ForcedState:
        """Return `state` with the free response forecast for the boundary at `time_s`, the first of `free`."""
        spread = free.quantile_C(0.9)[:, 0] - free.quantile_C(0.1)[:, 0]
        sd_K = np.maximum(spread / _SD_PER_80_PERCENT, _LEAST_SD_K)
        return replace(state, expected=(time_s, free.median_C[:, 0], sd_K))

    def _advanced(
        self,
        operator: BuildingOperator,
        history: Record,
        t: int,
        before: Array,
        covariance: Array,
        expected: tuple[float, Array, Array] | None,
    ) -> tuple[Array, Array]:
        """Return forced state (Z, A, r) and covariance (Z, A r, A r) after step `t`, from those before it."""
        heat = heat_drive(operator, history, t, t + 1)[:, 0]
        T_zone = _last_known_C(history.T_zone_C[:, : t + 1])
        free_C = T_zone - before.sum(axis=(1, 2))
        features = feature_matrix(free_C, history.T_out_C[t], history.solar_W_m2[t], history.time_s[t])
        added = operator.gains * operator.modulated(heat, features, before)[:, None]
        forced = operator.poles * before + added
        if not self.config.correct:
            return np.asarray(forced), covariance
        zones = operator.shape[0]
        poles, forced = operator.poles.reshape(zones, -1), forced.reshape(zones, -1)
        # The gain error is common to all modes of a pair; pairs are independent.
        error = self.config.heat_error * added
        covariance = poles[:, :, None] * poles[:, None, :] * covariance + _by_pairs(error)
        if expected is None or abs(expected[0] - history.time_s[t + 1]) > 1.0:
            return forced.reshape(before.shape), covariance
        _, free_C, free_sd = expected
        out, after = forced.copy(), covariance.copy()
        for z, T_now in enumerate(history.T_zone_C[:, t + 1]):
            if not math.isfinite(T_now):
                continue
            share = covariance[z].sum(axis=1)
            gain = share / (share.sum() + free_sd[z] ** 2)
            out[z] += gain * (T_now - free_C[z] - forced[z].sum())
            after[z] -= np.outer(gain, share)
        return out.reshape(before.shape), after


def _last_known_C(T_zone_C: Array) -> Array:
    """The last finite temperature (Z,) of `T_zone_C` (Z, n); without one the mean of the other zones, or 0."""
    rows = [row[np.isfinite(row)] for row in T_zone_C]
    last = [float(row[-1]) for row in rows if row.size]
    mean = float(np.mean(last)) if last else 0.0
    return np.array([row[-1] if row.size else mean for row in rows])


def _by_pairs(error: Array) -> Array:
    """Covariance (Z, A r, A r) of errors (Z, A, r) that are fully correlated within a pair and independent between."""
    zones, actuators, order = error.shape
    out = np.zeros((zones, actuators, order, actuators, order))
    for a in range(actuators):
        out[:, a, :, a, :] = error[:, a, :, None] * error[:, a, None, :]
    return out.reshape(zones, actuators * order, actuators * order)
