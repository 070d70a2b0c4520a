"""Errors of predictions of held-out rows from every row some hours before them, with known weather.

The free part is predicted as its Kalman filter does, given the temperatures until the start (`estimation.rest`). The
weather alone is the same with the free part that was fitted as if the actuator did nothing, so that the comparison is
fair. All starts share one Cholesky factor: with C = L Lᵀ and w = L⁻¹ r, the part of r_j that the rows before i do not
predict is Σ_{k=i…j} L_jk w_k.

Comparison of two models on blocks of held-out rows.

Errors of rows within a few hours are correlated (one cloud, one meal), so a block of 4 h counts as one observation.
Block errors differ widely in size, so models are compared by a paired t-test on the logarithm of the sum of squared
residuals per block. Predictions many hours ahead overlap, so that blocks are correlated too: the variance of the mean
then has their autocovariances (Bartlett weights), and the quantile is that of Kiefer and Vogelsang (2005, table 1),
which counts that these are estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, NORMAL_90, Array
from thermoforce_mpc.data.limits import SENSOR_STEP_K
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import LEAD_REACH
from thermoforce_mpc.identification.estimation.regression import RegressionData, in_steps
from thermoforce_mpc.identification.estimation.rest import Rest, rest_of
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.blocked_hours import HourSeen, ahead_s
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

BLOCK_H, LEAST_BLOCKS = 4.0, 4
"""Length of a block, h, in which errors of emitters and air die out, and least number of blocks: of fewer no variance
is known."""
# Floor added to squared residuals before the logarithm: errors of 0 by rounding.
_NOTHING = 1e-9
# Offset that keeps block numbers of different regressions apart: four centuries of blocks, so that none meet.
PER_REGRESSION = 10**6
# How many times what the other steps of an hour miss a step with air in it may miss of what acting does: in hours that
# are believed to differ (`machine.blocked_hours`) half of it is missing at least, and all of it at most.
_MORE_OF_IT = 2.0
# A standard deviation over the median of what is normal without its sign: 1 over its quantile of 0.75.
_MAD_SD = 1.4826
# Quantiles by one-sided probability: polynomials in b, the reach of the autocovariances as a share of the blocks
# (Kiefer and Vogelsang 2005, Bartlett's weights).
_FIXED_B: dict[float, tuple[float, float, float, float]] = {
    0.90: (1.2816, 1.3040, 0.5135, -0.3386),
    0.95: (1.6449, 2.1859, 0.3142, -0.3427),
    0.975: (1.9600, 2.9694, 0.4160, -0.5324),
    0.99: (2.3263, 4.1618, 0.5368, -0.9060),
}


def block_numbers(regression: int, rows: NDArray[np.intp], step_s: float) -> NDArray[np.intp]:
    """Return the block number of each of `rows` (n,) of regression number `regression`, shape (n,)."""
    return np.asarray(regression * PER_REGRESSION + (rows * step_s / HOUR_S // BLOCK_H), dtype=np.intp)


def standard_errors_saved(
    residuals: Array, other: Array, blocks: NDArray[np.intp], overlap: int = 0
) -> tuple[float, int]:
    """Return the t statistic for `other` having smaller residuals than `residuals`, both (n,), and the block count.

    `overlap`: so many blocks before it go with a block. The statistic is NaN with fewer than 4 blocks.
    """
    names, block = np.unique(blocks, return_inverse=True)
    n = int(names.size)
    if n < LEAST_BLOCKS:
        return float("nan"), n
    saved = np.log(np.bincount(block, residuals**2) + _NOTHING) - np.log(np.bincount(block, other**2) + _NOTHING)
    mean = float(np.mean(saved))
    away = saved - mean
    if overlap:
        lags = np.arange(1, _reach(n, overlap))
        together = [away[lag:] @ away[:-lag] for lag in lags]
        variance = float(away @ away + 2.0 * (1.0 - lags / _reach(n, overlap)) @ together) / n
    else:
        variance = float(away @ away) / (n - 1)
    if variance <= 0.0:
        return (float(np.copysign(np.inf, mean)) if mean else 0.0), n
    return mean / float(np.sqrt(variance / n)), n


def quantile(count: int, probability: float, overlap: int = 0) -> float:
    """What the statistic of `count` blocks exceeds by chance with 1 − `probability`: one of 0.9, 0.95, 0.975, 0.99."""
    from scipy.special import stdtrit

    if not overlap:
        return float(stdtrit(max(count - 1, 1), probability))
    return float(np.polynomial.polynomial.polyval(_reach(count, overlap) / max(count, 1), _FIXED_B[probability]))


def is_significant(statistic: float, count: int, probability: float, overlap: int = 0) -> bool:
    """Return whether the t statistic of `count` blocks exceeds its quantile at this probability."""
    return count >= LEAST_BLOCKS and statistic > quantile(count, probability, overlap)


def _reach(count: int, overlap: int) -> int:
    """From which distance of blocks on no autocovariance is counted."""
    return min(overlap + 1, max(count, 1))


@dataclass(frozen=True)
class Fold:
    """A fit of what the own actuator does, and what it has not seen: the held-out rows of `regressions`.

    Attributes:
        log_tau, gains: of the own actuator (r,): ln(τ/h), and [slope K/h, G_2 … G_r K], positive.
        sign: +1 if it heats, −1 if it cools.
        heat_input: what it delivers, by the rows that the fit has seen.
        free: free part of the zone, None without runs; `alone`: that of a fit as if the actuator did nothing.
        modulated: what the actions did by the network, K, at the rows of each regression; None where m = 1.
    """

    regressions: Sequence[RegressionData]
    log_tau: Array
    gains: Array
    sign: int
    heat_input: HeatInput
    free: RcParameters | None
    alone: RcParameters | None
    modulated: Sequence[Array] | None = None

    @property
    def judged(self) -> list[int]:
        """Which regressions are judged: the runs with held-out rows; where there are none, the pairs."""
        held = [i for i, e in enumerate(self.regressions) if e.held]
        return [i for i in held if not self.regressions[i].is_pair] or held

    @property
    def effects(self) -> Sequence[Array]:
        """What the actions did, K, at the rows of each regression."""
        if self.modulated is not None:
            return self.modulated
        return [e.effect(self.log_tau, self.gains, self.sign) for e in self.regressions]

    def operator(self, config: IdentificationConfig) -> OperatorParameters:
        """The operator with m = 1, at the step of the data."""
        step_s = self.regressions[0].step_s
        poles, gains = in_steps(self.log_tau, self.gains, step_s)
        return linear_operator(
            poles,
            self.sign * gains,
            step_s=step_s,
            sign=self.sign,
            gamma=config.gamma,
            hidden=config.hidden,
            heat_input=self.heat_input,
        )

    @cached_property
    def rests(self) -> list[Rest]:
        """What is left of each regression without the effects."""
        return [rest_of(e, self.free) for e in self.regressions]

    @property
    def held_out_h(self) -> float:
        """The held-out hours that are judged."""
        judged = [self.regressions[i] for i in self.judged]
        return sum(float(e.rows[-1] - e.rows[e.seen]) * e.step_s / HOUR_S for e in judged)


@dataclass(frozen=True)
class HeldOutErrors:
    """Held-out errors of one lead time, run by run: of model, weather alone and persistence, (n,) each, K.

    `blocks` (n,): block numbers; `solar` (n,): mean irradiance over the lead time, W/m².
    """

    model: Array
    weather: Array
    persistence: Array
    blocks: NDArray[np.intp]
    solar: Array

    @classmethod
    def joined(cls, parts: Sequence[HeldOutErrors]) -> HeldOutErrors:
        """Errors of several parts, one after another."""
        return cls(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls)))


def errors_of(fold: Fold, leads_h: Sequence[float], block_h: float, number: int = 0) -> dict[float, HeldOutErrors]:
    """Held-out errors of a fold by lead time. Blocks of its regressions are numbered from `number` on."""
    runs, effects = [], fold.effects
    for i in fold.judged:
        e = fold.regressions[i]
        weather = _Innovations.of(rest_of(e, fold.alone), e.target)
        runs.append((e, _Innovations.of(fold.rests[i], e.target - effects[i]), weather))
    return {
        hours: HeldOutErrors.joined([_errors(number + i, *run, hours, block_h) for i, run in enumerate(runs)])
        for hours in leads_h
    }


def hours_seen(fold: Fold, operator: OperatorParameters, gain_sd: float) -> list[HourSeen]:
    """What each full hour of the runs tells of the effect of its levels, predicted from the temperatures before it.

    `operator` at the step of the data; `gain_sd`: relative standard deviation of the effect of an hour. The promise is
    what most hours err by: an hour that differs must not excuse itself. A window is opened for minutes, a plant's
    schedule goes on: what falls in a step with air in it is of acting as far as the rest of the hour shows it.
    """
    found: list[HourSeen] = []
    effects = fold.effects
    for i, e in enumerate(fold.regressions):
        steps = round(HOUR_S / e.step_s)
        if e.is_pair or abs(steps * e.step_s - HOUR_S) > 1.0:
            continue
        time_s = e.histories[0].time_s[e.rows]
        starts = np.flatnonzero(np.abs((time_s + 1.0) % HOUR_S - 1.0) < 1.0)
        targets = np.searchsorted(e.rows, e.rows[starts] + steps)
        there = targets < e.rows.size
        starts, targets = starts[there], targets[there]
        whole = e.rows[targets] - e.rows[starts] == steps
        starts, targets = starts[whole], targets[whole]
        if not starts.size:
            continue
        errors = _Innovations.of(fold.rests[i], e.target - effects[i]).ahead(starts, targets)
        impulse = operator.impulse(steps)[::-1]
        of_hour = np.array([float(impulse @ e.drive[row : row + steps]) for row in e.rows[starts]])
        if e.air_K is not None:
            air_K = [e.air_K[row : row + steps] for row in e.rows[starts]]
            errors = np.array([_of_acting(*hour) for hour in zip(errors, air_K, of_hour, strict=True)])
        usual = NORMAL_90 * _MAD_SD * float(np.median(np.abs(errors)))
        promise = np.hypot(max(usual, SENSOR_STEP_K), NORMAL_90 * gain_sd * of_hour)
        clock_s = time_s[targets] + ahead_s(float(time_s[-1]), e.histories[0].origin)  # of a schedule on the wall
        found += [HourSeen(*map(float, row)) for row in zip(clock_s, errors, of_hour, promise, strict=True)]
    return found


def _of_acting(error_K: float, air_K: Array, effect_K: float) -> float:
    """The error of an hour without what came in with air, K, but for what acting may have missed in these steps.

    `air_K` (n,): what came in with each step, `effect_K`: of the levels of the hour, K.
    """
    aired = air_K[air_K != 0.0]
    if not aired.size:
        return error_K
    rest_K, others = error_K - float(air_K.sum()), air_K.size - aired.size
    most_K = np.full(aired.size, abs(effect_K) / air_K.size)
    if others:
        most_K = np.clip(_MORE_OF_IT * np.sign(aired) * rest_K / others, 0.0, most_K)
    return rest_K + float(np.clip(aired, -most_K, most_K).sum())


class _Innovations(NamedTuple):
    """What a reading says beyond those before it: w (rows,), standard deviations, and L (rows, rows), K."""

    white: Array
    factor: Array

    @classmethod
    def of(cls, rest: Rest, left: Array) -> _Innovations:
        """Those of temperatures `left` (rows,) without effects, K."""
        return cls(rest.white(left - rest.mean), rest.factor)

    def ahead(self, starts: NDArray[np.intp], targets: NDArray[np.intp]) -> Array:
        """Errors (n,) of the predictions from `starts` to `targets`, K."""
        rows = zip(starts + 1, targets, strict=True)
        return np.array([self.factor[j, i : j + 1] @ self.white[i : j + 1] for i, j in rows])


def _errors(
    number: int, e: RegressionData, model: _Innovations, weather: _Innovations, hours: float, block_h: float
) -> HeldOutErrors:
    """Errors at held-out rows, each predicted from the last row `hours` or more before it."""
    solar, rows = e.histories[0].solar_W_m2, e.rows
    starts, targets = _held_out(e, hours)
    at = rows * e.step_s / HOUR_S
    sun = np.array([solar[rows[i] : rows[j] + 1].mean() for i, j in zip(starts, targets, strict=True)])
    blocks = number * PER_REGRESSION + ((at[targets] - at[e.seen]) // block_h).astype(np.intp)
    persistence = e.target[targets] - e.target[starts]
    predicted, alone = model.ahead(starts, targets), weather.ahead(starts, targets)
    return HeldOutErrors(predicted, alone, persistence, np.asarray(blocks, dtype=np.intp), sun)


def _held_out(e: RegressionData, hours: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Starts and targets (n,) of the predictions `hours` ahead of the held-out rows."""
    at = e.rows * e.step_s / HOUR_S
    starts = np.searchsorted(at, at[e.seen :] - hours + 1e-9, side="right") - 1
    targets = np.arange(e.seen, at.size)
    # Where the sensor was silent there may be no row that far before: such a target is left out.
    near = (starts >= 0) & (at[targets] - at[np.maximum(starts, 0)] <= LEAD_REACH * hours + 1e-9)
    return starts[near], targets[near]
