"""How well a forced response explains an regression, with its free part and disturbances integrated out.

Given the time constants, what is not forced is Gaussian: prior of the free gains and starting state, plus
disturbances. So the residual r = target − F has a known mean and covariance C. The whitened residual L⁻¹(r − mean) is
what training minimises, and its later rows, each given all before it, are what choices are judged by: they weigh what
an action does within hours, which a plain error over a day drowns in the weather's surprises. That plain error, the
part of r that the past does not predict, is the error of a rollout over the horizon; it is scored for people to read.
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
    start_sd,
)


@dataclass(frozen=True)
class Residuals:
    """Linear maps on the residual target − F of one regression.

    `mean` (rows,) K is what the free part contributes before any data; `covariance` (rows, rows) K².
    """

    mean: Array
    covariance: Array

    def whitener(self) -> Array:
        """L⁻¹, shape (rows, rows): row i gives what is new in it after all rows before, in standard deviations."""
        variance = np.diagonal(self.covariance)
        if np.count_nonzero(self.covariance) == np.count_nonzero(variance):  # rows of a pair are independent
            return np.diag(1.0 / np.sqrt(variance))
        factor = cholesky(self.covariance, lower=True)
        return np.asarray(solve_triangular(factor, np.eye(factor.shape[0]), lower=True))

    def innovation(self, past: NDArray[np.intp], ahead: NDArray[np.intp]) -> Array:
        """Map from the residual over `past` and `ahead` to what the past does not predict of `ahead`."""
        if past.size == 0:
            return np.eye(ahead.size)
        shared = self.covariance[np.ix_(past, ahead)]
        if not shared.any():  # the past says nothing
            return np.concatenate([np.zeros((ahead.size, past.size)), np.eye(ahead.size)], axis=1)
        factor = cholesky(self.covariance[np.ix_(past, past)], lower=True)
        weights = cho_solve((factor, True), shared).T
        return np.concatenate([-weights, np.eye(ahead.size)], axis=1)


def whitened(regression: RegressionData, values: Array) -> Array:
    """`values` (rows, ...) of an regression in standard deviations of its disturbances, what came before taken out."""
    if regression.is_pair:  # independent rows: no matrix is solved, however many days there are
        sd = np.diagonal(regression.factor)
        return np.asarray(values / (sd if values.ndim == 1 else sd[:, None]))
    return np.asarray(solve_triangular(regression.factor, values, lower=True))


def residuals(regression: RegressionData, log_tau: Array) -> Residuals:
    """Mean and covariance of what is not forced in `regression`, for these time constants."""
    if regression.is_pair:
        return Residuals(np.zeros(regression.rows.size), np.diag(np.diagonal(regression.factor) ** 2))
    noise = regression.factor @ regression.factor.T
    shared, start = free_columns(regression, log_tau, free_time_constants(log_tau))
    mean, sd, _ = free_prior(free_time_constants(log_tau).size)
    columns = np.concatenate([shared * sd, start * start_sd(start.shape[1])], axis=1)
    return Residuals(mean=shared @ mean, covariance=noise + columns @ columns.T)


@dataclass(frozen=True)
class Split:
    """Rows to train on and to be judged by, and the rollouts (past rows, rows ahead) that are scored."""

    train: NDArray[np.intp]
    judged: NDArray[np.intp]
    rollouts: tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...] = ()


def split_run(regression: RegressionData, share: float, horizon_h: float) -> Split:
    """Train on the first part of a run, judge by the rest; rollouts of up to `horizon_h` start where the last ended."""
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
    """Judge a whole pair, train on nothing of it."""
    rows = np.arange(regression.rows.size)
    return Split(train=rows[:0], judged=rows, rollouts=((rows[:0], rows),))


def whole(regression: RegressionData) -> Split:
    """Train on everything."""
    rows = np.arange(regression.rows.size)
    return Split(train=rows, judged=rows[:0])
