"""Joint estimation of forced and free response from single runs, pairs, or both.

A run gives T = F + T_free at every boundary. Three time constants are those of the building's network, so that all
other parameters are linear: gains, weights of weather and clock, initial state. They are a bounded Gaussian regression
with correlated disturbances; one or two time constants, which cannot be the network's, are searched for. A pair gives
D = T_a − T_b, in which the free part cancels (paper eq:paired).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import OptimizeResult, lsq_linear, minimize

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.columns import free_time_constants, other_prior
from thermoforce_mpc.identification.estimation.disturbance import ASSUMED_H, ASSUMED_SD_K, SENSOR_SD_K
from thermoforce_mpc.identification.estimation.modes import ModePriors, bounds_h, poles
from thermoforce_mpc.identification.estimation.regression import (
    FREE_PRIOR,
    REFERENCE_C,
    RegressionData,
)
from thermoforce_mpc.identification.estimation.rows import Rows
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters

# Least gain, K or K/h: an effect that the record denies keeps the sign of its actuator.
_LEAST_GAIN = 1e-12
# Modes that have the response of a room to within a per cent. Of fewer, those that suit its record best are searched.
_ENOUGH = 3
_SEARCH = {"xatol": 1e-3, "fatol": 1e-3}


@dataclass(frozen=True)
class ModeFit:
    """Time constants and gains of an operator of order r, estimated together with the free part.

    `log_tau` (r,): ln(τ/h). `gains` (r,): [slope K/h, G_2 … G_r K], positive. `residual_scale`: RMS of the whitened
    residual (1: disturbances as large as assumed).
    """

    log_tau: Array
    gains: Array
    residual_scale: float


@dataclass(frozen=True)
class JointFit(ModeFit):
    """Result of the joint estimation of an operator of order r and q free modes.

    `covariance` (2r, 2r): posterior of `log_tau` and `gains`, time constants first. `free_log_tau` (q,); `free_gains`
    (q, 8): steady free gains per unit of `INPUTS`. `other_gains` (K, r): [slope, G_2 … G_r] of the other actuators,
    positive in the direction of their sign, with `other_covariance` (K, 2r, 2r) as `covariance`; `other_sd` (K, r):
    prior standard deviations of these gains.
    """

    covariance: Array
    free_log_tau: Array
    free_gains: Array
    other_gains: Array = field(default_factory=lambda: np.empty((0, 0)))
    other_covariance: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    other_sd: Array = field(default_factory=lambda: np.empty((0, 0)))

    def of_other(self, k: int) -> JointFit:
        """The fit as that of the zone's response to other actuator `k`."""
        return replace(self, gains=self.other_gains[k], covariance=self.other_covariance[k])

    def free_model(self, step_s: float, sensor_sd_K: float = SENSOR_SD_K) -> RcParameters:
        """Return the free part as a linear model at `step_s`."""
        a = poles(self.free_log_tau, step_s)
        # Each disturbance enters the mode nearest to its time constant; none enters the ground mode.
        share = np.zeros(a.size)
        for sd, hours in zip(ASSUMED_SD_K, ASSUMED_H, strict=True):
            nearest = int(np.argmin(np.abs(self.free_log_tau[:-1] - np.log(hours))))
            share[nearest] = np.hypot(share[nearest], sd * max(self.residual_scale, 0.3))
        return RcParameters(
            poles=a,
            weights=self.free_gains * (1.0 - a)[:, None],
            step_s=step_s,
            process_sd_K=share * np.sqrt(1.0 - a**2),
            sensor_sd_K=sensor_sd_K,
        )


def fit_modes(regressions: Sequence[RegressionData], priors: ModePriors, sign: int) -> ModeFit:
    """Fit as `fit_joint`, without uncertainty and free part: enough to compare models."""
    return _posterior_maximum(regressions, priors, sign)[0]


def fit_joint(
    regressions: Sequence[RegressionData],
    priors: ModePriors,
    sign: int,
    covariance: Array,
) -> JointFit:
    """Fit gains and free part to all regressions jointly, at the time constants of `priors`.

    `sign` +1 heating, −1 cooling; `covariance` (1 + K, 2r, 2r) of the effects as the network knows them: the loop does
    not bias its likelihood, which here it does.
    """
    fit, values = _posterior_maximum(regressions, priors, sign)
    r, K = priors.order, regressions[0].others.shape[0]
    free_log_tau = free_time_constants(fit.log_tau)
    return JointFit(
        log_tau=fit.log_tau,
        gains=fit.gains,
        residual_scale=fit.residual_scale,
        covariance=covariance[0],
        free_log_tau=free_log_tau,
        free_gains=_free_gains(
            values[r + K * r :], free_log_tau.size, with_free=any(not b.is_pair for b in regressions)
        ),
        other_gains=values[r : r + K * r].reshape(K, r),
        other_covariance=covariance[1:],
        other_sd=other_prior(regressions[0])[1].reshape(K, r),
    )


def _posterior_maximum(regressions: Sequence[RegressionData], priors: ModePriors, sign: int) -> tuple[ModeFit, Array]:
    """The fit, and the values of all columns (p,)."""
    log_tau = priors.log_tau
    if priors.order < _ENOUGH:

        def squares(at: Array) -> float:
            away = (at - priors.log_tau) / priors.log_tau_sd
            return float(2.0 * _solved(Rows.of(regressions, priors, sign, at)).cost + away @ away)

        bounds = np.log(bounds_h(priors.log_tau))
        log_tau = minimize(squares, log_tau, method="Nelder-Mead", bounds=bounds, options=_SEARCH).x
    system = Rows.of(regressions, priors, sign, log_tau)
    values = np.asarray(_solved(system).x)
    n = sum(regression.rows.size for regression in regressions)
    residual = system.columns[:n] @ values - system.target[:n]
    gains = np.maximum(values[: priors.order], _LEAST_GAIN)
    return ModeFit(log_tau, gains, float(np.sqrt(np.mean(residual**2)))), values


def _solved(system: Rows) -> OptimizeResult:
    R = np.asarray(np.linalg.qr(np.column_stack([system.columns, system.target]), mode="r"))
    return lsq_linear(R[:, :-1], R[:, -1], (system.low, np.inf), method="bvls")


def _free_gains(values: Array, n_free: int, *, with_free: bool) -> Array:
    """Return steady gains (q, 8) per unit of `INPUTS` from the shared free columns (zeros with pairs only)."""
    gains = np.zeros((n_free, len(INPUTS)))
    if not with_free:
        return gains
    for k, (name, (unit, *_)) in enumerate(FREE_PRIOR.items()):
        gains[:, INPUTS.index(name)] = values[k * n_free : (k + 1) * n_free] * unit
    # The constant level cannot be attributed to a mode; it is assigned to the slowest.
    gains[-1, INPUTS.index("constant")] = values[len(FREE_PRIOR) * n_free] + REFERENCE_C
    return gains
