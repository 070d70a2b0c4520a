"""Likelihood of one run by a Kalman filter, and its derivatives by the adjoint recursion, compiled.

The likelihood is that of the one-step prediction errors (Schweppe 1965): x' = A x + B u + w, y = x[0] + e. The adjoint
runs the filter backwards once and gives the derivatives by all matrices at about twice the cost of the value. Where a
sensor is late, y is another state than the first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.compiled import njit


class Slopes(NamedTuple):
    """Derivatives of half the negative log likelihood.

    By `A` (n, n), `B` (n, m), the diagonal of the process noise `Q` (n,), the variance `R` of a reading, the diagonal
    of the covariance at the start `P0` (n,), and the `readings` (N,).
    """

    A: Array
    B: Array
    Q: Array
    R: float
    P0: Array
    readings: Array


class FilteredRun(NamedTuple):
    """A run and the system by which it is read; not for compiled code, which crashes over a signal while it makes one.

    `A`, `B` of one step (n, n), (n, m); `Q`: variances of the process noise in a step (n,), `R`: of a reading, K²;
    `x0`, `P0`: mean and variances at the first reading (n,); `inputs` of each step (N, m), of which that of the last
    reading is not used; `readings` of state `seen` (N,), K, NaN in gaps; `aired_K2`: variance of the first state
    besides, in the step from each reading on (N,), K²; None: nowhere.
    """

    A: Array
    B: Array
    Q: Array
    R: float
    x0: Array
    P0: Array
    inputs: Array
    readings: Array
    aired_K2: Array | None = None
    seen: int = 0

    @property
    def of_each_step(self) -> FilteredRun:
        """The same with the variance of air in every step."""
        return self._replace(aired_K2=np.zeros(self.readings.size)) if self.aired_K2 is None else self


def likelihood(run: FilteredRun) -> tuple[float, Slopes]:
    """Half the negative log likelihood of a run, up to a constant, and its derivatives."""
    n, m = run.B.shape
    by_A, by_B, by_Q, by_P0, by_readings = (np.zeros(shape) for shape in ((n, n), (n, m), n, n, run.readings.size))
    total, by_R = _likelihood(*run.of_each_step, by_A, by_B, by_Q, by_P0, by_readings)
    return total, Slopes(by_A, by_B, by_Q, by_R, by_P0, by_readings)


def prediction_errors(run: FilteredRun) -> tuple[Array, Array]:
    """Errors of the readings one step ahead (N,), K, and their variances (N,), K²; NaN in gaps."""
    N, filled = run.readings.size, _filled_up(len(run.A))
    variances, errors = np.full(N, np.nan), np.full(N, np.nan)
    unused = np.zeros((N, filled)), np.zeros((N, filled, filled)), np.zeros((N, filled))
    _filtered(*run.of_each_step, *unused, variances, errors)
    return errors, variances


# Loops over numbers: NumPy's operations take many times as long to compile, and on arrays this small longer to run.
# States are filled up with zeros to eight, or more fours: processors do sums along rows of as many four or eight at a
# time, each in its order, and a likelihood takes half as long. The two halves of a covariance are rounded differently:
# its transpose is kept, by which all products are of that form.


@njit(cache=True)
def _filled_up(n: int) -> int:
    """How many states a product has in the place of `n`."""
    return max(8, (n + 3) // 4 * 4)


@njit(cache=True)
def _times(left, right, out):  # type: ignore[no-untyped-def]
    """The first rows of a product of matrices, each as wide as `_filled_up` says: as many rows as `out` has."""
    for i in range(out.shape[0]):
        a, b, c, d = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
        e, f, g, h = left[i, 4], left[i, 5], left[i, 6], left[i, 7]
        for j in range(out.shape[1]):
            by_four = a * right[0, j] + b * right[1, j] + c * right[2, j] + d * right[3, j]
            out[i, j] = by_four + e * right[4, j] + f * right[5, j] + g * right[6, j] + h * right[7, j]
        for k in range(8, right.shape[0], 4):
            a, b, c, d = left[i, k], left[i, k + 1], left[i, k + 2], left[i, k + 3]
            for j in range(out.shape[1]):
                out[i, j] = (
                    out[i, j] + a * right[k, j] + b * right[k + 1, j] + c * right[k + 2, j] + d * right[k + 3, j]
                )


@njit(cache=True)
def _likelihood(  # type: ignore[no-untyped-def]
    A, B, Q, R, x0, P0, inputs, readings, aired, seen, by_A, by_B, by_Q, by_P0, by_readings
) -> tuple[float, float]:
    """The likelihood and its derivative by the variance of a reading; writes the others, of `Slopes`."""
    N, filled = readings.size, _filled_up(A.shape[0])
    means, covariances = np.zeros((N, filled)), np.zeros((N, filled, filled))
    columns, variances, errors = np.zeros((N, filled)), np.ones(N), np.zeros(N)
    total = _filtered(A, B, Q, R, x0, P0, inputs, readings, aired, seen, means, covariances, columns, variances, errors)
    by_R = _adjoint(
        A, inputs, readings, seen, means, covariances, columns, variances, errors, by_A, by_B, by_Q, by_P0, by_readings
    )
    return total, by_R


@njit(cache=True)
def _filtered(A, B, Q, R, x0, P0, inputs, readings, aired, seen, means, covariances, columns, variances, errors):  # type: ignore[no-untyped-def]
    """The likelihood; writes mean and transposed covariance after each reading, before it column `seen`, variance and
    error.
    """
    N, n, total = readings.size, A.shape[0], 0.0
    filled = _filled_up(n)
    x, P, following, half = np.zeros(n), np.zeros((filled, filled)), np.zeros(n), np.zeros((filled, filled))
    step, turned = np.zeros((n, filled)), np.zeros((filled, filled))
    for i in range(n):
        x[i], P[i, i] = x0[i], P0[i]
        for j in range(n):
            step[i, j] = turned[j, i] = A[i, j]
    for k in range(N):
        if not np.isnan(readings[k]):
            S, error = P[seen, seen] + R, readings[k] - x[seen]
            variances[k], errors[k] = S, error
            total += 0.5 * (np.log(S) + error * error / S)
            for i in range(filled):
                columns[k, i] = P[seen, i]
            for i in range(n):
                x[i] += columns[k, i] * error / S
                for j in range(filled):
                    P[i, j] -= columns[k, i] * columns[k, j] / S
        for i in range(n):
            means[k, i] = x[i]
            for j in range(filled):
                covariances[k, i, j] = P[i, j]
        if k == N - 1:
            break
        for i in range(n):
            following[i] = _dot(A[i], x) + _dot(B[i], inputs[k])
        _times(P.T, turned, half)
        _times(step, half, P[:n])
        for i in range(n):
            x[i] = following[i]
            P[i, i] += Q[i]
        P[0, 0] += aired[k]
    return total


@njit(cache=True)
def _adjoint(  # type: ignore[no-untyped-def]
    A, inputs, readings, seen, means, covariances, columns, variances, errors, by_A, by_B, by_Q, by_P0, by_readings
):
    """The derivative by the variance of a reading; writes the others, of `Slopes`."""
    N, n, by_R = readings.size, A.shape[0], 0.0
    filled = _filled_up(n)
    by_x, by_P, following, turned = np.zeros(n), np.zeros((filled, filled)), np.zeros(n), np.zeros((filled, filled))
    step, by_step, by_both = np.zeros((filled, filled)), np.zeros((n, filled)), np.zeros((n, filled))
    for i in range(n):
        for j in range(n):
            step[i, j] = A[i, j]
    for k in range(N - 1, -1, -1):
        if k < N - 1:
            for i in range(n):
                by_Q[i] += by_P[i, i]
                following[i] = _dot(A[:, i], by_x)
                for j in range(inputs.shape[1]):
                    by_B[i, j] += by_x[i] * inputs[k, j]
            _times(by_P, step, turned[:n])
            _times(turned, covariances[k], by_both)
            for i in range(n):
                for j in range(filled):
                    by_step[i, j] += by_x[i] * means[k, j] + 2.0 * by_both[i, j]
            _times(step.T, turned, by_P[:n])
            for i in range(n):
                by_x[i] = following[i]
        if not np.isnan(readings[k]):
            column, S, error = columns[k, :n], variances[k], errors[k]
            along, twice = _dot(by_x, column), 0.0
            for i in range(n):
                following[i] = _dot(by_P[i, :n], column)
                twice += column[i] * following[i]
            by_S = (twice - along * error) / S**2 + 0.5 * (1.0 / S - error * error / S**2)
            for i in range(n):
                by_column = (by_x[i] * error - 2.0 * following[i]) / S
                by_P[seen, i] += 0.5 * by_column
                by_P[i, seen] += 0.5 * by_column
            by_readings[k] = (along + error) / S
            by_x[seen] -= by_readings[k]
            by_P[seen, seen] += by_S
            by_R += by_S
    for i in range(n):
        by_P0[i] = by_P[i, i]
        for j in range(n):
            by_A[i, j] = by_step[i, j]
    return by_R


@njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total
