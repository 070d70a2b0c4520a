"""Regression form of runs and pairs: targets, disturbance covariance, and columns of forced and free response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.config import DEFAULT_TIME_CONSTANTS_H, IdentificationConfig
from thermoforce_mpc.identification.disturbance import Disturbance
from thermoforce_mpc.identification.modes import from_filters, poles, unit_responses
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.identification.recursions import filtered
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Priors of the free part, steady state, per slow mode: K per K outdoors, K per 100 W/m², K of the daily wave. The total
# gain to the outdoor temperature is near 1; winter sun raises a house by a few K.
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
# Weak priors of the level of the free response and of each mode's initial state, K.
_LEVEL_SD_K = 50.0
_START_SD_K = (3.0, 20.0, 50.0, 50.0)
# Fixed time constant of soil and neighbouring rooms, h: too slow to identify, but not negligible.
_GROUND_H = 400.0
_DEFAULT_FREE_LOG_TAU = np.log([*DEFAULT_TIME_CONSTANTS_H[3][1:], _GROUND_H])
REFERENCE_C = 20.0
# Pairs cancel all drift; the rest is the model error of a few hundredths of a K. It is correlated over about an hour,
# so the standard deviation per row is ten times as large.
_PAIR_SD_K = 0.3
# Most rows of one run in the regression (all steps are simulated); more rows only make it slower.
_MAX_ROWS = 700
# For the reported uncertainty, disturbances are this many times the fitted residuals (which underestimate them), but at
# least this share of the assumed ones.
_ROOM, _LEAST_DISTURBED = 2.5, 0.1


@dataclass(frozen=True)
class RegressionData:
    """Run or pair in regression form.

    `target` (rows,) K; `rows` (rows,) indices of the boundaries used; `disturbance` of these rows; `inputs` (n, 8)
    weather of the steps, empty for a pair; `drives`: sign and drive v (n,) of each run. `others` (K, n): drives of the
    other actuators, signed by their sign, of a pair their difference; `other_priors` (K, 4): of their gains, see
    `OtherActuator`.
    """

    target: Array
    rows: NDArray[np.intp]
    disturbance: Disturbance
    step_s: float
    drives: tuple[tuple[int, Array], ...]
    inputs: Array
    others: Array = field(default_factory=lambda: np.empty((0, 0)))
    other_priors: Array = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def n_steps(self) -> int:
        """Number of steps of the run or pair."""
        return int(self.drives[0][1].size)

    @cached_property
    def drive(self) -> Array:
        """Drive of the run, of a pair the difference of its drives, (n,)."""
        return np.asarray(np.sum([sign * drive for sign, drive in self.drives], axis=0))

    @cached_property
    def signals(self) -> Array:
        """What drives the columns in each step (n, 1 + K + 7 + 1).

        The own drive, the others', the inputs of `FREE_PRIOR` in their units (zero for a pair), and nothing.
        """
        weather = np.zeros((self.n_steps, len(FREE_PRIOR) + 1))
        if not self.is_pair:
            for i, (name, (unit, *_)) in enumerate(FREE_PRIOR.items()):
                weather[:, i] = self.inputs[:, INPUTS.index(name)] * unit
        return np.concatenate([self.drive[:, None], self.others.reshape(-1, self.n_steps).T, weather], axis=1)

    @property
    def is_pair(self) -> bool:
        """Whether this is a difference of two runs, in which the free part cancels."""
        return self.inputs.size == 0


@dataclass(frozen=True)
class OtherActuator:
    """An actuator besides the zone's own: what it delivers, and its sign.

    Priors of its effect on the zone: standard deviations around zero, `slope_sd` of the initial slope, K/h, and
    `gain_sd` of the steady gains of the modes between, K; `slowest_rate` (mean, sd), K/h, of G_r/τ_r of the slowest of
    several modes.
    """

    heat_input: HeatInput
    sign: int
    slope_sd: float
    gain_sd: float
    slowest_rate: tuple[float, float]


def run_regression(
    history: Record,
    heat_input: HeatInput,
    config: IdentificationConfig,
    others: Sequence[OtherActuator] = (),
) -> RegressionData:
    """Return a run of one zone as a regression; missing temperatures are omitted.

    The first level of `history` is that of the zone's own actuator, the rest are those of `others`.

    The drive is v(u), the heat capacity at the applied level, and not the measured heat that drives the forced history
    of a controlled run (`forced_history.heat_drive`). A plan knows levels only, so the gain is identified per level and
    takes up the mean error of the heat capacity; for the past the measured heat is exact, whoever controlled. The two
    drives differ by the fit error of the heat capacity, which the model card notes (below 1 % of full heat where heat
    was measured on the embedded plant).
    """
    n = history.n_steps
    stride = max(1, -(-n // _MAX_ROWS))
    rows = np.arange(0, n + 1, stride)
    rows = rows[np.isfinite(history.T_zone_C[0, rows])]
    return RegressionData(
        target=history.T_zone_C[0, rows] - REFERENCE_C,
        rows=rows,
        disturbance=Disturbance.assumed(history.time_s[rows], config),
        step_s=history.step_s,
        drives=((1, heat_input(history.u[0], history.T_out_C[:-1])),),
        inputs=weather_inputs(history.time_s, history.T_out_C, history.solar_W_m2),
        others=_other_drives(history, others),
        other_priors=_other_priors(others),
    )


def _other_priors(others: Sequence[OtherActuator]) -> Array:
    return np.array([[o.slope_sd, o.gain_sd, *o.slowest_rate] for o in others]).reshape(len(others), 4)


def _other_drives(history: Record, others: Sequence[OtherActuator]) -> Array:
    """Drives of the other actuators, signed (K, n)."""
    rows = [o.sign * o.heat_input(u, history.T_out_C[:-1]) for o, u in zip(others, history.u[1:], strict=True)]
    return np.array(rows).reshape(len(others), history.n_steps)


def pair_regression(pair: Pair, heat_input: HeatInput, others: Sequence[OtherActuator] = ()) -> RegressionData:
    """Return a pair of one zone as a regression of the difference a − b; levels as in `run_regression`."""
    difference = pair.a.T_zone_C[0] - pair.b.T_zone_C[0]
    rows = np.flatnonzero(np.isfinite(difference))
    rows = rows[rows > 0]
    drives = tuple(
        (sign, heat_input(history.u[0], history.T_out_C[:-1])) for sign, history in ((1, pair.a), (-1, pair.b))
    )
    return RegressionData(
        target=difference[rows],
        rows=rows,
        disturbance=Disturbance.independent(pair.a.time_s[rows], _PAIR_SD_K),
        step_s=pair.a.step_s,
        drives=drives,
        inputs=np.empty((0, len(INPUTS))),
        others=_other_drives(pair.a, others) - _other_drives(pair.b, others),
        other_priors=_other_priors(others),
    )


def calibrated(regressions: Sequence[RegressionData], residual_scale: float) -> list[RegressionData]:
    """Return the regressions with the disturbances of runs scaled to about the size found by the fit.

    Pairs are unchanged: their residual is the model error.
    """
    return scaled(regressions, likely_scale(residual_scale))


def likely_scale(residual_scale: float) -> float:
    """Return the likely size of disturbances as a fraction of the assumed one, from the fit's `residual_scale`."""
    return float(np.clip(_ROOM * residual_scale, _LEAST_DISTURBED, 1.0))


