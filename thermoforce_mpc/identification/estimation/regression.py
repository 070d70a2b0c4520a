"""Regression form of runs and pairs: temperatures without what others did, and what drives the forced response.

Modes of a forced response in physical terms.

Of order r it has `log_tau` (r,): ln(τ/h), rising, and `gains` (r,): [slope K/h, G_2 … G_r K], the initial slope of the
step response to full level and the steady gains of all modes but the fastest. All are nonnegative (times the sign), as
the operator requires.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, NORMAL_95, Array, Record
from thermoforce_mpc.data.series import first_order
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import LEAD_REACH, MOST_ROWS, Pair
from thermoforce_mpc.model.machine.load import LACKING
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

# Times after a step to full level at which the response and its standard deviation are stored, h: twice as long each
# about, to the horizon of plans.
STEP_RESPONSE_H: tuple[int, ...] = (1, 2, 4, 8, 12, 24, 48)
EFFECT_H = 8
"""The one of these hours by which an effect is judged, h: a pre-heating lasts as long."""
DISTURBANCE_H = (1.0, 6.0, 48.0)
"""Time constants of what disturbs a room besides weather and actuators, h: people and doors, habits of a day, weather
that was not measured. A factor of seven apart, between which mixtures of two do."""

# Largest standard deviation of a logarithm that counts. By judgement: beyond, the sign is all that is known.
_MOST_OF_LOGARITHM = 1.5


def poles(log_tau: Array, step_s: float) -> Array:
    """The poles exp(−step/τ) (r,)."""
    return np.asarray(np.exp(-step_s / HOUR_S / np.exp(log_tau)))


def unit_responses(log_tau: Array, step_s: float, drive: Array, rows: NDArray[np.intp] | None = None) -> Array:
    """Forced response to `drive` (n,) per unit of each gain, (n + 1, r), K; only `rows` where they are given.

    Row t is the state before step t, starting from zero.
    """
    a, zero = poles(log_tau, step_s), np.zeros(log_tau.size)
    lags = np.vstack([zero, first_order(a, (1.0 - a) * drive[:, None], zero)])
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
        of the logarithm is meant, of which a band of `NORMAL_95` about the response holds 90 %.
        """
        out: dict[str, float] = {}
        for hours, mean_K, sd_K in zip(STEP_RESPONSE_H, self.step_K, self.sd_K, strict=True):
            both_K = float(np.hypot(sd_K, level_sd * mean_K))
            if of_logarithm and mean_K > 0.0:
                both_K = mean_K * _half_band(min(both_K / mean_K, _MOST_OF_LOGARITHM)) / NORMAL_95
            out[f"step_response_{hours}h_K"] = float(mean_K)
            out[f"step_response_{hours}h_sd_K"] = both_K
        return out


