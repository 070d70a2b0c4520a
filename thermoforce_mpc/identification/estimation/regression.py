"""Regression form of runs and pairs: temperatures without what others did, and what drives the forced response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.estimation.modes import unit_responses
from thermoforce_mpc.identification.estimation.records import LEAD_REACH, MOST_ROWS, Pair
from thermoforce_mpc.model.operator.heat_input import HeatInput

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
    """Return a run of one zone as a regression; missing temperatures are omitted.

    The drive is v(u), the heat capacity at the applied level, and not the measured heat that drives the forced history
    of a controlled run (`forced_history.heat_drive`). A plan knows levels only, so the gain is identified per level and
    takes up the mean error of the heat capacity; for the past the measured heat is exact, whoever controlled. The two
    drives differ by the fit error of the heat capacity, which the model card notes (below 1 % of full heat where heat
    was measured on the embedded plant).
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
    """Return a pair of one zone as a regression of the difference a − b."""
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
