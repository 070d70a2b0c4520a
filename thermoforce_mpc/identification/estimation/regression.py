"""Regression form of runs and pairs: temperatures without what others did, and what drives the forced response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.modes import unit_responses
from thermoforce_mpc.identification.estimation.records import LEAD_REACH, MOST_ROWS, Pair
from thermoforce_mpc.model.operator.heat_input import HeatInput

HELD_OUT_SHARE = 0.25
"""Share of the rows of a run, or of the start times of pairs, that is held out."""
# Share of the rows before these that is as many.
_SHARE_BEFORE = HELD_OUT_SHARE / (1.0 - HELD_OUT_SHARE)
# Share of the heat of its level below which an actuator, one of several, was not given all of it.
_SERVED = 0.8


@dataclass(frozen=True)
class RegressionData:
    """Run or pair in regression form.

    `target` (rows,): °C, of a pair the difference, K; `rows` (rows,) indices of the boundaries used; `drives`: sign and
    drive v (n,) of each run; `histories`: their records. `held`: how many of the last rows are held out, so that a fit
    does not see them.
    """

    target: Array
    rows: NDArray[np.intp]
    step_s: float
    drives: tuple[tuple[int, Array], ...]
    histories: tuple[Record, ...] = ()
    held: int = 0

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
    return np.where(metered < _SERVED * drive, metered, drive)


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
    return replace(regression, target=target)


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
