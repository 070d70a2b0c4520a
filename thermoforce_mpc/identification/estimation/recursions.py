"""Recursions over time, compiled: first-order filters, and the innovations of a sum of first-order processes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from thermoforce_mpc.data import Array


@njit(cache=True)
def filtered(
    signals: Array,
    signal_of: NDArray[np.intp],
    poles: Array,
    start: Array,
    own: Array,
    lead_of: NDArray[np.intp],
    lead: Array,
    rows: NDArray[np.intp],
) -> Array:
    """Sums of first-order lags of steady gain 1 of `signals` (n, s).

    Args:
        signals: input of each step.
        signal_of, poles, start: signal, pole per step and state before the first step of each lag, (c,).
        own, lead_of, lead: sum c is `own[c]` times lag c plus `lead[c]` times lag `lead_of[c]`, (c,).
        rows: steps, increasing, up to n (m,).

    Returns:
        The sums before the steps `rows`, (m, c).
    """
    n = signals.shape[0]
    state = start.copy()
    out = np.empty((rows.size, state.size))
    at = 0
    for t in range(n + 1):
        if at < rows.size and rows[at] == t:
            for c in range(state.size):
                out[at, c] = own[c] * state[c] + lead[c] * state[lead_of[c]]
            at += 1
        if t < n:
            for c in range(state.size):
                state[c] = poles[c] * state[c] + (1.0 - poles[c]) * signals[t, signal_of[c]]
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
    gain, sd, shared, P = np.empty((n, k)), np.empty(n), np.empty(k), np.zeros((k, k))
    for i in range(k):
        P[i, i] = variance[i]
    for t in range(n):
        total = noise
        for i in range(k):
            shared[i] = 0.0
            for j in range(k):
                shared[i] += P[i, j]
            total += shared[i]
        sd[t] = np.sqrt(total)
        for i in range(k):
            gain[t, i] = shared[i] / total
            for j in range(k):
                P[i, j] = decay[t, i] * decay[t, j] * (P[i, j] - shared[i] * shared[j] / total)
            P[i, i] += variance[i] * (1.0 - decay[t, i] ** 2)
    return gain, sd


@njit(cache=True)
def innovations(values: Array, gain: Array, decay: Array, sd: Array) -> Array:
    """Innovations (n, p) of `values` (n, p) in standard deviations, by gains and decays (n, k) and `sd` (n,)."""
    n, p = values.shape
    k = gain.shape[1]
    state, innovation, out = np.zeros((k, p)), np.empty(p), np.empty((n, p))
    for t in range(n):
        innovation[:] = values[t]
        for i in range(k):
            for c in range(p):
                innovation[c] -= state[i, c]
        for c in range(p):
            out[t, c] = innovation[c] / sd[t]
        for i in range(k):
            a, b = decay[t, i], decay[t, i] * gain[t, i]
            for c in range(p):
                state[i, c] = a * state[i, c] + b * innovation[c]
    return out


@njit(cache=True)
def innovation_effects(gain: Array, decay: Array, sd: Array) -> Array:
    """Lower triangle (n, n): effect on row i of an innovation of one standard deviation at row j."""
    n, k = gain.shape
    out = np.zeros((n, n))
    for first in range(n):
        out[first, first] = sd[first]
        state = gain[first] * sd[first]
        for t in range(first + 1, n):
            total = 0.0
            for i in range(k):
                state[i] *= decay[t - 1, i]
                total += state[i]
            out[t, first] = total
    return out


@njit(cache=True)
def covariance(variance: Array, decay: Array, noise: float) -> Array:
    """Covariance (n, n) of the sum of processes and noise of `innovation_form`."""
    n, k = decay.shape
    out = np.empty((n, n))
    for first in range(n):
        shared = variance.copy()
        out[first, first] = noise
        for i in range(k):
            out[first, first] += variance[i]
        for t in range(first + 1, n):
            total = 0.0
            for i in range(k):
                shared[i] *= decay[t - 1, i]
                total += shared[i]
            out[first, t] = out[t, first] = total
    return out


@njit(cache=True)
def responses(drives: Array, poles: Array) -> tuple[Array, Array]:
    """Modes y(t + 1) = a y(t) + d(t) from zero under each of `drives` (m, n), and their derivatives by `poles` (r,).

    Shape (m, n + 1, r) each.
    """
    (m, n), r = drives.shape, poles.size
    y, slope = np.zeros((m, n + 1, r)), np.zeros((m, n + 1, r))
    for k in range(m):
        for t in range(n):
            for i in range(r):
                y[k, t + 1, i] = poles[i] * y[k, t, i] + drives[k, t]
                slope[k, t + 1, i] = poles[i] * slope[k, t, i] + y[k, t, i]
    return y, slope


@njit(cache=True)
def adjoint(by_response: Array, poles: Array, gains: Array) -> Array:
    """Derivatives (m, n) by the drives of what has derivatives `by_response` (m, n + 1) by Σ gains y of `responses`."""
    m, n, r = by_response.shape[0], by_response.shape[1] - 1, poles.size
    out = np.empty((m, n))
    for k in range(m):
        state = np.zeros(r)
        for t in range(n, 0, -1):
            total = 0.0
            for i in range(r):
                state[i] = poles[i] * state[i] + gains[i] * by_response[k, t]
                total += state[i]
            out[k, t - 1] = total
    return out
