"""Posterior uncertainty of the linear fit: time constants, gains and step response, including their correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.differences import jacobian
from thermoforce_mpc.identification.estimation.joint import JointFit
from thermoforce_mpc.identification.estimation.modes import unit_responses

# Times after a step to full level at which the response and its standard deviation are stored, h.
STEP_RESPONSE_H: tuple[int, ...] = (1, 2, 4, 8, 12, 24, 48)


@dataclass(frozen=True)
class StepResponse:
    """Step response to full level: mean `mean_K` and standard deviation `sd_K` (n,) K at `hours` (n,) h."""

    hours: Array
    mean_K: Array
    sd_K: Array


def step_response(fit: JointFit, hours: float, step_s: float) -> StepResponse:
    """Return the step response of the linear fit (m = 1, v = 1) over `hours` h; sd by first-order propagation."""
    n = max(1, round(hours * HOUR_S / step_s))
    r = fit.log_tau.size

    def response(parameters: Array) -> Array:
        return np.asarray(unit_responses(parameters[:r], step_s, np.ones(n)) @ parameters[r:])

    slopes = jacobian(response, np.concatenate([fit.log_tau, fit.gains]))
    variance = np.einsum("ti,ij,tj->t", slopes, fit.covariance, slopes)
    mean = response(np.concatenate([fit.log_tau, fit.gains]))
    return StepResponse(
        np.asarray(np.arange(n + 1) * step_s / HOUR_S, dtype=np.float64), mean, np.sqrt(np.maximum(variance, 0.0))
    )


def uncertainty(fit: JointFit, level_sd: float = 0.0) -> dict[str, float]:
    """Return estimates of the linear fit and their posterior standard deviations by name.

    `level_sd` is the relative standard deviation of the heat of a level; it adds to that of the step response.
    """
    r, sds = fit.log_tau.size, np.sqrt(np.diag(fit.covariance))
    out: dict[str, float] = {}
    for i, (tau, sd) in enumerate(zip(np.exp(fit.log_tau), sds[:r], strict=True), start=1):
        out |= {f"time_constant_{i}_h": float(tau), f"time_constant_{i}_sd_h": float(tau * sd)}
    names = ["starting_slope_K_per_h", *(f"steady_gain_{i}_K" for i in range(2, r + 1))]
    for name, value, sd in zip(names, fit.gains, sds[r:], strict=True):
        out |= {name: float(value), name.replace("_K", "_sd_K", 1): float(sd)}
    answer = step_response(fit, STEP_RESPONSE_H[-1], HOUR_S)
    for hours in STEP_RESPONSE_H:
        out |= {f"step_response_{hours}h_K": float(answer.mean_K[hours])}
        sd = float(np.hypot(answer.sd_K[hours], level_sd * answer.mean_K[hours]))
        out |= {f"step_response_{hours}h_sd_K": sd}
    return out
