"""Physical parameters of the modes: time constants in h, initial slope in K/h, steady gains in K.

Besides the time constants, the forced response of order r has r parameters: the initial slope of the step response and
the steady gains of all modes but the fastest. All are nonnegative (times the sign), as the operator requires.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

TIME_CONSTANTS_H = (0.6, 3.5, 50.0)
"""Likely time constants of a heated house, h: emitter (0.5 to 1 h), room against structure (2 to 6 h), structure
against outdoors (1 to 4 days)."""

# Largest factor between the outermost time constants and what they are near.
_REACH = 10.0
# Least standard deviation of a gain, K or K/h, also if the fit gives zero.
_LEAST_GAIN_SD = 1e-3


@dataclass(frozen=True)
class ModePriors:
    """Gaussian priors of one order r, positive in the direction of the actuator's sign.

    `log_tau` (r,) and `log_tau_sd`: ln(τ/h). `gain_mean` and `gain_sd` (r,): [slope K/h, G_2 … G_r K]. For the slowest
    of several modes the prior is on the rate G_r/τ_r, `slowest_rate` (mean, sd) K/h, instead of the gain.
    """

    log_tau: Array
    log_tau_sd: float
    gain_mean: Array
    gain_sd: Array
    slowest_rate: tuple[float, float]

    @property
    def order(self) -> int:
        """Number of modes."""
        return int(self.log_tau.size)

    def gains_at(self, log_tau: Array) -> tuple[Array, Array]:
        """Return prior mean and standard deviation (r,) of [slope, G_2 … G_r] for these time constants."""
        mean, sd = self.gain_mean.copy(), self.gain_sd.copy()
        if self.order > 1:
            tau = float(np.exp(log_tau[-1]))
            mean[-1], sd[-1] = self.slowest_rate[0] * tau, self.slowest_rate[1] * tau
        return mean, sd


def centred_priors(log_tau: Array, gains: Array, relative_sd: float) -> ModePriors:
    """Return priors centred on a fit, `log_tau` (r,) and `gains` (r,) [slope K/h, G_2 … G_r K], with `relative_sd`."""
    gain_sd = np.maximum(relative_sd * np.abs(gains), _LEAST_GAIN_SD)
    rate = float(gains[-1] / np.exp(log_tau[-1]))
    return ModePriors(
        log_tau=np.asarray(log_tau, dtype=np.float64),
        log_tau_sd=relative_sd,
        gain_mean=np.asarray(gains, dtype=np.float64),
        gain_sd=gain_sd,
        slowest_rate=(rate, max(relative_sd * rate, _LEAST_GAIN_SD)),
    )


def bounds_h(log_tau: Array) -> Array:
    """Return the bounds of time constants near ln τ (r,), shape (r, 2), h; neighbours meet at their geometric mean."""
    tau = np.exp(log_tau)
    inner = np.sqrt(tau[:-1] * tau[1:])
    edges = np.concatenate([[tau[0] / _REACH], inner, [tau[-1] * _REACH]])
    return np.stack([edges[:-1], edges[1:]], axis=1)


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


def lagged(signal: Array, pole: float) -> Array:
    """States (n + 1,) of a first-order lag of steady gain 1 of `signal` (n,), from zero."""
    return np.append(0.0, lfilter([1.0 - pole], [1.0, -pole], signal))


def lags_of_gains(log_tau: Array) -> tuple[Array, Array]:
    """What a unit of each of [slope, G_2 … G_r] is of lags of gain 1: of its own mode and of the first, (r,) each."""
    tau = np.exp(log_tau)
    own, lead = np.ones(tau.size), -tau[0] / tau
    own[0], lead[0] = tau[0], 0.0
    return own, lead


def in_steps(log_tau: Array, gains: Array, step_s: float, bounds_h: Array) -> tuple[Array, Array, Array]:
    """Poles (r,), gains of a step (r,), K, and bounds of the poles (r, 2), of [slope, G_2 … G_r] (r,)."""
    tau, a = np.exp(log_tau), poles(log_tau, step_s)
    steady = np.concatenate([[tau[0] * (gains[0] - (gains[1:] / tau[1:]).sum())], gains[1:]])
    bounds = np.exp(-step_s / HOUR_S / bounds_h)
    within = np.stack([np.minimum(bounds[:, 0], a), np.maximum(bounds[:, 1], a)], axis=1)
    return a, steady * (1.0 - a), within


def to_operator(
    log_tau: Array,
    gains: Array,
    *,
    step_s: float,
    bounds_h: Array,
    sign: int,
    gamma: float,
    hidden: int,
    heat_input: HeatInput,
    feature_mean: Array,
    feature_scale: Array,
) -> OperatorParameters:
    """Return the linear operator (m = 1) with these time constants and nonnegative [slope, G_2 … G_r]."""
    a, of_step, bounds = in_steps(log_tau, gains, step_s, bounds_h)
    return linear_operator(
        a,
        sign * of_step,
        step_s=step_s,
        pole_bounds=bounds,
        sign=sign,
        gamma=gamma,
        hidden=hidden,
        heat_input=heat_input,
        feature_mean=feature_mean,
        feature_scale=feature_scale,
    )
