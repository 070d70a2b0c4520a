"""Columns of the regression for given time constants, one per parameter, and the priors of the parameters."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.modes import (
    TIME_CONSTANTS_H,
    lagged,
    poles,
    unit_responses,
)
from thermoforce_mpc.identification.estimation.regression import FREE_PRIOR, RegressionData

# Weak priors of the level of the free response and of each mode's initial state, K.
_LEVEL_SD_K = 50.0
_START_SD_K = (3.0, 20.0, 50.0, 50.0)
# Fixed time constant of soil and neighbouring rooms, h: too slow to identify, but not negligible.
_GROUND_H = 400.0
_DEFAULT_FASTEST_LOG_TAU = np.log(TIME_CONSTANTS_H[:1])
# Order of the operator whose slow modes are those of the free part.
_SHARED = 3
# Of the gains that the network says: to outdoors, K/K, and to 100 W/m², K, and as a share of them.
_WEATHER_SD, _WEATHER_SHARE = np.array([0.05, 0.1]), 0.2
_DEFAULT_FREE_LOG_TAU = np.log([*TIME_CONSTANTS_H[1:], _GROUND_H])
N_FREE = _DEFAULT_FREE_LOG_TAU.size
"""Number of free modes, the ground's last."""


def forced_columns(regression: RegressionData, log_tau: Array, sign: int) -> Array:
    """Return the forced response of each row per unit of [slope, G_2 … G_r], shape (rows, r), K."""
    return np.asarray(sign * unit_responses(log_tau, regression.step_s, regression.drive, regression.rows))


def other_columns(regression: RegressionData, log_tau: Array) -> Array:
    """Return the response of each row to the other actuators, (rows, K r) K per unit of [slope, G_2 … G_r] of each."""
    columns = [unit_responses(log_tau, regression.step_s, drive, regression.rows) for drive in regression.others]
    return np.concatenate(columns, axis=1) if columns else np.empty((regression.rows.size, 0))


def other_prior(regression: RegressionData) -> tuple[Array, Array]:
    """Return prior mean and standard deviation of the columns of `other_columns`, shape (K r,) each."""
    return regression.other_gains[:, 0].ravel(), regression.other_gains[:, 1].ravel()


def free_columns(regression: RegressionData, log_tau: Array) -> tuple[Array, Array]:
    """Return the columns of the shared free gains (rows, 7q + 1) and of the run's initial state (rows, q + 1).

    The last shared one is the level; the initial state has the fastest mode of the operator and the free ones.
    """
    free, rows = free_time_constants(log_tau), regression.rows
    fastest = log_tau[:1] if log_tau.size > 1 else _DEFAULT_FASTEST_LOG_TAU
    fading = poles(np.concatenate([fastest, free]), regression.step_s)
    shared = [lagged(signal, pole)[rows] for signal in regression.weather for pole in fading[1:]]
    return np.stack([*shared, np.ones(rows.size)], axis=1), fading ** rows[:, None]


def free_time_constants(log_tau: Array) -> Array:
    """Return ln τ of the free modes: the slow modes of an operator of order 3 (or of its prior), and the ground."""
    if log_tau.size != _SHARED:
        return _DEFAULT_FREE_LOG_TAU
    return np.concatenate([log_tau[1:], _DEFAULT_FREE_LOG_TAU[-1:]])


def free_prior(regression: RegressionData) -> tuple[Array, Array, Array]:
    """Return prior mean, standard deviation and lower bound of the shared free columns, shape (7q + 1,) each.

    With what the network says of outdoors and sun where it is known.
    """
    entries = [item[1:] for item in FREE_PRIOR.values() for _ in range(N_FREE)]
    mean, sd, low = np.array([*entries, (0.0, _LEVEL_SD_K, -np.inf)]).T
    if regression.weather_gains is not None:
        n = 2 * N_FREE
        mean[:n] = regression.weather_gains.ravel()
        sd[:n] = np.repeat(_WEATHER_SD, N_FREE) + _WEATHER_SHARE * np.abs(mean[:n])
    return mean, sd, low


def start_sd(n_modes: int) -> Array:
    """Return the prior standard deviation of a run's initial state per mode, K, shape (n_modes,)."""
    return np.asarray(_START_SD_K[-n_modes:])
