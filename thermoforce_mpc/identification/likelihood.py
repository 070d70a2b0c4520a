"""Likelihood of a forced response, marginalised over the free part and disturbances.

Given the time constants, the rest of the target is Gaussian: prior of free gains, initial state and gains of the other
actuators, plus disturbances.
So the residual r = target − F has a known mean and covariance C = L Lᵀ. Training minimises the whitened residual
L⁻¹(r − mean). Model choices use its later rows, each conditioned on all rows before: these weigh effects of an action
within hours, which in a plain error over a day are masked by weather errors. The rollout error over the horizon, the
part of r that the past does not predict, is only reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.regression_data import (
    RegressionData,
    free_columns,
    free_prior,
    free_time_constants,
    other_columns,
    other_prior,
    start_sd,
)


@dataclass(frozen=True)
class Residuals:
    """Distribution of the residual target − F of one regression.

    `mean` (rows,) K: prior mean of the free part; `covariance` (rows, rows) K².
    """

    mean: Array
    covariance: Array

    def whitener(self) -> Array:
        """Return L⁻¹, shape (rows, rows): row i gives its innovation given all rows before, in standard deviations."""
        variance = np.diagonal(self.covariance)
        if np.count_nonzero(self.covariance) == np.count_nonzero(variance):  # rows of a pair are independent
            return np.diag(1.0 / np.sqrt(variance))
        factor = cholesky(self.covariance, lower=True)
        return np.asarray(solve_triangular(factor, np.eye(factor.shape[0]), lower=True))

    def innovation(self, past: NDArray[np.intp], ahead: NDArray[np.intp]) -> Array:
        """Return the map from the residual over `past` and `ahead` to its innovation over `ahead` given the past."""
        if past.size == 0:
            return np.eye(ahead.size)
        shared = self.covariance[np.ix_(past, ahead)]
        if not shared.any():  # past and ahead are uncorrelated
            return np.concatenate([np.zeros((ahead.size, past.size)), np.eye(ahead.size)], axis=1)
        factor = cholesky(self.covariance[np.ix_(past, past)], lower=True)
        weights = cho_solve((factor, True), shared).T
        return np.concatenate([-weights, np.eye(ahead.size)], axis=1)


def whitened(regression: RegressionData, values: Array) -> Array:
    """Return `values` (rows, ...) of a regression whitened by its disturbances' Cholesky factor."""
    if regression.is_pair:  # independent rows: no matrix solve needed
        sd = np.diagonal(regression.factor)
        return np.asarray(values / (sd if values.ndim == 1 else sd[:, None]))
    return np.asarray(solve_triangular(regression.factor, values, lower=True))


def residuals(regression: RegressionData, log_tau: Array) -> Residuals:
    """Return mean and covariance of target − F in `regression` for these time constants."""
    of_others = other_columns(regression, log_tau)
    other_mean, other_sd = other_prior(regression, log_tau)
    expected, coupled = of_others @ other_mean, of_others * other_sd
    if regression.is_pair:
        noise = np.diag(np.diagonal(regression.factor) ** 2) + coupled @ coupled.T
        return Residuals(expected, noise)
    noise = regression.factor @ regression.factor.T + coupled @ coupled.T
    shared, start = free_columns(regression, log_tau, free_time_constants(log_tau))
    mean, sd, _ = free_prior(free_time_constants(log_tau).size)
    columns = np.concatenate([shared * sd, start * start_sd(start.shape[1])], axis=1)
    return Residuals(mean=expected + shared @ mean, covariance=noise + columns @ columns.T)


@dataclass(frozen=True)
class Split:
    """Training rows, held-out (judged) rows, and the scored rollouts (past rows, rows ahead)."""

    train: NDArray[np.intp]
    judged: NDArray[np.intp]
    rollouts: tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...] = ()


def split_run(regression: RegressionData, share: float, horizon_h: float) -> Split:
    """Split a run: train on the first part, hold out the last `share`; consecutive rollouts of up to `horizon_h`."""
    n = regression.rows.size
    first = max(1, min(n - 1, round(n * (1.0 - share))))
    hours = regression.rows * regression.step_s / HOUR_S
    rollouts = []
    start = first
    while start < n:
        stop = start + int(np.searchsorted(hours[start:] - hours[start - 1], horizon_h + 1e-9, side="right"))
        stop = max(stop, start + 1)
        rollouts.append((np.arange(start), np.arange(start, stop)))
        start = stop
    return Split(train=np.arange(first), judged=np.arange(first, n), rollouts=tuple(rollouts))


def hold_out_pair(regression: RegressionData) -> Split:
    """Return a split that holds out the whole pair."""
    rows = np.arange(regression.rows.size)
    return Split(train=rows[:0], judged=rows, rollouts=((rows[:0], rows),))


def whole(regression: RegressionData) -> Split:
    """Return a split that trains on all rows."""
    rows = np.arange(regression.rows.size)
    return Split(train=rows, judged=rows[:0])
