"""Physical parameters of the modes: time constants in h, initial slope in K/h, steady gains in K.

Besides the time constants, the forced response of order r has r parameters: the initial slope of the step response and
the steady gains of all modes but the fastest. All are nonnegative (times the sign), as the operator requires.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.series.lag import lagged


def poles(log_tau: Array, step_s: float) -> Array:
    """Return the poles exp(−step/τ), shape (r,)."""
    return np.asarray(np.exp(-step_s / HOUR_S / np.exp(log_tau)))


def unit_responses(log_tau: Array, step_s: float, drive: Array, rows: NDArray[np.intp] | None = None) -> Array:
    """Return the forced response to `drive` (n,) per unit of [slope, G_2 … G_r], shape (n + 1, r), K.

    Row t is the state before step t, starting from zero; only `rows` where they are given.
    """
    lags = np.stack([lagged(drive, pole) for pole in poles(log_tau, step_s)], axis=1)
    own, lead = lags_of_gains(log_tau)
    responses = own * lags + lead * lags[:, :1]
    return np.asarray(responses if rows is None else responses[rows])


def unit_steps(log_tau: Array, hours: Array) -> Array:
    """Return the response to a step to 1 per unit of [slope, G_2 … G_r] at `hours` (T,) after it, shape (T, r), K."""
    rising = -np.expm1(-hours[:, None] / np.exp(log_tau))
    own, lead = lags_of_gains(log_tau)
    return np.asarray(own * rising + lead * rising[:, :1])


def lags_of_gains(log_tau: Array) -> tuple[Array, Array]:
    """What a unit of each of [slope, G_2 … G_r] is of lags of gain 1: of its own mode and of the first, (r,) each."""
    tau = np.exp(log_tau)
    own, lead = np.ones(tau.size), -tau[0] / tau
    own[0], lead[0] = tau[0], 0.0
    return own, lead


def in_steps(log_tau: Array, gains: Array, step_s: float) -> tuple[Array, Array]:
    """Poles (r,) and gains of a step (r,), K, of [slope, G_2 … G_r] (r,)."""
    tau, a = np.exp(log_tau), poles(log_tau, step_s)
    steady = np.concatenate([[tau[0] * (gains[0] - (gains[1:] / tau[1:]).sum())], gains[1:]])
    return a, steady * (1.0 - a)
