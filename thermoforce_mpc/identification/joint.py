"""Joint estimation of the forced and the free response, from runs without a twin, from pairs, or from both.

A run gives T = F + T_free at every boundary. Both share the building's slow modes; given the time constants everything
else enters linearly: gains, weights of weather and clock, the state the run starts in. So the time constants are
searched (maximum a posteriori, Nelder-Mead from the prior's centre), and the rest is bounded Gaussian regression with
correlated disturbances. A pair gives D = T_a − T_b, in which all of the free part cancels (paper eq:paired).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear, minimize

from thermoforce_mpc.free_response.rc import INPUTS, RcParameters, weather_inputs
from thermoforce_mpc.identification.config import DEFAULT_TIME_CONSTANTS_H, IdentificationConfig
from thermoforce_mpc.identification.disturbance import disturbance_covariance
from thermoforce_mpc.identification.modes import ModePriors, poles, unit_responses
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.operator.actuator import ActuatorMap
from thermoforce_mpc.types import HOUR_S, Array, History

# Priors of the free part, per slow mode and in steady state: K per K outdoors, K per 100 W/m², K of the daily wave.
# A house follows the outdoors with a total gain near 1 and winter sun lifts it by a few kelvin.
_FREE_PRIOR: dict[str, tuple[float, float, float, float]] = {
    # name: (unit, mean, standard deviation, lower bound)
    "outdoor": (1.0, 0.3, 0.3, 0.0),
    "solar": (0.01, 1.0, 1.0, 0.0),
    "solar_cosine": (0.01, 0.0, 1.0, -np.inf),
    "solar_sine": (0.01, 0.0, 1.0, -np.inf),
    "daily_cosine": (1.0, 0.0, 0.3, -np.inf),
    "daily_sine": (1.0, 0.0, 0.3, -np.inf),
    "solar_squared": (0.01, 0.0, 1.0, -np.inf),
}
# Level of the free response and state of each mode at the start of a run: as good as unknown, K.
_LEVEL_SD_K = 50.0
_START_SD_K = (3.0, 20.0, 50.0, 50.0)
# Soil and neighbouring rooms answer the weather over weeks: too slow to be identified, too strong to be left out.
_GROUND_H = 400.0
_REFERENCE_C = 20.0
# Pairs cancel all drift; what is left is the model's own error of a few hundredths of a kelvin. It is one draw per pair
# and hour rather than one per row, so rows are taken for ten times less certain than they look.
_PAIR_SD_K = 0.3
# Rows of one run that are compared (all steps are simulated): beyond this the regression only gets slower.
_MAX_ROWS = 700
_MAX_EVALUATIONS = 60
# Disturbances are taken for this many times as large as the fit found them when its certainty is told, and for no less
# than a share of what was assumed: residuals that were fitted look smaller than they are.
_ROOM, _LEAST_DISTURBED = 2.5, 0.1
# Step of derivatives with respect to ln τ.
_DERIVATIVE_STEP = 0.01
# What keeps a time constant from being pushed against its bound.
_OUTSIDE = 1e6


@dataclass(frozen=True)
class Episode:
    """One run or pair as a regression: what is compared, and the whitening of its disturbances.

    `target` (rows,) K; `rows` (rows,) boundaries that are compared; `factor` (rows, rows) lower Cholesky factor of the
    disturbances' covariance; `inputs` (n, 8) weather of the steps, empty for a pair; `drives` the heat v (n,) of each
    run and the sign it enters with.
    """

    target: Array
    rows: NDArray[np.intp]
    factor: Array
    step_s: float
    drives: tuple[tuple[int, Array], ...]
    inputs: Array

    @property
    def n_steps(self) -> int:
        """Steps of the run or pair."""
        return int(self.drives[0][1].size)

    @property
    def is_pair(self) -> bool:
        """Whether this is a difference of two runs, in which the free part cancels."""
        return self.inputs.size == 0


@dataclass(frozen=True)
class JointFit:
    """Result of the joint estimation.

    `log_tau` (r,) of ln(τ/h); `gains` (r,) are [slope K/h, G_2 … G_r K] (positive); `covariance` (2r, 2r) the joint
    posterior covariance of both, time constants first; `free_log_tau` (q,) and `free_gains` (q, 8) the steady free
    gains per unit of `INPUTS`; `misfit` the RMS of the whitened residual (1: disturbances as large as assumed);
    `objective` the negative log posterior at its maximum, up to a constant.
    """

    log_tau: Array
    gains: Array
    covariance: Array
    free_log_tau: Array
    free_gains: Array
    misfit: float
    objective: float

    def free_model(self, step_s: float, config: IdentificationConfig) -> RcParameters:
        """The free part as a linear free model at `step_s`."""
        a = poles(self.free_log_tau, step_s)
        # Disturbances come into the modes nearest to their own time constants; the ground has none of its own.
        share = np.zeros(a.size)
        for sd, hours in zip(config.disturbance_sd_K, config.disturbance_hours, strict=True):
            nearest = int(np.argmin(np.abs(self.free_log_tau[:-1] - np.log(hours))))
            share[nearest] = np.hypot(share[nearest], sd * max(self.misfit, 0.3))
        return RcParameters(
            poles=a,
            weights=self.free_gains * (1.0 - a)[:, None],
            step_s=step_s,
            process_sd_K=share * np.sqrt(1.0 - a**2),
            sensor_sd_K=max(config.sensor_sd_K, 0.01),
        )


def run_episode(history: History, actuator: ActuatorMap, config: IdentificationConfig) -> Episode:
    """A run as a regression episode; silent sensor readings are left out."""
    n = history.n_steps
    stride = max(1, -(-n // _MAX_ROWS))
    rows = np.arange(0, n + 1, stride)
    rows = rows[np.isfinite(history.T_zone_C[rows])]
    return Episode(
        target=history.T_zone_C[rows] - _REFERENCE_C,
        rows=rows,
        factor=cholesky(disturbance_covariance(history.time_s[rows], config), lower=True),
        step_s=history.step_s,
        drives=((1, actuator(history.u, history.T_out_C[:-1])),),
        inputs=weather_inputs(history.time_s, history.T_out_C, history.solar_W_m2),
    )


def pair_episode(pair: Pair, actuator: ActuatorMap) -> Episode:
    """A pair as a regression episode on the difference a − b."""
    difference = pair.a.T_zone_C - pair.b.T_zone_C
    rows = np.flatnonzero(np.isfinite(difference))
    rows = rows[rows > 0]
    drives = tuple((sign, actuator(history.u, history.T_out_C[:-1])) for sign, history in ((1, pair.a), (-1, pair.b)))
    return Episode(
        target=difference[rows],
        rows=rows,
        factor=np.eye(rows.size) * _PAIR_SD_K,
        step_s=pair.a.step_s,
        drives=drives,
        inputs=np.empty((0, len(INPUTS))),
    )


def calibrated(episodes: Sequence[Episode], misfit: float) -> list[Episode]:
    """Runs with disturbances of about the size that was found, rather than as large as a cautious fit assumes.

    What a pair leaves unexplained is the model's own error, so pairs stay as they are.
    """
    scale = float(np.clip(_ROOM * misfit, _LEAST_DISTURBED, 1.0))
    return [e if e.is_pair else replace(e, factor=e.factor * scale) for e in episodes]


def forced_columns(episode: Episode, log_tau: Array, sign: int) -> Array:
    """Response of each compared row to a unit of [slope, G_2 … G_r], shape (rows, r), K."""
    total = sum(s * unit_responses(log_tau, episode.step_s, drive) for s, drive in episode.drives)
    return np.asarray(sign * np.asarray(total)[episode.rows])


def follows_action(episode: Episode, hours: float) -> NDArray[np.bool_]:
    """Which compared rows come within `hours` after a step in which something was done (differently), shape (rows,)."""
    done = np.abs(np.sum([s * drive for s, drive in episode.drives], axis=0)) > 0.0
    before = np.concatenate([[0], np.cumsum(done)])
    reach = max(1, round(hours * HOUR_S / episode.step_s))
    return np.asarray(before[episode.rows] > before[np.maximum(episode.rows - reach, 0)])


def free_columns(episode: Episode, log_tau: Array, free_log_tau: Array) -> tuple[Array, Array]:
    """Columns of the shared free gains and of the run's own starting state, (rows, q·7 + 1) and (rows, modes)."""
    weather = []
    for name, (unit, *_) in _FREE_PRIOR.items():
        signal = episode.inputs[:, INPUTS.index(name)] * unit
        for mode in free_log_tau:
            weather.append(unit_responses(np.array([mode]), episode.step_s, signal)[:, 0] / np.exp(mode))
    shared = np.stack([*weather, np.ones(episode.inputs.shape[0] + 1)], axis=1)
    steps = np.arange(episode.inputs.shape[0] + 1)
    fastest = log_tau[:1] if log_tau.size > 1 else np.log(DEFAULT_TIME_CONSTANTS_H[3][:1])
    modes = np.concatenate([fastest, free_log_tau])
    start = poles(modes, episode.step_s)[None, :] ** steps[:, None]
    return shared[episode.rows], start[episode.rows]


