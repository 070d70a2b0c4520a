"""Likelihood of one run by a Kalman filter, and its derivatives by the adjoint recursion, compiled.

The likelihood is that of the one-step prediction errors (Schweppe 1965): x' = A x + B u + w, y = x[0] + e. The adjoint
runs the filter backwards once and gives the derivatives by all matrices at about twice the cost of the value.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array


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


@njit(cache=True)
def likelihood(
    A: Array, B: Array, Q: Array, R: float, x0: Array, P0: Array, inputs: Array, readings: Array
) -> tuple[float, Slopes]:
    """Half the negative log likelihood of a run, up to a constant, and its derivatives.

    Args:
        A, B: of one step (n, n), (n, m).
        Q: variances of the process noise in a step (n,).
        R: variance of a reading, K².
        x0, P0: mean and variances at the first reading (n,).
        inputs: of each step (N, m); that of the last reading is not used.
        readings: of state 0 (N,), K; NaN is a gap.
    """
    N, n = readings.size, A.shape[0]
    states, covariances = np.zeros((N, n)), np.zeros((N, n, n))
    columns, variances, errors = np.zeros((N, n)), np.ones(N), np.zeros(N)
    x, P, total = x0.copy(), np.diag(P0), 0.0
    for k in range(N):
        if not np.isnan(readings[k]):
            S, error, column = P[0, 0] + R, readings[k] - x[0], P[:, 0].copy()
            columns[k], variances[k], errors[k] = column, S, error
            total += 0.5 * (np.log(S) + error * error / S)
            x = x + column * (error / S)
            P = P - np.outer(column, column / S)
        states[k], covariances[k] = x, P
        if k < N - 1:
            x = A @ x + B @ inputs[k]
            P = A @ P @ A.T
            for i in range(n):
                P[i, i] += Q[i]
    by_A, by_B, by_Q, by_R = np.zeros(A.shape), np.zeros(B.shape), np.zeros(n), 0.0
    by_readings = np.zeros(N)
    by_x, by_P, transposed = np.zeros(n), np.zeros((n, n)), np.ascontiguousarray(A.T)
    for k in range(N - 1, -1, -1):
        if k < N - 1:
            turned = by_P @ A
            by_A += np.outer(by_x, states[k]) + 2.0 * (turned @ covariances[k])
            by_B += np.outer(by_x, inputs[k])
            by_Q += np.diag(by_P)
            by_x = transposed @ by_x
            by_P = transposed @ turned
        if not np.isnan(readings[k]):
            column, S, error = columns[k], variances[k], errors[k]
            along, pulled = by_x @ column, by_P @ column
            by_column = by_x * (error / S) - 2.0 * pulled / S
            by_S = (column @ pulled - along * error) / S**2 + 0.5 * (1.0 / S - error * error / S**2)
            by_readings[k] = (along + error) / S
            by_x[0] -= by_readings[k]
            by_P[0] += 0.5 * by_column
            by_P[:, 0] += 0.5 * by_column
            by_P[0, 0] += by_S
            by_R += by_S
    return total, Slopes(by_A, by_B, by_Q, by_R, np.diag(by_P).copy(), by_readings)
