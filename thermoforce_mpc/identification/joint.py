"""Joint estimation of forced and free response from single runs, pairs, or both.

A run gives T = F + T_free at every boundary. Both share the building's slow modes. Given the time constants, all other
parameters are linear: gains, weights of weather and clock, initial state. So the time constants are searched (maximum a
posteriori, Nelder-Mead from the prior mean) and the rest is bounded Gaussian regression with correlated disturbances of
the assumed size, then of a reduced size if the residuals are far smaller. A pair gives D = T_a − T_b, in which the free
part cancels (paper eq:paired).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.bounded import BoundedLeastSquares, FreeFirst
from thermoforce_mpc.identification.columns import free_prior, free_time_constants, other_prior, start_sd
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.modes import ModePriors, poles
from thermoforce_mpc.identification.reduction import Reduction, whitened_rows
from thermoforce_mpc.identification.regression_data import FREE_PRIOR, REFERENCE_C, RegressionData, likely_scale, scaled
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters

# Function evaluations of the search per time constant.
_MAX_EVALUATIONS = 60
# Step of derivatives with respect to ln τ.
_DERIVATIVE_STEP = 0.01
# Least gain, K or K/h: an effect that the record denies keeps the sign of its actuator.
_LEAST_GAIN = 1e-12
# Penalty for time constants outside their bounds.
_OUTSIDE = 1e6


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

    def free_model(self, step_s: float, config: IdentificationConfig) -> RcParameters:
        """Return the free part as a linear model at `step_s`."""
        a = poles(self.free_log_tau, step_s)
        # Each disturbance enters the mode nearest to its time constant; none enters the ground mode.
        share = np.zeros(a.size)
        for sd, hours in zip(config.disturbance_sd_K, config.disturbance_hours, strict=True):
            nearest = int(np.argmin(np.abs(self.free_log_tau[:-1] - np.log(hours))))
            share[nearest] = np.hypot(share[nearest], sd * max(self.residual_scale, 0.3))
        return RcParameters(
            poles=a,
            weights=self.free_gains * (1.0 - a)[:, None],
            step_s=step_s,
            process_sd_K=share * np.sqrt(1.0 - a**2),
            sensor_sd_K=max(config.sensor_sd_K, 0.01),
        )


@dataclass(frozen=True)
class _Found:
    """Maximum of the posterior: `values` of all columns of `system`, at disturbances `scale` times the assumed ones."""

    log_tau: Array
    values: Array
    residual_scale: float
    scale: float

    @property
    def gains(self) -> Array:
        return np.maximum(self.values[: self.log_tau.size], _LEAST_GAIN)


def fit_modes(data: Reduction, priors: ModePriors, config: IdentificationConfig) -> ModeFit:
    """Fit as `fit_joint`, without uncertainty and free part: enough to compare models."""
    found = _found(data, priors, config)
    return ModeFit(found.log_tau, found.gains, found.residual_scale)


def fit_joint(
    regressions: Sequence[RegressionData], priors: ModePriors, config: IdentificationConfig, sign: int
) -> JointFit:
    """Fit time constants, gains and free part to all regressions jointly; `sign` +1 heating, −1 cooling."""
    found = _found(Reduction(regressions, sign), priors, config)
    log_tau, values = found.log_tau, found.values
    r, K = priors.order, regressions[0].others.shape[0]
    free_log_tau = free_time_constants(log_tau)
    smaller = min(1.0, likely_scale(found.residual_scale) / found.scale)
    covariance = _joint_covariance(scaled(regressions, found.scale), log_tau, values, priors, sign, smaller)
    of_tau = np.arange(r)
    of_others = [np.concatenate([of_tau, r + (1 + k) * r + of_tau]) for k in range(K)]
    return JointFit(
        log_tau=log_tau,
        gains=found.gains,
        residual_scale=found.residual_scale,
        covariance=covariance[: 2 * r, : 2 * r],
        free_log_tau=free_log_tau,
        free_gains=_free_gains(
            values[r + K * r :], free_log_tau.size, with_free=any(not b.is_pair for b in regressions)
        ),
        other_gains=values[r : r + K * r].reshape(K, r),
        other_covariance=np.array([covariance[np.ix_(i, i)] for i in of_others]).reshape(K, 2 * r, 2 * r),
        other_sd=other_prior(regressions[0], log_tau)[1].reshape(K, r),
    )


def _found(data: Reduction, priors: ModePriors, config: IdentificationConfig) -> _Found:
    known = _Priors(data.regressions, priors)
    log_tau = _search(data, 1.0, known, priors, priors.log_tau)
    values = _bounded(data, 1.0, log_tau, known).values
    residual_scale = _residual_scale(data, log_tau, values)
    # If the residuals are far smaller than assumed, refit with smaller disturbances: the data carry more information.
    scale = min(1.0, config.disturbance_margin * residual_scale)
    if scale == 1.0 or not data.n_runs:
        return _Found(log_tau, values, residual_scale, scale)
    log_tau = _search(data, scale, known, priors, log_tau)
    values = _bounded(data, scale, log_tau, known).values
    return _Found(log_tau, values, _residual_scale(data, log_tau, values), scale)


def _search(data: Reduction, scale: float, known: _Priors, priors: ModePriors, start: Array) -> Array:
    """Return the maximum a posteriori ln(τ/h) (r,), searched from `start` (r,), at `scale` times the disturbances."""
    low, high = np.log(priors.bounds_h()).T

    def objective(log_tau: Array) -> float:
        if (log_tau < low).any() or (log_tau > high).any():
            return _OUTSIDE * (1.0 + float((np.maximum(low - log_tau, 0.0) + np.maximum(log_tau - high, 0.0)).sum()))
        away = (log_tau - priors.log_tau) / priors.log_tau_sd
        return 0.5 * _bounded(data, scale, log_tau, known).squares + 0.5 * float(away @ away)

    simplex = np.vstack([start, start + np.eye(priors.order) * priors.log_tau_sd])
    found = minimize(
        objective,
        start,
        method="Nelder-Mead",
        options={
            "maxfev": _MAX_EVALUATIONS * priors.order,
            "xatol": 0.01,
            "fatol": 0.01,
            "initial_simplex": np.clip(simplex, low + 1e-6, high - 1e-6),
        },
    )
    return np.asarray(found.x)


def _residual_scale(data: Reduction, log_tau: Array, values: Array) -> float:
    """Return the RMS of the residual whitened with the assumed disturbances."""
    rows = data.rows(log_tau)
    return float(np.sqrt(np.sum((rows[:, :-1] @ values - rows[:, -1]) ** 2) / data.n_rows))


def _bounded(data: Reduction, scale: float, log_tau: Array, known: _Priors) -> BoundedLeastSquares:
    """Solve the Gaussian regression for given time constants, with `scale` times the disturbances."""
    return BoundedLeastSquares(np.concatenate([data.rows(log_tau, scale), known.rows(log_tau)]), known.variables)


def system(
    regressions: Sequence[RegressionData], log_tau: Array, priors: ModePriors, sign: int
) -> tuple[Array, FreeFirst, int]:
    """Return the whitened regression for given time constants: rows, order of its variables, number of data rows.

    Rows (n, p + 1) are those of `whitened_rows` and then the priors, the target in the last column.
    """
    known = _Priors(regressions, priors)
    rows = np.concatenate([*whitened_rows(regressions, log_tau, sign), known.rows(log_tau)])
    return rows, known.variables, rows.shape[0] - known.variables.order.size


class _Priors:
    """Priors of the columns of `system`, and the order of its variables."""

    def __init__(self, regressions: Sequence[RegressionData], priors: ModePriors) -> None:
        self._priors, self._first = priors, regressions[0]
        n_runs, log_tau = sum(not regression.is_pair for regression in regressions), priors.log_tau
        mean, sd = self._acting(log_tau)
        self._n_acting = mean.size
        positive = np.ones(mean.size, dtype=bool)
        if n_runs:
            q = free_time_constants(log_tau).size
            free_mean, free_sd, low = free_prior(q)
            starts = np.tile(start_sd(q + 1), n_runs)
            mean = np.concatenate([mean, free_mean, np.zeros(starts.size)])
            sd = np.concatenate([sd, free_sd, starts])
            positive = np.concatenate([positive, np.isfinite(low), np.zeros(starts.size, dtype=bool)])
        self.variables = FreeFirst(positive)
        self._rows = np.concatenate([np.diag(1.0 / sd), (mean / sd)[:, None]], axis=1)

    def rows(self, log_tau: Array) -> Array:
        """The priors as rows (p, p + 1) of `system`; of gains they depend on the time constants."""
        rows, acting = self._rows.copy(), np.arange(self._n_acting)
        mean, sd = self._acting(log_tau)
        rows[acting, acting], rows[acting, -1] = 1.0 / sd, mean / sd
        return rows

    def _acting(self, log_tau: Array) -> tuple[Array, Array]:
        own, other = self._priors.gains_at(log_tau), other_prior(self._first, log_tau)
        return np.concatenate([own[0], other[0]]), np.concatenate([own[1], other[1]])


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


def _joint_covariance(
    regressions: Sequence[RegressionData], log_tau: Array, values: Array, priors: ModePriors, sign: int, found: float
) -> Array:
    """Return the error covariance of [ln τ, gains of the own and the other actuators], marginalised over the rest.

    Laplace approximation: H = P + D is the Gauss-Newton Hessian of the negative log posterior at its maximum, with P
    the precision of the priors and D that of the data. If the disturbances of runs are only `found` times the assumed
    ones, the error covariance is H⁻¹ (P + found² D) H⁻¹: the data were under-weighted, so errors of the prior remain
    in the estimate. It is H⁻¹ for found = 1.
    """
    r = log_tau.size
    acting = 2 * r + regressions[0].others.shape[0] * r

    def residual(at: Array) -> Array:
        rows, _, _ = system(regressions, at, priors, sign)
        return np.asarray(rows[:, :-1] @ values - rows[:, -1])

    shifts = _DERIVATIVE_STEP * np.eye(r)
    slopes = np.stack([residual(log_tau + d) - residual(log_tau - d) for d in shifts], axis=1) / (
        2.0 * _DERIVATIVE_STEP
    )
    whole, _, rows = system(regressions, log_tau, priors, sign)
    jacobian = np.concatenate([slopes, whole[:, :-1]], axis=1)
    errors = np.concatenate([np.full(e.rows.size, 1.0 if e.is_pair else found) for e in regressions])
    prior = jacobian[rows:].T @ jacobian[rows:]
    prior[:r, :r] += np.eye(r) / priors.log_tau_sd**2
    data = jacobian[:rows]
    inverse = np.linalg.inv(data.T @ data + prior)
    scaled_data = data * errors[:, None]
    return np.asarray(inverse @ (scaled_data.T @ scaled_data + prior) @ inverse)[:acting, :acting]
