"""Modes of a forced response in physical terms.

Of order r it has `log_tau` (r,): ln(τ/h), rising, and `gains` (r,): [slope K/h, G_2 … G_r K], the initial slope of the
step response to full level and the steady gains of all modes but the fastest. All are nonnegative (times the sign), as
the operator requires.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.series import lagged

# Times after a step to full level at which the response and its standard deviation are stored, h.
STEP_RESPONSE_H: tuple[int, ...] = (1, 2, 4, 8, 12, 24, 48)
EFFECT_H = 8
"""The one of these hours by which an effect is judged, h."""
BAND = 1.645
"""Half width of a 90 % band of a normal distribution, standard deviations."""

# Largest standard deviation of a logarithm that counts.
_MOST_OF_LOGARITHM = 1.5


def poles(log_tau: Array, step_s: float) -> Array:
    """The poles exp(−step/τ) (r,)."""
    return np.asarray(np.exp(-step_s / HOUR_S / np.exp(log_tau)))


def unit_responses(log_tau: Array, step_s: float, drive: Array, rows: NDArray[np.intp] | None = None) -> Array:
    """Forced response to `drive` (n,) per unit of each gain, (n + 1, r), K; only `rows` where they are given.

    Row t is the state before step t, starting from zero.
    """
    lags = np.stack([lagged(drive, pole) for pole in poles(log_tau, step_s)], axis=1)
    own, lead = _lags_of_gains(log_tau)
    responses = own * lags + lead * lags[:, :1]
    return np.asarray(responses if rows is None else responses[rows])


def unit_steps(log_tau: Array, hours: Array) -> Array:
    """Response to a step to 1 per unit of each gain at `hours` (T,) after it, (T, r), K."""
    rising = -np.expm1(-hours[:, None] / np.exp(log_tau))
    own, lead = _lags_of_gains(log_tau)
    return np.asarray(own * rising + lead * rising[:, :1])


def in_steps(log_tau: Array, gains: Array, step_s: float) -> tuple[Array, Array]:
    """Poles (r,) and gains of a step (r,), K."""
    tau, a = np.exp(log_tau), poles(log_tau, step_s)
    steady = np.concatenate([[tau[0] * (gains[0] - (gains[1:] / tau[1:]).sum())], gains[1:]])
    return a, steady * (1.0 - a)


def _lags_of_gains(log_tau: Array) -> tuple[Array, Array]:
    """What a unit of each gain is of lags of gain 1: of its own mode and of the first, (r,) each."""
    tau = np.exp(log_tau)
    own, lead = np.ones(tau.size), -tau[0] / tau
    own[0], lead[0] = tau[0], 0.0
    return own, lead


@dataclass(frozen=True)
class Effect:
    """What an actuator does to a zone; `sd_K` (7,): standard deviations of the response at `STEP_RESPONSE_H`."""

    log_tau: Array
    gains: Array
    sd_K: Array

    @property
    def step_K(self) -> Array:
        """Response (m = 1) to full level, `STEP_RESPONSE_H` after, K."""
        return np.asarray(unit_steps(self.log_tau, np.array(STEP_RESPONSE_H)) @ self.gains)

    def uncertainty(self, level_sd: float = 0.0, *, of_logarithm: bool = False) -> dict[str, float]:
        """The step response and its standard deviations by name, K.

        `level_sd` is the relative standard deviation of the heat of a level, which adds to them. `of_logarithm`: that
        of the logarithm is meant, so that a band of `BAND` reaches as far below as it must above.
        """
        out: dict[str, float] = {}
        for hours, mean_K, sd_K in zip(STEP_RESPONSE_H, self.step_K, self.sd_K, strict=True):
            both_K = float(np.hypot(sd_K, level_sd * mean_K))
            if of_logarithm and mean_K > 0.0:
                both_K = float(mean_K * np.expm1(BAND * min(both_K / mean_K, _MOST_OF_LOGARITHM)) / BAND)
            out[f"step_response_{hours}h_K"] = float(mean_K)
            out[f"step_response_{hours}h_sd_K"] = both_K
        return out