def scaled(regressions: Sequence[RegressionData], scale: float) -> list[RegressionData]:
    """Return the regressions with disturbances of runs times `scale`; pairs are unchanged."""
    return [e if e.is_pair else replace(e, disturbance=e.disturbance.scaled(scale)) for e in regressions]


def forced_columns(regression: RegressionData, log_tau: Array, sign: int) -> Array:
    """Return the forced response of each row per unit of [slope, G_2 … G_r], shape (rows, r), K."""
    return np.asarray(sign * unit_responses(log_tau, regression.step_s, regression.drive, regression.rows))


def other_columns(regression: RegressionData, log_tau: Array) -> Array:
    """Return the response of each row to the other actuators, (rows, K r) K per unit of [slope, G_2 … G_r] of each."""
    columns = [unit_responses(log_tau, regression.step_s, drive, regression.rows) for drive in regression.others]
    return np.concatenate(columns, axis=1) if columns else np.empty((regression.rows.size, 0))


def other_prior(regression: RegressionData, log_tau: Array) -> tuple[Array, Array]:
    """Return prior mean and standard deviation of the columns of `other_columns`, shape (K r,) each."""
    K, r = regression.others.shape[0], log_tau.size
    if not K:
        return np.empty(0), np.empty(0)
    slope, gain, rate, rate_sd = regression.other_priors.T
    mean, sd = np.zeros((K, r)), np.repeat(gain[:, None], r, axis=1)
    sd[:, 0] = slope
    if r > 1:
        tau = float(np.exp(log_tau[-1]))
        mean[:, -1], sd[:, -1] = rate * tau, rate_sd * tau
    return mean.ravel(), sd.ravel()


