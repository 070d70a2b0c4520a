"""Rollout of the forced state over a horizon, for any number of candidate trajectories at once."""

from __future__ import annotations

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.features import N_FEATURES
from thermoforce_mpc.model.operator.parameters import OperatorParameters


def forced_rollout(params: OperatorParameters, F0: Array, u: Array, features: Array) -> Array:
    """Return the forced state of every mode at the end of each of N steps (paper eq:operator).

    Args:
        params: the operator; its step is the step of `u`.
        F0: forced state now, shape (..., r), K.
        u: planned control, acting over each step, shape (..., N), in [0, 1].
        features: x_t at the start of each step, shape (..., N, 4), physical units; the zone's column is always T − F.

    Returns:
        Shape (..., N, r), K; the sum over the last axis is the forced response F.

    Raises:
        DataError: shapes do not fit together, or a value is not finite.
    """
    u = np.asarray(u, dtype=np.float64)
    F0 = np.asarray(F0, dtype=np.float64)
    features = np.asarray(features, dtype=np.float64)
    if u.ndim < 1 or features.shape[-2:] != (u.shape[-1], N_FEATURES):
        raise DataError(f"forced rollout: u {u.shape} and features {features.shape} do not describe the same steps")
    if F0.shape[-1:] != (params.order,):
        raise DataError(f"forced rollout: F0 has shape {F0.shape}, expected (..., {params.order})")
    if not (np.isfinite(u).all() and np.isfinite(F0).all() and np.isfinite(features).all()):
        raise DataError("forced rollout: u, F0 and features must be finite")
    if params.feedback_active:
        return _stepwise(params, F0, u, features)
    return driven_rollout(params, F0, params.drive(u, features))


def driven_rollout(params: OperatorParameters, F0: Array, drive: Array) -> Array:
    """Return the forced state of every mode for a known m(x)·v: `F0` (..., r) K, `drive` (..., N) → (..., N, r) K."""
    lead, n = np.broadcast_shapes(drive.shape[:-1], F0.shape[:-1]), drive.shape[-1]
    drives = np.ascontiguousarray(np.broadcast_to(drive, (*lead, n))).reshape(-1, n)
    states = np.ascontiguousarray(np.broadcast_to(F0, (*lead, params.order))).reshape(-1, params.order)
    return np.asarray(_modes(params.poles, params.gains, states, drives).reshape(*lead, n, params.order))


@njit(cache=True)
def _modes(poles: Array, gains: Array, F0: Array, drives: Array) -> Array:
    """Forced states (c, n, r) of c candidates: F ← a F + g d from `F0` (c, r), under the drives (c, n)."""
    (c, n), r = drives.shape, poles.size
    out = np.empty((c, n, r))
    for k in range(c):
        for i in range(r):
            state = F0[k, i]
            for t in range(n):
                state = poles[i] * state + gains[i] * drives[k, t]
                out[k, t, i] = state
    return out


def _stepwise(params: OperatorParameters, F0: Array, u: Array, features: Array) -> Array:
    """Roll out step by step, all candidates at once, for m(x) that depends on F."""
    lead = np.broadcast_shapes(u.shape[:-1], features.shape[:-2], F0.shape[:-1])
    n = u.shape[-1]
    forced = np.empty((*lead, n, params.order))
    state = np.broadcast_to(F0, (*lead, params.order))
    for t in range(n):
        state = params.step(state, u[..., t], features[..., t, :])
        forced[..., t, :] = state
    return forced
