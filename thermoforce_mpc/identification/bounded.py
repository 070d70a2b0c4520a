"""Least squares with some variables bounded below by zero."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dtrtrs
from scipy.optimize import nnls

from thermoforce_mpc.data import Array


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