def free_time_constants(log_tau: Array) -> Array:
    """ln τ of the free part's modes: the slow ones of an operator of order 3 (or of its prior), and the ground."""
    slow = log_tau[1:] if log_tau.size == 3 else np.log(DEFAULT_TIME_CONSTANTS_H[3][1:])
    return np.append(slow, np.log(_GROUND_H))


def free_prior(n_free: int) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and lower bound of the shared free columns."""
    entries = [item[1:] for item in _FREE_PRIOR.values() for _ in range(n_free)] + [(0.0, _LEVEL_SD_K, -np.inf)]
    mean, sd, low = (np.array(column) for column in zip(*entries, strict=True))
    return mean, sd, low


def start_sd(n_modes: int) -> Array:
    """Prior standard deviation of a run's starting state per mode, K."""
    return np.asarray(_START_SD_K[-n_modes:])


@dataclass(frozen=True)
class _Solution:
    values: Array
    objective: float
    whitened_rms: float


def fit_joint(episodes: Sequence[Episode], priors: ModePriors, config: IdentificationConfig, sign: int) -> JointFit:
    """Fit time constants, gains and free part to all episodes at once."""
    log_bounds = np.log(priors.bounds_h())

    def objective(log_tau: Array) -> float:
        outside = np.maximum(log_bounds[:, 0] - log_tau, 0.0) + np.maximum(log_tau - log_bounds[:, 1], 0.0)
        if outside.any():
            return _OUTSIDE * (1.0 + float(outside.sum()))
        return _solve(episodes, log_tau, priors, sign).objective

    simplex = np.vstack([priors.log_tau, priors.log_tau + np.eye(priors.order) * priors.log_tau_sd])
    found = minimize(
        objective,
        priors.log_tau,
        method="Nelder-Mead",
        options={
            "maxfev": _MAX_EVALUATIONS * priors.order,
            "xatol": 0.01,
            "fatol": 0.01,
            "initial_simplex": np.clip(simplex, log_bounds[:, 0] + 1e-6, log_bounds[:, 1] - 1e-6),
        },
    )
    log_tau = np.asarray(found.x)
    solution = _solve(episodes, log_tau, priors, sign)
    r = priors.order
    free_log_tau = free_time_constants(log_tau)
    return JointFit(
        log_tau=log_tau,
        gains=solution.values[:r],
        covariance=_joint_covariance(
            calibrated(episodes, solution.whitened_rms), log_tau, solution.values, priors, sign
        ),
        free_log_tau=free_log_tau,
        free_gains=_free_gains(solution.values[r:], free_log_tau.size, with_free=any(not b.is_pair for b in episodes)),
        misfit=solution.whitened_rms,
        objective=solution.objective,
    )


