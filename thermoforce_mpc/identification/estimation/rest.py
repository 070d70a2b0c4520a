"""What is left of the temperature without the effects of actions: its distribution by a linear free model.

The modes of the free part (`RcParameters`) are Gaussian at every instant, so the temperatures of a run are, too. With
their covariance C = L Lᵀ, row i of L⁻¹ is what a reading says beyond those before it, as in a Kalman filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.series import lagged
from thermoforce_mpc.identification.estimation.regression import RegressionData, unit_responses
from thermoforce_mpc.model.free_response.rc import RcParameters

# Pairs cancel all drift; the rest is the model error of a few hundredths of a K. It is correlated over about an hour,
# so the standard deviation per row is ten times as large.
_PAIR_SD_K = 0.3
# Relative standard deviation of the gains and time constants of a fit without pairs, and the least of a gain, K or K/h;
# farthest that a time constant may move, logarithm; both where there is one mode only.
_PRIOR_SD, _LEAST_GAIN_SD, _REACH, _ALONE_SD = 0.5, 1e-3, np.log(10.0), 5.0


@dataclass(frozen=True)
class Rest:
    """Distribution of the target without effects: `mean` (rows,) K and `covariance` (rows, rows) K²."""

    mean: Array
    covariance: Array

    @cached_property
    def factor(self) -> Array:
        """L (rows, rows), K."""
        from scipy.linalg import cholesky

        return np.asarray(cholesky(self.covariance, lower=True, check_finite=False))

    def white(self, left: Array) -> Array:
        """L⁻¹ `left` (n, …), K at the first n rows: what each says beyond those before it, in standard deviations."""
        from scipy.linalg import solve_triangular

        n = len(left)
        return np.asarray(solve_triangular(self.factor[:n, :n], left, lower=True, check_finite=False))


def rest_of(regression: RegressionData, free: RcParameters | None) -> Rest:
    """The rest of a run by the `free` part of its zone, at the step of the run; that of a pair needs none."""
    n = regression.rows.size
    if regression.is_pair or free is None:
        return Rest(np.zeros(n), _PAIR_SD_K**2 * np.eye(n))
    return Rest(_mean(regression.histories[0], free)[regression.rows], _covariance(regression, free))


def fitted_to_pairs(pairs: Sequence[RegressionData], log_tau: Array, gains: Array, sign: int) -> tuple[Array, Array]:
    """ln(τ/h) (r,) and [slope, G_2 … G_r] (r,), none negative, most likely given pairs and a fit without them."""
    from scipy.optimize import minimize, nnls

    target = np.concatenate([e.target / _PAIR_SD_K for e in pairs])
    # One mode stands for several: its time constant depends on what it is fitted to, here the pairs.
    relative_sd, reach = (_PRIOR_SD, _REACH) if log_tau.size > 1 else (_ALONE_SD, _ALONE_SD)
    sd = np.maximum(relative_sd * np.abs(gains), _LEAST_GAIN_SD)

    def gains_at(x: Array) -> tuple[Array, float]:
        units = np.concatenate([unit_responses(x, e.step_s, e.drive, e.rows) for e in pairs])
        # Of the slowest of several modes the fit knows the rate G/τ rather than the gain.
        slower = np.ones(x.size)
        slower[1:][-1:] = np.exp(x - log_tau)[-1]
        columns = np.concatenate([sign * units / _PAIR_SD_K, np.diag(1.0 / (slower * sd))])
        found, distance = nnls(columns, np.concatenate([target, gains / sd]))
        apart = (x - log_tau) / relative_sd
        return np.asarray(found), float(distance**2 + apart @ apart)

    # Neighbours meet half way.
    middle = 0.5 * (log_tau[:-1] + log_tau[1:])
    edges = np.concatenate([[log_tau[0] - reach], middle, [log_tau[-1] + reach]])
    best = minimize(
        lambda x: gains_at(x)[1], log_tau, method="L-BFGS-B", bounds=np.stack([edges[:-1], edges[1:]], axis=1)
    )
    return np.asarray(best.x), gains_at(best.x)[0]


def _mean(history: Record, free: RcParameters) -> Array:
    """Free response (n + 1,), °C, from the steady state in the weather of the first day."""
    drive = free.drive(history.time_s, history.T_out_C, history.solar_W_m2)
    steps = np.arange(history.n_steps + 1)
    fading = free.poles ** steps[:, None] @ free.beginning(drive)
    return np.asarray(fading + sum(lagged(d / (1.0 - a), a) for a, d in zip(free.poles, drive.T, strict=True)))


def _covariance(regression: RegressionData, free: RcParameters) -> Array:
    rows, a = regression.rows, free.poles
    stationary = free.process_K2 / (1.0 - np.outer(a, a))
    fading = a ** rows[:, None]
    # Covariance of each mode with the temperature, both at the earlier of two rows.
    now = fading * (fading @ (free.start_K2 - stationary)) + stationary.sum(axis=0)
    apart, lags = np.abs(rows[:, None] - rows), np.arange(rows[-1] - rows[0] + 1)
    earlier = np.minimum(np.arange(rows.size)[:, None], np.arange(rows.size))
    total = free.sensor_sd_K**2 * np.eye(rows.size)
    for mode, pole in enumerate(a):
        total += (pole**lags)[apart] * now[:, mode][earlier]
    return np.asarray(total)
