"""Runs and pairs as one bounded Gaussian regression for given time constants, in standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.columns import N_FREE, free_prior_of, other_prior, start_sd
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.optimisers import (
    BoundedLeastSquares,
    FreeFirst,
    Point,
    minimised,
    triangle,
)
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.whitened import (
    Blocks,
    blocks_of,
    varying_blocks,
    whitened_columns,
    whitened_slopes,
)


@dataclass(frozen=True)
class Likeliest(Point):
    """Half the negative log posterior at ln(τ/h) `at` (r,), up to a constant, with all else at its best.

    Attributes:
        values: of the columns that depend on the time constants (v,), those of the gains first.
        residual: of all rows (n,).
    """

    values: Array
    residual: Array


class System:
    """Rows of the data, then the prior of each column; used at many time constants and priors.

    Columns (p,): gains [slope, G_2 … G_r] of the own actuator and of the others, shared free part, initial states run
    by run.

    Args:
        regressions: runs and pairs, at least one.
        order: r, number of modes of the operator.
        sign: +1 heating, −1 cooling.
    """

    def __init__(self, regressions: Sequence[RegressionData], order: int, sign: int) -> None:
        self.regressions, self.order, self.sign = regressions, order, sign
        self._blocks = blocks_of(regressions, order, sign)
        self._acting, self.n_data = self._blocks.acting, self._blocks.rows.size
        self._target = np.concatenate([e.disturbance.whitened(e.target) for e in regressions])
        # Priors of these gains are on the rate G/τ.
        self._slowest = np.arange(order - 1, self._acting if order > 1 else 0, order)
        mean, sd = np.empty(0), np.empty(0)
        self._positive = np.ones(self._acting, dtype=bool)
        if n_runs := sum(not regression.is_pair for regression in regressions):
            mean, sd, low = free_prior_of(next(e for e in regressions if not e.is_pair), N_FREE)
            starts = np.tile(start_sd(N_FREE + 1), n_runs)
            mean, sd = np.append(mean, np.zeros(starts.size)), np.append(sd, starts)
            self._positive = np.concatenate([self._positive, np.isfinite(low), np.zeros(starts.size, dtype=bool)])
        self._free = mean / sd, 1.0 / sd
        self.variables = FreeFirst(self._positive)
        """Which columns are not negative."""

    def rows(self, log_tau: Array, priors: ModePriors) -> Array:
        """The rows (n, p + 1) for ln(τ/h) (r,), the target in the last column."""
        n, (target, weights) = self.n_data, self._priors(log_tau, priors)
        rows = np.zeros((weights.size + 1, n + weights.size)).T
        whitened_columns(self._blocks, log_tau, rows)
        rows[n:, :-1] = np.diag(weights)
        rows[:n, -1], rows[n:, -1] = self._target, target
        return rows

    def slopes(self, log_tau: Array, priors: ModePriors, values: Array) -> Array:
        """Derivatives (n, r) of the rows' residuals by ln(τ/h) (r,), at `values` (p,)."""
        slopes = np.zeros((log_tau.size, self.n_data + values.size)).T
        whitened_slopes(self._blocks, log_tau, values, slopes)
        slopes[self.n_data + self._slowest, -1] = -(self._priors(log_tau, priors)[1] * values)[self._slowest]
        return slopes

    def likeliest(self, priors: ModePriors, start: Array) -> Likeliest:
        """The largest posterior, searched from ln(τ/h) `start` (r,), by variable projection.

        The gradient is that at fixed values of the columns (Golub and Pereyra 1973), also where some are at their
        bound. Columns that neither depend on the time constants nor have a bound are projected out once.
        """
        staying, n, acting = self._staying, self.n_data, self._acting
        first, gone = staying.first, staying.gone
        target, weights = self._priors(priors.log_tau, priors)
        whole = staying.columns.copy()
        whole[np.arange(first, whole.shape[0] - 1), n + staying.varying] = weights[staying.varying]
        whole[-1, n : n + acting] = target[:acting]
        slowest = first + self._slowest, n + self._slowest

        def evaluate(log_tau: Array) -> tuple[Likeliest, Array, Array, Array]:
            columns, longer = whole.copy(), np.exp(priors.log_tau[-1] - log_tau[-1])
            whitened_columns(staying.blocks, log_tau, columns.T)
            columns[slowest] *= longer
            varying = columns[first:-1]
            varying -= (varying @ gone) @ gone.T
            values = BoundedLeastSquares(columns.T, staying.variables).values
            residual = values @ columns[:-1] - columns[-1]
            slopes = np.zeros((self.order, residual.size))
            whitened_slopes(staying.blocks, log_tau, values, slopes.T)
            slopes[-1, slowest[1]] = -longer * whole[slowest] * values[slowest[0]]
            away = (log_tau - priors.log_tau) / priors.log_tau_sd
            value, gradient = 0.5 * (residual @ residual + away @ away), slopes @ residual + away / priors.log_tau_sd
            return Likeliest(log_tau, value, gradient, values[first:], residual), slopes, columns, values

        at_start, slopes, columns, values = evaluate(start)
        # Gauss-Newton Hessian: of what the columns that are not at their bound leave of the slopes.
        slopes -= (slopes @ gone) @ gone.T
        left = triangle(np.concatenate([columns[:-1][values != 0.0], slopes]).T)[-self.order :, -self.order :]
        hessian = left.T @ left + np.eye(self.order) / priors.log_tau_sd**2
        low, high = np.log(priors.bounds_h()).T.copy()
        return minimised(lambda log_tau: evaluate(log_tau)[0], at_start, hessian, low, high)

    @cached_property
    def _staying(self) -> _Staying:
        """What no time constant changes."""
        p, n, blocks = self._positive.size, self.n_data, self._blocks
        columns = np.zeros((p + 1, n + p))
        whitened_columns(blocks, np.zeros(self.order), columns.T)
        free = np.arange(self._acting, p)
        columns[free, n + free], columns[-1, n + free] = self._free[1], self._free[0]
        columns[-1, :n] = self._target
        varies = np.zeros(p, dtype=bool)
        varies[blocks.places[:, blocks.mode >= 0]] = True
        gone, _ = np.linalg.qr(columns[:-1][~varies & ~self._positive].T)
        bounded, varying = columns[:-1][~varies & self._positive], np.flatnonzero(varies)
        kept = np.concatenate([bounded, np.zeros((varying.size, n + p)), columns[-1:]])
        kept -= (kept @ gone) @ gone.T
        place = np.zeros(p, dtype=np.intp)
        place[varying] = bounded.shape[0] + np.arange(varying.size)
        positive = np.append(np.ones(bounded.shape[0], dtype=bool), self._positive[varying])
        return _Staying(kept, gone, bounded.shape[0], varying, FreeFirst(positive), varying_blocks(blocks, place))

    def _priors(self, log_tau: Array, priors: ModePriors) -> tuple[Array, Array]:
        """Target and entry of the prior of each column (p,)."""
        own, others = priors.gains_at(log_tau), other_prior(self.regressions[0], log_tau)
        mean, sd = (np.concatenate(both) for both in zip(own, others, strict=True))
        return np.append(mean / sd, self._free[0]), np.append(1.0 / sd, self._free[1])


@dataclass(frozen=True)
class _Staying:
    """Columns that no time constant changes, and places of the others.

    Attributes:
        columns: by rows (c + 1, n): those that stay and are not negative, from `first` on the varying ones, zero, and
            the target, projected.
        gone: orthonormal basis (n, f) of those that stay and have no bound.
        varying: places of the varying ones among all (v,).
        variables: which of `columns` are not negative.
        blocks: of the varying ones.
    """

    columns: Array
    gone: Array
    first: int
    varying: NDArray[np.intp]
    variables: FreeFirst
    blocks: Blocks