def _system(
    episodes: Sequence[Episode], log_tau: Array, priors: ModePriors, sign: int
) -> tuple[Array, Array, Array, int]:
    """Whitened regression for given time constants: design, target, lower bounds, and how many rows are data.

    Columns are gains, shared free part, starts run by run; the last rows are the priors.
    """
    r = log_tau.size
    free_log_tau = free_time_constants(log_tau)
    runs = [i for i, episode in enumerate(episodes) if not episode.is_pair]
    n_starts = free_log_tau.size + 1
    mean, sd = priors.gains_at(log_tau)
    low = np.zeros(r)
    if runs:
        free_mean, free_sd, free_low = free_prior(free_log_tau.size)
        starts = np.tile(start_sd(n_starts), len(runs))
        mean = np.concatenate([mean, free_mean, np.zeros(starts.size)])
        sd = np.concatenate([sd, free_sd, starts])
        low = np.concatenate([low, free_low, np.full(starts.size, -np.inf)])
    designs, targets = [], []
    for i, episode in enumerate(episodes):
        columns = np.zeros((episode.rows.size, mean.size))
        columns[:, :r] = forced_columns(episode, log_tau, sign)
        if not episode.is_pair:
            shared, start = free_columns(episode, log_tau, free_log_tau)
            columns[:, r : r + shared.shape[1]] = shared
            first = r + shared.shape[1] + runs.index(i) * n_starts
            columns[:, first : first + n_starts] = start
        designs.append(solve_triangular(episode.factor, columns, lower=True))
        targets.append(solve_triangular(episode.factor, episode.target, lower=True))
    design = np.concatenate([*designs, np.diag(1.0 / sd)])
    target = np.concatenate([*targets, mean / sd])
    return design, target, low, sum(t.size for t in targets)


