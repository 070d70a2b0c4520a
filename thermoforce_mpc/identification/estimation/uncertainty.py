"""Uncertainty of an effect: time constants, gains and step response, including their correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.differences import jacobian
from thermoforce_mpc.identification.estimation.modes import unit_steps

# Times after a step to full level at which the response and its standard deviation are stored, h.
STEP_RESPONSE_H: tuple[int, ...] = (1, 2, 4, 8, 12, 24, 48)


@dataclass(frozen=True)
class Effect:
    """What an actuator does to a zone: `log_tau` (r,): ln(τ/h), `gains` (r,): [slope K/h, G_2 … G_r K] in the direction
    of its sign, and their `covariance` (2r, 2r), time constants first.
    """

    log_tau: Array
    gains: Array
    covariance: Array


def step_response(effect: Effect) -> tuple[Array, Array]:
    """Mean and standard deviation, K, of the response (m = 1) to full level, `STEP_RESPONSE_H` after.

    The standard deviation is a first-order propagation.
    """
    r, parameters = effect.log_tau.size, np.concatenate([effect.log_tau, effect.gains])

    def response(parameters: Array) -> Array:
        return np.asarray(unit_steps(parameters[:r], np.array(STEP_RESPONSE_H)) @ parameters[r:])

    slopes = jacobian(response, parameters)
    variance = np.einsum("ti,ij,tj->t", slopes, effect.covariance, slopes)
    return response(parameters), np.sqrt(np.maximum(variance, 0.0))


def uncertainty(effect: Effect, level_sd: float = 0.0) -> dict[str, float]:
    """Return estimates of an effect and their standard deviations by name.

    `level_sd` is the relative standard deviation of the heat of a level; it adds to that of the step response.
    """
    r, sds = effect.log_tau.size, np.sqrt(np.diag(effect.covariance))
    out: dict[str, float] = {}
    for i, (tau, sd) in enumerate(zip(np.exp(effect.log_tau), sds[:r], strict=True), start=1):
        out |= {f"time_constant_{i}_h": float(tau), f"time_constant_{i}_sd_h": float(tau * sd)}
    names = ["starting_slope_K_per_h", *(f"steady_gain_{i}_K" for i in range(2, r + 1))]
    for name, value, sd in zip(names, effect.gains, sds[r:], strict=True):
        out |= {name: float(value), name.replace("_K", "_sd_K", 1): float(sd)}
    for hours, mean_K, sd_K in zip(STEP_RESPONSE_H, *step_response(effect), strict=True):
        out |= {f"step_response_{hours}h_K": float(mean_K)}
        out |= {f"step_response_{hours}h_sd_K": float(np.hypot(sd_K, level_sd * mean_K))}
    return out
