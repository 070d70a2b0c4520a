"""Recursions over time, compiled: first-order filters, and the innovations of a sum of first-order processes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from thermoforce_mpc.data import Array


@njit(cache=True)
def first_order(signals: Array, poles: Array, rows: NDArray[np.intp]) -> Array:
    """Filter `signals` (s, n) by first-order lags of steady gain 1 with `poles` (q,), from zero.

    Returns:
        The states before the steps `rows` (m,), increasing, up to n: shape (m, s q), column s q + i for pole i.
    """
    n_signals, n = signals.shape
    q = poles.size
    state = np.zeros(n_signals * q)
    out = np.empty((rows.size, n_signals * q))
    at = 0
    for t in range(n + 1):
        if at < rows.size and rows[at] == t:
            out[at] = state
            at += 1
        if t < n:
            for s in range(n_signals):
                value = signals[s, t]
                for i in range(q):
                    state[s * q + i] = poles[i] * state[s * q + i] + (1.0 - poles[i]) * value
    return out


@njit(cache=True)
def innovation_form(variance: Array, decay: Array, noise: float) -> tuple[Array, Array]:
    """Kalman filter of a sum of independent first-order processes with white noise.

    Args:
        variance: stationary variance of each process (k,).
        decay: of each process from a row to the next (n, k).
        noise: variance of the white noise.

    Returns:
        Gains (n, k) and standard deviations (n,) of the innovations.
    """
    n, k = decay.shape
    gain, sd = np.empty((n, k)), np.empty(n)
    P = np.diag(variance)
    for t in range(n):
        shared = P.sum(axis=1)
        total = shared.sum() + noise
        sd[t] = np.sqrt(total)
        gain[t] = shared / total
        for i in range(k):
            for j in range(k):
                left = P[i, j] - shared[i] * shared[j] / total
                P[i, j] = decay[t, i] * decay[t, j] * left
            P[i, i] += variance[i] * (1.0 - decay[t, i] ** 2)
    return gain, sd


@njit(cache=True)
def innovations(values: Array, gain: Array, decay: Array, sd: Array) -> Array:
    """Innovations (n, p) of `values` (n, p) in standard deviations, by gains and decays (n, k) and `sd` (n,)."""
    n, p = values.shape
    k = gain.shape[1]
    state, seen, out = np.zeros((k, p)), np.empty(p), np.empty((n, p))
    for t in range(n):
        seen[:] = values[t]
        for i in range(k):
            for c in range(p):
                seen[c] -= state[i, c]
        for c in range(p):
            out[t, c] = seen[c] / sd[t]
        for i in range(k):
            a, b = decay[t, i], decay[t, i] * gain[t, i]
            for c in range(p):
                state[i, c] = a * state[i, c] + b * seen[c]
    return out


@njit(cache=True)
def covariance(variance: Array, decay: Array, noise: float) -> Array:
    """Covariance (n, n) of the sum of processes and noise of `innovation_form`."""
    n, k = decay.shape
    out = np.empty((n, n))
    for first in range(n):
        shared = variance.copy()
        out[first, first] = shared.sum() + noise
        for t in range(first + 1, n):
            total = 0.0
            for i in range(k):
                shared[i] *= decay[t - 1, i]
                total += shared[i]
            out[first, t] = out[t, first] = total
    return out