def _solve(episodes: Sequence[Episode], log_tau: Array, priors: ModePriors, sign: int) -> _Solution:
    """Bounded Gaussian regression for given time constants."""
    design, target, low, rows = _system(episodes, log_tau, priors, sign)
    values = lsq_linear(design, target, bounds=(low, np.inf)).x
    residual = design @ values - target
    away = (log_tau - priors.log_tau) / priors.log_tau_sd
    objective = 0.5 * float(residual @ residual) + 0.5 * float(away @ away)
    return _Solution(
        values=np.asarray(values),
        objective=objective,
        whitened_rms=float(np.sqrt(np.mean(residual[:rows] ** 2))),
    )


def _free_gains(values: Array, n_free: int, *, with_free: bool) -> Array:
    """Steady gains (q, 8) per unit of `INPUTS` from the shared free columns (zeros where only pairs were seen)."""
    gains = np.zeros((n_free, len(INPUTS)))
    if not with_free:
        return gains
    for k, (name, (unit, *_)) in enumerate(_FREE_PRIOR.items()):
        gains[:, INPUTS.index(name)] = values[k * n_free : (k + 1) * n_free] * unit
    # The level belongs to no mode in particular; the slowest holds it.
    gains[-1, INPUTS.index("constant")] = values[len(_FREE_PRIOR) * n_free] + _REFERENCE_C
    return gains


def _joint_covariance(
    episodes: Sequence[Episode], log_tau: Array, values: Array, priors: ModePriors, sign: int
) -> Array:
    """Posterior covariance of [ln τ, gains], shape (2r, 2r), with all that is estimated besides integrated out.

    The inverse of the Gauss-Newton Hessian of the negative log posterior at its maximum (Laplace's approximation).
    """
    r = log_tau.size

    def residual(at: Array) -> Array:
        design, target, _, _ = _system(episodes, at, priors, sign)
        return np.asarray(design @ values - target)

    shifts = _DERIVATIVE_STEP * np.eye(r)
    slopes = np.stack([residual(log_tau + d) - residual(log_tau - d) for d in shifts], axis=1) / (
        2.0 * _DERIVATIVE_STEP
    )
    jacobian = np.concatenate([slopes, _system(episodes, log_tau, priors, sign)[0]], axis=1)
    hessian = jacobian.T @ jacobian
    hessian[:r, :r] += np.eye(r) / priors.log_tau_sd**2
    return np.linalg.inv(hessian)[: 2 * r, : 2 * r]