def follows_action(regression: RegressionData, hours: float) -> NDArray[np.bool_]:
    """Return which rows lie within `hours` after a step with a nonzero drive (pair: drive difference), (rows,)."""
    done = np.abs(regression.drive) > 0.0
    before = np.concatenate([[0], np.cumsum(done)])
    reach = max(1, round(hours * HOUR_S / regression.step_s))
    return np.asarray(before[regression.rows] > before[np.maximum(regression.rows - reach, 0)])


def free_columns(regression: RegressionData, log_tau: Array) -> tuple[Array, Array]:
    """Return the columns of the shared free gains (rows, 7q + 1) and of the run's initial state (rows, q + 1)."""
    q = free_time_constants(log_tau).size
    found = all_columns(regression, log_tau)[:, -(len(FREE_PRIOR) * q + 1) - (q + 1) :]
    return found[:, : -(q + 1)], found[:, -(q + 1) :]


def all_columns(regression: RegressionData, log_tau: Array) -> Array:
    """Return the columns of all parameters (rows, p), signs of the actuators aside.

    Forced response to the own and to the other actuators, r each; of a run then those of `free_columns`.
    """
    r, K = log_tau.size, regression.others.shape[0]
    free = np.empty(0) if regression.is_pair else free_time_constants(log_tau)
    fastest = log_tau[:1] if r > 1 else np.log(DEFAULT_TIME_CONSTANTS_H[3][:1])
    signal_of, start = _filters(r, K, free.size)
    acting, weather = np.tile(log_tau, 1 + K), np.tile(free, len(FREE_PRIOR))
    level = () if regression.is_pair else ((np.inf,), fastest)
    pole = poles(np.concatenate([acting, weather, *level, free]), regression.step_s)
    states = filtered(regression.signals, signal_of, pole, start, regression.rows)
    states[:, : acting.size] = from_filters(states[:, : acting.size].reshape(-1, 1 + K, r), log_tau).reshape(
        -1, acting.size
    )
    return states


@cache
def _filters(r: int, K: int, q: int) -> tuple[NDArray[np.intp], Array]:
    """Signal and start of the filter of each column of `all_columns`, for `recursions.filtered`; a pair has q = 0."""
    signals = [*np.repeat(np.arange(1 + K), r), *np.repeat(1 + K + np.arange(len(FREE_PRIOR)), q)]
    begun = 1 + (q + 1) if q else 0  # the level, which stays, and the initial states, which decay
    signal_of = np.array(signals + [1 + K + len(FREE_PRIOR)] * begun, dtype=np.intp)
    start = np.concatenate([np.zeros(len(signals)), np.ones(begun)])
    return signal_of, start


def free_time_constants(log_tau: Array) -> Array:
    """Return ln τ of the free modes: the slow modes of an operator of order 3 (or of its prior), and the ground."""
    if log_tau.size != 3:
        return _DEFAULT_FREE_LOG_TAU
    return np.concatenate([log_tau[1:], _DEFAULT_FREE_LOG_TAU[-1:]])


@cache
def free_prior(n_free: int) -> tuple[Array, Array, Array]:
    """Return prior mean, standard deviation and lower bound of the shared free columns, shape (7q + 1,) each."""
    entries = [item[1:] for item in FREE_PRIOR.values() for _ in range(n_free)] + [(0.0, _LEVEL_SD_K, -np.inf)]
    found = np.array(entries).T
    found.setflags(write=False)  # shared by all callers
    return found[0], found[1], found[2]


def start_sd(n_modes: int) -> Array:
    """Return the prior standard deviation of a run's initial state per mode, K, shape (n_modes,)."""
    return np.asarray(_START_SD_K[-n_modes:])
