"""Runs and pairs as regressions: what is compared, what is unexplained in it, and the columns that explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.config import DEFAULT_TIME_CONSTANTS_H, IdentificationConfig
from thermoforce_mpc.identification.disturbance import disturbance_covariance
from thermoforce_mpc.identification.modes import poles, unit_responses
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Priors of the free part, per slow mode and in steady state: K per K outdoors, K per 100 W/m², K of the daily wave.
# A house follows the outdoors with a total gain near 1 and winter sun lifts it by a few kelvin.
FREE_PRIOR: dict[str, tuple[float, float, float, float]] = {
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
REFERENCE_C = 20.0
# Pairs cancel all drift; what is left is the model's own error of a few hundredths of a kelvin. It is one draw per pair
# and hour rather than one per row, so rows are taken for ten times less certain than they look.
_PAIR_SD_K = 0.3
# Rows of one run that are compared (all steps are simulated): beyond this the regression only gets slower.
_MAX_ROWS = 700
# Disturbances are taken for this many times as large as the fit found them when its certainty is told, and for no less
# than a share of what was assumed: residuals that were fitted look smaller than they are.
_ROOM, _LEAST_DISTURBED = 2.5, 0.1


@dataclass(frozen=True)
class RegressionData:
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


def run_regression(history: Record, heat_input: HeatInput, config: IdentificationConfig) -> RegressionData:
    """A run as a regression regression; silent sensor readings are left out."""
    n = history.n_steps
    stride = max(1, -(-n // _MAX_ROWS))
    rows = np.arange(0, n + 1, stride)
    rows = rows[np.isfinite(history.T_zone_C[rows])]
    return RegressionData(
        target=history.T_zone_C[rows] - REFERENCE_C,
        rows=rows,
        factor=cholesky(disturbance_covariance(history.time_s[rows], config), lower=True),
        step_s=history.step_s,
        drives=((1, heat_input(history.u, history.T_out_C[:-1])),),
        inputs=weather_inputs(history.time_s, history.T_out_C, history.solar_W_m2),
    )


def pair_regression(pair: Pair, heat_input: HeatInput) -> RegressionData:
    """A pair as a regression regression on the difference a − b."""
    difference = pair.a.T_zone_C - pair.b.T_zone_C
    rows = np.flatnonzero(np.isfinite(difference))
    rows = rows[rows > 0]
    drives = tuple((sign, heat_input(history.u, history.T_out_C[:-1])) for sign, history in ((1, pair.a), (-1, pair.b)))
    return RegressionData(
        target=difference[rows],
        rows=rows,
        factor=np.eye(rows.size) * _PAIR_SD_K,
        step_s=pair.a.step_s,
        drives=drives,
        inputs=np.empty((0, len(INPUTS))),
    )


def calibrated(regressions: Sequence[RegressionData], residual_scale: float) -> list[RegressionData]:
    """Runs with disturbances of about the size that was found, rather than as large as a cautious fit assumes.

    What a pair leaves unexplained is the model's own error, so pairs stay as they are.
    """
    return scaled(regressions, likely_scale(residual_scale))


def likely_scale(residual_scale: float) -> float:
    """How large disturbances are, as a share of what was assumed, where the fit found `residual_scale`."""
    return float(np.clip(_ROOM * residual_scale, _LEAST_DISTURBED, 1.0))


def scaled(regressions: Sequence[RegressionData], scale: float) -> list[RegressionData]:
    """Runs with disturbances `scale` times as large; pairs stay as they are."""
    return [e if e.is_pair else replace(e, factor=e.factor * scale) for e in regressions]


def forced_columns(regression: RegressionData, log_tau: Array, sign: int) -> Array:
    """Response of each compared row to a unit of [slope, G_2 … G_r], shape (rows, r), K."""
    total = sum(s * unit_responses(log_tau, regression.step_s, drive) for s, drive in regression.drives)
    return np.asarray(sign * np.asarray(total)[regression.rows])


def follows_action(regression: RegressionData, hours: float) -> NDArray[np.bool_]:
    """Which compared rows come within `hours` after a step in which something was done (differently), shape (rows,)."""
    done = np.abs(np.sum([s * drive for s, drive in regression.drives], axis=0)) > 0.0
    before = np.concatenate([[0], np.cumsum(done)])
    reach = max(1, round(hours * HOUR_S / regression.step_s))
    return np.asarray(before[regression.rows] > before[np.maximum(regression.rows - reach, 0)])


def free_columns(regression: RegressionData, log_tau: Array, free_log_tau: Array) -> tuple[Array, Array]:
    """Columns of the shared free gains and of the run's own starting state, (rows, q·7 + 1) and (rows, modes)."""
    weather = []
    for name, (unit, *_) in FREE_PRIOR.items():
        signal = regression.inputs[:, INPUTS.index(name)] * unit
        for mode in free_log_tau:
            weather.append(unit_responses(np.array([mode]), regression.step_s, signal)[:, 0] / np.exp(mode))
    shared = np.stack([*weather, np.ones(regression.inputs.shape[0] + 1)], axis=1)
    steps = np.arange(regression.inputs.shape[0] + 1)
    fastest = log_tau[:1] if log_tau.size > 1 else np.log(DEFAULT_TIME_CONSTANTS_H[3][:1])
    modes = np.concatenate([fastest, free_log_tau])
    start = poles(modes, regression.step_s)[None, :] ** steps[:, None]
    return shared[regression.rows], start[regression.rows]


def free_time_constants(log_tau: Array) -> Array:
    """ln τ of the free part's modes: the slow ones of an operator of order 3 (or of its prior), and the ground."""
    slow = log_tau[1:] if log_tau.size == 3 else np.log(DEFAULT_TIME_CONSTANTS_H[3][1:])
    return np.append(slow, np.log(_GROUND_H))


def free_prior(n_free: int) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and lower bound of the shared free columns."""
    entries = [item[1:] for item in FREE_PRIOR.values() for _ in range(n_free)] + [(0.0, _LEVEL_SD_K, -np.inf)]
    mean, sd, low = (np.array(column) for column in zip(*entries, strict=True))
    return mean, sd, low


def start_sd(n_modes: int) -> Array:
    """Prior standard deviation of a run's starting state per mode, K."""
    return np.asarray(_START_SD_K[-n_modes:])