def _half_band(log_sd: float) -> float:
    """Half of the band about 1 that holds 90 % of a log-normal with median 1 and `log_sd`, the sd of its logarithm.

    Beyond 1 it holds all that is below, so that less is needed above.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    def lacking(half: float) -> float:
        below = ndtr(np.log1p(-half) / log_sd) if half < 1.0 else 0.0
        return float(ndtr(np.log1p(half) / log_sd) - below - (2.0 * ndtr(NORMAL_95) - 1.0))

    most = float(np.expm1(NORMAL_95 * log_sd))
    return float(brentq(lacking, 0.0, most)) if most > 0.0 else 0.0


HELD_OUT_SHARE = 0.25
"""Share of the rows of a run, or of the start times of pairs, that is held out: the usual quarter."""
# Share of the rows before these that is as many as are held out: what is compared is alike.
_SHARE_BEFORE = HELD_OUT_SHARE / (1.0 - HELD_OUT_SHARE)


@dataclass(frozen=True)
class RegressionData:
    """Run or pair in regression form.

    `target` (rows,): °C, of a pair the difference, K; `rows` (rows,) indices of the boundaries used; `drives`: sign and
    drive v (n,) of each run; `histories`: their records. `held`: how many of the last rows are held out, so that a fit
    does not see them. `others` (K,): of the other actuators, in the order of their levels, which `target` is without.
    `air_K` (n,): what air that came in through windows did to the room in each step, K; None: not known.
    """

    target: Array
    rows: NDArray[np.intp]
    step_s: float
    drives: tuple[tuple[int, Array], ...]
    histories: tuple[Record, ...] = ()
    held: int = 0
    others: tuple[OperatorParameters, ...] = ()
    air_K: Array | None = None

    @property
    def seen(self) -> int:
        """How many of the first rows a fit sees."""
        return self.rows.size - self.held

    def first(self, n: int) -> RegressionData:
        """The first `n` rows, of which none is held out."""
        return replace(self, target=self.target[:n], rows=self.rows[:n], held=0)

    @property
    def n_steps(self) -> int:
        """Number of steps of the run or pair."""
        return int(self.drives[0][1].size)

    @cached_property
    def drive(self) -> Array:
        """Drive of the run, of a pair the difference of its drives, (n,)."""
        return np.asarray(np.sum([sign * drive for sign, drive in self.drives], axis=0))

    def effect(self, log_tau: Array, gains: Array, sign: int) -> Array:
        """What the own actuator did, K, at each row, by [slope, G_2 … G_r] (r,)."""
        return np.asarray(sign * unit_responses(log_tau, self.step_s, self.drive, self.rows) @ gains)

    @property
    def is_pair(self) -> bool:
        """Whether this is a difference of two runs, in which the free part cancels."""
        return len(self.drives) == 2


def run_regression(history: Record, heat_input: HeatInput) -> RegressionData:
    """A run of one zone as a regression; missing temperatures are omitted.

    The drive is v(u), not the measured heat that drives the forced history of a controlled run
    (`forced_state.heat_drive`): a plan knows levels only, so the gain is identified per level and takes up the mean
    error of the heat law, which the model card notes.
    """
    rows = np.arange(0, history.n_steps + 1, _stride(history.n_steps, HOUR_S / history.step_s))
    rows = rows[np.isfinite(history.T_zone_C[0, rows])]
    drives = ((1, _drive(history, 0, heat_input)),)
    return RegressionData(history.T_zone_C[0, rows], rows, history.step_s, drives, (history,))


def _stride(n_steps: int, hour: float) -> int:
    """Every how many steps a run has a row; `hour`: steps in an hour.

    Rows little less than an hour apart would leave predictions an hour ahead no row to begin from: the last but one is
    out of reach.
    """
    stride, closer = max(1, -(-n_steps // MOST_ROWS)), max(1, int(0.5 * LEAD_REACH * hour))
    return closer if closer < stride < hour else stride


def _drive(history: Record, i: int, heat_input: HeatInput) -> Array:
    """v of the `i`-th actuator (n,): that of its level, but of the meter where others left it little of its machine."""
    T_out_C = history.T_out_C[:-1]
    drive = heat_input(history.u[i], T_out_C)
    if len(history.u) == 1 or heat_input.law is None:
        return drive
    metered = heat_input.of_meter(np.abs(history.heat_W[i]), T_out_C)
    return np.where(metered < LACKING * drive, metered, drive)


def pair_regression(pair: Pair, heat_input: HeatInput) -> RegressionData:
    """A pair of one zone as a regression of the difference a − b."""
    difference = pair.a.T_zone_C[0] - pair.b.T_zone_C[0]
    rows = np.flatnonzero(np.isfinite(difference))
    rows = rows[rows > 0]
    both = (1, pair.a), (-1, pair.b)
    drives = tuple((sign, _drive(history, 0, heat_input)) for sign, history in both)
    return RegressionData(difference[rows], rows, pair.a.step_s, drives, (pair.a, pair.b))


def without_others(
    regression: RegressionData, heat_inputs: Sequence[HeatInput], signs: Sequence[int], log_tau: Array, gains: Array
) -> RegressionData:
    """The regression without what the other actuators (K,) did, by their [slope, G_2 … G_r] (K, r).

    Their levels are the last K of each record.
    """
    target = np.array(regression.target)
    for of_run, history in zip((1, -1), regression.histories, strict=False):
        for i, (heat_input, sign, gain) in enumerate(zip(heat_inputs, signs, gains, strict=True), start=1):
            drive = of_run * sign * _drive(history, i, heat_input)
            target -= unit_responses(log_tau, regression.step_s, drive, regression.rows) @ gain
    step_s, operators = regression.step_s, []
    for heat_input, sign, gain in zip(heat_inputs, signs, gains, strict=True):
        a, of_step = in_steps(log_tau, gain, step_s)
        operators.append(linear_operator(a, sign * of_step, step_s=step_s, sign=sign, heat_input=heat_input))
    return replace(regression, target=target, others=tuple(operators))


def held_out(regressions: Sequence[RegressionData], config: IdentificationConfig) -> list[RegressionData]:
    """Hold out the last part of every run, and all pairs of some start times.

    Pairs with the same start share their weather, so they are held out together.
    """
    starts = sorted({_start_s(e) for e in regressions if e.is_pair})
    held: set[float] = set()
    if len(starts) > 1:
        rng = np.random.default_rng(config.seed)
        count = max(1, min(len(starts) - 1, round(HELD_OUT_SHARE * len(starts))))
        held = {starts[i] for i in rng.permutation(len(starts))[:count]}
    found = []
    for e in regressions:
        if e.is_pair and len(starts) > 1:
            found.append(replace(e, held=e.rows.size if _start_s(e) in held else 0))
        else:
            found.append(_last_held(e, HELD_OUT_SHARE))
    return found


def before_held_out(regressions: Sequence[RegressionData], config: IdentificationConfig) -> list[RegressionData]:
    """The regressions as they were before their held-out rows, with as many of the last rows held out anew.

    Of runs, those with held-out rows; where there are none, of pairs: those that are not held out are divided as
    `held_out` divides all. Empty where nothing can be held out anew.
    """
    runs = [_last_held(e.first(e.seen), _SHARE_BEFORE) for e in regressions if e.seen and e.held and not e.is_pair]
    return runs or held_out(seen_rows(regressions), config)


def seen_rows(regressions: Sequence[RegressionData]) -> list[RegressionData]:
    """The rows that are not held out."""
    return [e.first(e.seen) for e in regressions if e.seen]


def _start_s(regression: RegressionData) -> float:
    return float(regression.histories[0].time_s[0])


def _last_held(regression: RegressionData, share: float) -> RegressionData:
    n = regression.rows.size
    return replace(regression, held=n - max(1, min(n - 1, round(n * (1.0 - share)))))
