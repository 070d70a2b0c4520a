"""Sparse quadratic programmes: their numbers, and how far a point may be from the optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array

if TYPE_CHECKING:
    from scipy import sparse

# Bounds from here on are as good as none beside the numbers of a plan, which are of the size of 1 to 1000: left in,
# they would rule what a solver scales by.
FAR = 1e6
# How far from where it is a variable without a near bound may be in a better plan, as a multiple of its size: one of a
# user's term that runs away is no plan. By judgement, on the problems that are hard of `tests/controllers/optimisation`
# (2026-11-28).
_REACH = 10.0


@dataclass(frozen=True)
class QPData:
    """One quadratic programme: min ½ x'Qx + c'x s.t. A x = b, low ≤ G x ≤ high, x_low ≤ x ≤ x_high.

    The objective in currency is `unit` times this one plus `constant`. Matrices hold all elements of their structure,
    zeros too, and Q its diagonal, so the programmes of one structure have one pattern.
    """

    quadratic: sparse.csc_matrix
    linear: Array
    A: sparse.csc_matrix
    b: Array
    G: sparse.csc_matrix
    low: Array
    high: Array
    x_low: Array
    x_high: Array
    unit: float
    constant: float

    def objective(self, x: Array, *, with_quadratic: bool = True) -> float:
        """Objective at `x` including the constant, currency; NaN where `x` is of another size."""
        if x.size != self.linear.size:
            return float("nan")
        bend = 0.5 * x @ (self.quadratic @ x) if with_quadratic else 0.0
        return self.constant + self.unit * float(bend + self.linear @ x)

    def violation(self, x: Array) -> float:
        """By how much `x` leaves a row or a bound, at most; infinite where it is of another size or not finite."""
        if x.size != self.linear.size or not np.isfinite(x).all():
            return float("inf")
        rows = self.G @ x
        left = (np.abs(self.A @ x - self.b), self.low - rows, rows - self.high, self.x_low - x, x - self.x_high)
        return float(max(off.max(initial=0.0) for off in left))

    def fixed(self, columns: NDArray[np.intp], values: Array) -> QPData:
        """The same with variables `columns` at `values`."""
        low, high = self.x_low.copy(), self.x_high.copy()
        low[columns] = high[columns] = values
        return replace(self, x_low=low, x_high=high)

    @property
    def convex(self) -> bool:
        """Whether Q has no negative eigenvalue, to rounding."""
        rows, values, n = self.quadratic.indices, self.quadratic.data, self.linear.size
        on = rows == _columns(self.quadratic)
        diagonal = np.bincount(rows[on], values[on], minlength=n)
        others = np.bincount(rows, np.abs(values), minlength=n) - np.abs(diagonal)
        slack = 1e-9 * float(np.abs(diagonal).max(initial=0.0))
        if (diagonal >= others - slack).all():
            return True
        if (diagonal < -slack).any():
            return False
        some = np.flatnonzero((diagonal != 0.0) | (others > 0.0))
        return bool(np.linalg.eigvalsh(self.quadratic[some][:, some].toarray())[0] >= -1e3 * slack)

    def near(self, weights: Array) -> QPData:
        """The same with ½ weights·x² (n,) more, in the same pattern."""
        quadratic = self.quadratic.copy()
        columns = _columns(quadratic)
        diagonal = np.flatnonzero(quadratic.indices == columns)
        quadratic.data[diagonal] += weights[columns[diagonal]]
        return replace(self, quadratic=quadratic)

    def reduced_costs(self, x: Array, multipliers: Array) -> Array:
        """Slopes of the Lagrangian at `x`, which bounds hold up at an optimum, (n,); `multipliers` of A, then of G."""
        y, z = np.split(multipliers, [self.b.size])
        slopes: Array = self.quadratic @ x + self.linear + self.A.T @ y + self.G.T @ z
        return slopes

    def above_least(self, x: Array, multipliers: Array) -> float:
        """What `x`, which keeps the constraints, costs at most above the optimum, currency; convex programmes.

        By weak duality from `multipliers` of the equations, then of the rows of G, of either solver's sign: those of
        f + y'(A x − b) + z'G x. It holds for any numbers, so no solver is believed; bad ones only make it large. A
        variable without a near bound on a side is compared up to `_REACH` times its size.
        """
        y, z = np.split(multipliers, [self.b.size])
        z = np.where(z > 0.0, np.where(np.isfinite(self.high), z, 0.0), np.where(np.isfinite(self.low), z, 0.0))
        reduced = self.reduced_costs(x, np.concatenate([y, z]))
        reach = _REACH * self._size(x)
        low = np.where(self.x_low > -FAR, self.x_low, x - reach)
        high = np.where(self.x_high < FAR, self.x_high, x + reach)
        with np.errstate(invalid="ignore"):
            rows = np.where(z > 0.0, z * self.high, np.where(z < 0.0, z * self.low, 0.0))
        # Term by term, so that large numbers that are equal do not cancel: reduced costs times the way to the bound,
        # multipliers times what is left of their row, and what equations lack.
        columns = np.where(reduced > 0.0, reduced * (x - low), reduced * (x - high))
        left = rows - z * (self.G @ x)
        lacks = y * (self.b - self.A @ x)
        return self.unit * float(columns.sum() + left.sum() + lacks.sum())

    def _size(self, x: Array) -> Array:
        """What variables may be like: themselves, 1, and what bounded ones in their rows make of them, (n,)."""
        near = np.maximum(-self.x_low, self.x_high)
        size = np.where(near < FAR, near, 1.0 + np.abs(x))
        n = self.A.shape[0]
        # Without a matrix of both, which would take longer than all else here.
        row = np.concatenate([self.A.indices, n + self.G.indices])
        column = np.concatenate([_columns(self.A), _columns(self.G)])
        slope = np.abs(np.concatenate([self.A.data, self.G.data]))
        holds = slope != 0.0
        row, column, slope = row[holds], column[holds], slope[holds]
        largest = np.zeros(n + self.G.shape[0])
        np.maximum.at(largest, row, slope * size[column])
        np.maximum.at(size, column, np.where(near[column] < FAR, 0.0, largest[row] / slope))
        return size


def _columns(matrix: sparse.csc_matrix) -> NDArray[np.intp]:
    """The column of each element."""
    return np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
