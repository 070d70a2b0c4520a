"""First-order recursions over time, compiled: all at once, since one alone waits for its own last value."""

from __future__ import annotations

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array


@njit(cache=True)
def first_order(inputs: Array, input_of: Array, poles: Array, gains: Array, start: Array) -> Array:
    """States x of m recursions, x ← pole · x + gain · input.

    Args:
        inputs: inputs of each step (k, n).
        input_of: number of the input of each recursion (m,), integers.
        poles, gains: per step (m,).
        start: states before the first step (m,).

    Returns:
        States before the first step and after each of n steps (m, n + 1).
    """
    m, n = poles.size, inputs.shape[1]
    out = np.empty((m, n + 1))
    state = start.copy()
    for i in range(m):
        out[i, 0] = state[i]
    for t in range(n):
        for i in range(m):
            state[i] = poles[i] * state[i] + gains[i] * inputs[input_of[i], t]
            out[i, t + 1] = state[i]
    return out
