"""Likelihood of a forced response, marginalised over the free part and disturbances.

Given the time constants, the rest of the target is Gaussian: prior of free gains, initial state and gains of the other
actuators, plus disturbances.
So the residual r = target − F has a known mean and covariance C = L Lᵀ. Training minimises the whitened residual
L⁻¹(r − mean). Model choices use its later rows, each conditioned on all rows before: these weigh effects of an action
within hours, which in a plain error over a day are masked by weather errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.columns import (
    free_columns,
    free_prior,
    other_columns,
    other_prior,
    start_sd,
)
from thermoforce_mpc.identification.estimation.disturbance import Disturbance
from thermoforce_mpc.identification.estimation.regression import RegressionData


@dataclass(frozen=True)
class Residuals:
    """Distribution of the residual target − F of one regression.

    `mean` (rows,) K: prior mean of what is marginalised; `columns` (rows, p) K: its effect per prior standard
    deviation; `disturbance` of the rows.
    """

    mean: Array
    columns: Array
    disturbance: Disturbance

    @property
    def covariance(self) -> Array:
        """C (rows, rows), K²."""
        return np.asarray(self.disturbance.covariance + self.columns @ self.columns.T)

    @cached_property
    def whitener(self) -> Array:
        """Return L⁻¹ (rows, rows): row i gives its innovation given all rows before, in standard deviations."""
        factor = cholesky(self.covariance, lower=True, check_finite=False)
        return np.asarray(solve_triangular(factor, np.eye(self.mean.size), lower=True, check_finite=False))

    def later(self, residual: Array, first: int) -> tuple[Array, Array]:
        """Innovations w (m,) of the rows from `first` on, given all rows before, and L (m, m) of these rows.

        Whitened by the disturbance, L_N, the rows are a regression on columns W with priors and noise of 1. With P the
        covariance that the earlier rows leave of its coefficients, the later ones have 1 + W P Wᵀ = M Mᵀ; L is L_N M.
        """
        values = self.disturbance.whitened(np.concatenate([self.columns, residual[:, None]], axis=1))
        p = self.columns.shape[1]
        W, later_residual = values[first:, :p], values[first:, p]
        R = np.asarray(np.linalg.qr(np.concatenate([values[:first], np.eye(p, p + 1)]), mode="r"))
        unknown = solve_triangular(R[:p, :p], W.T, trans="T", check_finite=False)
        M = cholesky(np.eye(later_residual.size) + unknown.T @ unknown, lower=True, check_finite=False)
        white = solve_triangular(M, later_residual - unknown.T @ R[:p, p], lower=True, check_finite=False)
        return np.asarray(white), self.disturbance.factor[first:, first:] @ M

    def scaled(self, scale: float) -> Residuals:
        """With `scale` times the disturbance."""
        return replace(self, disturbance=self.disturbance.scaled(scale))

    def log_likelihoods(self, residual: Array, rows: int, scales: Sequence[float]) -> Array:
        """Log likelihood of the first `rows` of `residual` by scale of the disturbance, up to a constant.

        Whitened by the disturbance, the covariance is s² + W Wᵀ with the columns W, so that one singular value
        decomposition gives all scales s.
        """
        values = np.concatenate([self.columns, residual[:, None]], axis=1)
        R = np.asarray(np.linalg.qr(self.disturbance.whitened(values)[:rows], mode="r"))
        U, singular_values, _ = np.linalg.svd(R[:, :-1], full_matrices=False)
        projected = U.T @ R[:, -1]
        rest = float(np.sum((R[:, -1] - U @ projected) ** 2))
        s2 = np.square(scales)
        total = s2[:, None] + singular_values**2
        squares = rest / s2 + (projected**2 / total).sum(axis=1)
        return np.asarray(-0.5 * (squares + (rows - singular_values.size) * np.log(s2) + np.log(total).sum(axis=1)))


def residuals(regression: RegressionData, log_tau: Array) -> Residuals:
    """Return the distribution of target − F in `regression` for these time constants."""
    of_others = other_columns(regression, log_tau)
    other_mean, other_sd = other_prior(regression)
    expected, coupled = of_others @ other_mean, of_others * other_sd
    if regression.is_pair:
        return Residuals(expected, coupled, regression.disturbance)
    shared, start = free_columns(regression, log_tau)
    mean, sd, _ = free_prior(regression)
    columns = np.concatenate([coupled, shared * sd, start * start_sd(start.shape[1])], axis=1)
    return Residuals(expected + shared @ mean, columns, regression.disturbance)
