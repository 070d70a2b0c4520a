"""Columns and rows of the linear weather model, compiled: they are computed anew for every forecast."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array


@njit(cache=True)
def simulated(drives: Array, waves: Array, poles: Array, start: Array) -> Array:
    """Simulated response per unit of every parameter.

    Args:
        drives: inputs at all boundaries (n, d), linear in between.
        waves: given columns (n, w).
        poles: of the modes, per step (q,).
        start: state of all modes for each input at the first boundary (d,).

    Returns:
        (n, d q + w + q): modes of steady gain 1 for each input, the given columns, and the decay of each mode.
    """
    (n, d), w, q = drives.shape, waves.shape[1], poles.size
    out = np.empty((n, d * q + w + q))
    for k in range(d):
        for i in range(q):
            out[0, k * q + i] = start[k]
    for i in range(q):
        out[0, d * q + w + i] = 1.0
    for t in range(n):
        for i in range(w):
            out[t, d * q + i] = waves[t, i]
        if t == 0:
            continue
        for k in range(d):
            mean = 0.5 * (drives[t - 1, k] + drives[t, k])
            for i in range(q):
                out[t, k * q + i] = poles[i] * out[t - 1, k * q + i] + (1.0 - poles[i]) * mean
        for i in range(q):
            out[t, d * q + w + i] = poles[i] * out[t - 1, d * q + w + i]
    return out


@njit(cache=True)
def whitened(columns: Array, targets: Array, decay: float) -> tuple[Array, Array]:
    """Rows (k, p) of `columns` (n or more, p) whose target (n,) is finite, and their targets (k,), as innovations.

    `decay` per step of first-order errors: innovations are scaled to the variance of the errors, so that priors weigh
    the same whatever it is; across a gap the correlation decays over its length. 0: independent errors.
    """
    p, k, before = columns.shape[1], 0, -1
    rows, values = np.empty((targets.size, p)), np.empty(targets.size)
    for t in range(targets.size):
        if not math.isfinite(targets[t]):
            continue
        kept, unit, last = 0.0, 1.0, max(before, 0)
        if before >= 0 and decay > 0.0:
            kept = decay if t == before + 1 else decay ** (t - before)
            unit = 1.0 / math.sqrt(1.0 - kept * kept)
        values[k] = unit * (targets[t] - kept * targets[last]) if before >= 0 else targets[t]
        for i in range(p):
            rows[k, i] = unit * (columns[t, i] - kept * columns[last, i])
        before, k = t, k + 1
    return rows[:k], values[:k]
