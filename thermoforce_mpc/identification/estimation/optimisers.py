"""Optimisers of the estimators: BFGS with bounds (Nocedal and Wright 2006, chapter 6), and least squares with some
variables bounded below by zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dtrtrs
from scipy.optimize import nnls

from thermoforce_mpc.data import Array

_MAX_STEPS, _MAX_HALVINGS, _MAX_SWEEPS = 50, 30, 1000
# Step of a variable that is not taken any more: convergence is superlinear, so that this is about the error left.
_SETTLED = 1e-7
# Share of the decrease along the gradient that a step must reach, and relative rounding error of the function.
_ARMIJO, _ROUNDING = 1e-4, 1e-12


@dataclass(frozen=True)
class Point:
    """Value and gradient (n,) of the function at `at` (n,)."""

    at: Array
    value: float
    gradient: Array


_P = TypeVar("_P", bound=Point)


def minimised(evaluate: Callable[[Array], _P], start: _P, hessian: Array, low: Array, high: Array) -> _P:
    """Return the point of a local minimum with `low` ≤ x ≤ `high` (n,).

    Unlike scipy's methods with bounds it takes an estimate of the second derivatives: with a good one an evaluation is
    rarely taken twice for a step.

    Args:
        evaluate: the function.
        start: a point inside the bounds.
        hessian: positive definite estimate of the second derivatives there (n, n).
        low, high: bounds (n,).
    """
    point, B = start, hessian
    for _ in range(_MAX_STEPS):
        step = _bounded_step(B, point.gradient, low - point.at, high - point.at)
        lower = _lower(evaluate, point, step)
        if lower is None:
            break
        moved, turned = lower.at - point.at, lower.gradient - point.gradient
        if (bend := moved @ turned) > 0.0:
            pull = B @ moved
            B = B + np.outer(turned, turned / bend) - np.outer(pull, pull / (moved @ pull))
        point = lower
    return point


def _lower(evaluate: Callable[[Array], _P], point: _P, step: Array) -> _P | None:
    """The point after the first of `step`, a half of it, … that lowers the function; None if the minimum is `point`."""
    for _ in range(_MAX_HALVINGS):
        if np.abs(step).max() <= _SETTLED:
            return None
        candidate = evaluate(point.at + step)
        if candidate.value <= point.value + _ARMIJO * (point.gradient @ step) + _ROUNDING * abs(point.value):
            return candidate
        step = 0.5 * step
    return None


@njit(cache=True)
def _bounded_step(B: Array, gradient: Array, low: Array, high: Array) -> Array:
    """The step (r,) of least gradient · step + ½ step · B step with `low` ≤ step ≤ `high`, by Gauss-Seidel sweeps."""
    step = np.zeros(gradient.size)
    for _ in range(_MAX_SWEEPS):
        largest = 0.0
        for i in range(step.size):
            coordinate = step[i] - (gradient[i] + B[i] @ step) / B[i, i]
            coordinate = min(max(coordinate, low[i]), high[i])
            largest = max(largest, abs(coordinate - step[i]))
            step[i] = coordinate
        if largest <= _ROUNDING:
            break
    return step


def triangle(matrix: Array) -> Array:
    """R of a QR factorisation of `matrix` (n, m): (min(n, m), m), of the same sums of squares |matrix x|²."""
    return _triangle(np.array(matrix, order="F"))


def _triangle(matrix: Array) -> Array:
    """That of a `matrix` in Fortran's order, which is overwritten."""
    R = dgeqrf(matrix, overwrite_a=1)[0][: matrix.shape[1]]
    return np.asarray(R * _upper(*R.shape))


@cache
def _upper(n: int, m: int) -> NDArray[np.bool_]:
    """The places of an upper triangle; numpy.triu makes them anew each time."""
    return np.triu(np.ones((n, m), dtype=bool))


class FreeFirst:
    """Order of variables (p,) in which those without a bound come first; `positive` (p,): which are not negative."""

    def __init__(self, positive: NDArray[np.bool_]) -> None:
        self.order = np.concatenate([np.flatnonzero(~positive), np.flatnonzero(positive)])
        self.n_free = int(positive.size - np.count_nonzero(positive))
        self.columns = np.append(self.order, positive.size)


class BoundedLeastSquares:
    """Least |A (x, −1)|² over x (p,), of which some, at least one, are not negative.

    Variables without a bound come first in a QR factorisation, so that the bounded ones alone are those of the trailing
    triangle, which is solved by active sets (Lawson and Hanson 1974, chapter 23).

    Args:
        system: A (n, p + 1), the target in its last column; the others have full rank, n > p.
        variables: their order.
    """

    def __init__(self, system: Array, variables: FreeFirst) -> None:
        self._variables, free = variables, variables.n_free
        self._R = _triangle(system.T[variables.columns].T)
        self._bounded, misfit = nnls(self._R[free:-1, free:-1], self._R[free:-1, -1])
        self.squares = float(self._R[-1, -1] ** 2 + misfit**2)
        """Least sum of squares."""

    @property
    def values(self) -> Array:
        """The minimiser (p,)."""
        free, order, R = self._variables.n_free, self._variables.order, self._R
        values = np.empty(order.size)
        values[order[free:]] = self._bounded
        if free:
            values[order[:free]] = dtrtrs(R[:free, :free], R[:free, -1] - R[:free, free:-1] @ self._bounded)[0]
        return values

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the design's normal equations."""
        return 2.0 * float(np.log(np.abs(np.diagonal(self._R)[:-1])).sum())
