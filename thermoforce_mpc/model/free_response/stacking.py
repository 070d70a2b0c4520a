"""Combination weights of several forecasts by lead time, learned from past trials.

Stacked regression (Wolpert 1992, Breiman 1996): weights are nonnegative and sum to one. Trials of one week are few and
correlated, so the weights are regularised towards prior weights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from thermoforce_mpc.data import Array

_SUM_WEIGHT = 1e3


def stacking_weights(
    errors_K: Array, prior: Array, strength: float, group_of: NDArray[np.intp], trust: Array | None = None
) -> Array:
    """Return the weights of k forecasts at N lead times.

    Args:
        errors_K: forecast − truth in T trials, shape (T, k, N), NaN if the truth is unknown.
        prior: prior weights, shape (k,), nonnegative, sum one.
        strength: strength of the prior: a distance of one from it costs `strength` times the mean squared error of the
            best forecast.
        group_of: group number of each lead time, shape (N,); a group shares its weights.
        trust: weight of each trial, shape (T,), positive; default: equal.

    Returns:
        Weights, shape (k, N), each column nonnegative with sum one.
    """
    k = prior.size
    weights = np.repeat(prior[:, None], group_of.size, axis=1)
    if trust is not None:
        errors_K = errors_K * np.sqrt(trust / trust.mean())[:, None, None]
    for group in np.unique(group_of):
        lead = group_of == group
        errors = errors_K[:, :, lead].transpose(0, 2, 1).reshape(-1, k)
        errors = errors[np.isfinite(errors).all(axis=1)]
        if errors.shape[0] < k:
            continue
        covariance = errors.T @ errors / errors.shape[0]
        size = float(np.trace(covariance)) / k
        if size <= 0.0:  # all errors are zero: keep the prior
            continue
        pull = np.sqrt(strength * float(np.diag(covariance).min()))
        root = np.linalg.cholesky(covariance + 1e-9 * size * np.eye(k)).T
        sum_one = _SUM_WEIGHT * np.sqrt(size)
        A = np.vstack([root, pull * np.eye(k), np.full((1, k), sum_one)])
        b = np.concatenate([np.zeros(k), pull * prior, [sum_one]])
        solution, _ = nnls(A, b)
        weights[:, lead] = (solution / solution.sum())[:, None]
    return weights
