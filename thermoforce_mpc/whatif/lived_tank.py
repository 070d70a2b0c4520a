"""A tank of hot water while a record is lived through again: as its model has it, under what was set and under plans.

What was drawn is what the record's temperatures show, so that both courses begin where the tank was, lose and give what
it did, and differ by what is set alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.commands.tank import CELLAR_C, LearnedTank, TankRecord, TankTarget, follow_tank
from thermoforce_mpc.data import HOUR_S, Array, Record, steps_in
from thermoforce_mpc.data.clock import whole_hour
from thermoforce_mpc.data.dataframes import clock_s, stamps
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import DataError

# Least share of the time in which the temperature of a tank was measured; without, nobody knows what was drawn.
_LEAST_KNOWN = 0.9


@dataclass(frozen=True)
class TankState:
    """A tank at an instant: its temperature, °C, and whether it is charged."""

    T_C: float
    is_charged: bool


@dataclass(frozen=True)
class TankPart:
    """What a tank did in a part of a step: mean power, W, share of it that it was charged, K·h below what is wanted."""

    power_W: float
    share: float
    below_Kh: float


class LivedTank:
    """The tank of machine `m` over the n steps of a record.

    Attributes:
        share, power_W: of each step (n,), as it was: share that it was charged, and what its machine took, W.
    """

    def __init__(self, tank: LearnedTank, logged: TankRecord, record: Record) -> None:
        """`logged`: over the times of `record`. Raises `DataError` where its temperature was never measured."""
        self.tank, self.m = tank, record.names.machines.index(tank.machine)
        parts = steps_in(record.step_s, logged.step_s)
        self._part_s, n = record.step_s / parts, record.n_steps
        self._at_s = record.time_s[0] + self._part_s * np.arange(n * parts + 1)
        known = np.isfinite(logged.T_C)
        self._known_s = logged.time_s[known]
        self._logged_every_s = logged.step_s
        if not known.any():
            raise DataError(f"the temperature of the tank of {tank.machine} was never measured")
        self._T_C = np.interp(self._at_s, logged.time_s[known], logged.T_C[known])
        self._T_out_C = np.interp(self._at_s, record.time_s, record.T_out_C)
        charged = logged.share_of(self._at_s)
        self._charged = charged
        self.share = charged.reshape(n, parts).mean(axis=1)
        self.power_W = _means(logged.time_s, logged.power_W, record.time_s)
        hours = self._part_s / HOUR_S
        gained_K = charged * tank.rise_at(self._T_out_C[:-1]) * hours
        self._charge_W = (gained_K * tank.Wh_per_K(self._T_C[:-1], self._T_out_C[:-1])).reshape(n, parts).sum(axis=1)
        self._charge_W *= HOUR_S / record.step_s
        lost_K = tank.loss_1_h * (self._T_C[:-1] - CELLAR_C) * hours
        # Steps of the sensor up are no water that comes back.
        drawn_K = np.cumsum(gained_K - lost_K - np.diff(self._T_C))
        self._drawn_K = np.append(0.0, np.maximum.accumulate(np.maximum(drawn_K, 0.0)))
        self._usual_C = tank.usual_C[whole_hour(clock_s(self._at_s[:-1], record.origin))]
        self._set = _held(logged, self._at_s[:-1])
        self._lower_C = _wanted_C(tank, self._at_s, record.origin)

    def check(self, begin_s: float, end_s: float) -> None:
        """Raise `DataError` where its temperature was not measured in most of the time from `begin_s` to `end_s`."""
        readings = np.count_nonzero((self._known_s >= begin_s) & (self._known_s <= end_s))
        share = readings * self._logged_every_s / (end_s - begin_s)
        if share < _LEAST_KNOWN:
            raise DataError(
                f"the temperature of the tank of {self.tank.machine} was measured in {100 * share:.0f} % of the time "
                f"that is lived through, need {100 * _LEAST_KNOWN:.0f}: take hot_water out of the map, or other days"
            )

    @property
    def charge_W(self) -> Array:
        """What charges took over each step (n,), as they were, by the law, W."""
        return self._charge_W

    def at(self, time_s: float) -> TankState:
        """The tank as it was."""
        k = min(self._index(time_s), self._charged.size - 1)
        return TankState(float(np.interp(time_s, self._at_s, self._T_C)), bool(self._charged[max(k - 1, 0)] > 0.0))

    def lived(
        self, before: TankState, time_s: float, seconds: float, command: float | None
    ) -> tuple[TankState, TankPart]:
        """`seconds` from `time_s` on; `command`: None as it was set."""
        n = steps_in(seconds, self._part_s)
        edges = time_s + seconds * np.arange(n + 1) / n
        at = np.minimum([self._index(one) for one in edges[:-1]], self._charged.size - 1)
        target_C, at_once = self._targets(at, command)
        drawn_K = np.diff(np.interp(edges, self._at_s, self._drawn_K))
        T_out_C = np.interp(edges[:-1], self._at_s, self._T_out_C)
        course = follow_tank(
            self.tank, before.T_C, before.is_charged, target_C[None], at_once[None], drawn_K[None], T_out_C, seconds / n
        )
        below_K = np.maximum(self._lower_C[at] - course.lowest_C[0, 0], 0.0)
        part = TankPart(
            power_W=float(course.Wh.sum()) * HOUR_S / seconds,
            share=float(course.share.mean()),
            below_Kh=float(below_K.mean()) * seconds / HOUR_S,
        )
        return TankState(float(course.T_C[0, 0, -1]), bool(course.is_charged[0, 0])), part

    def stored_kWh(self, state: TankState) -> float:
        """What a tank holds, electric, above that of no warmth at all; only differences mean something."""
        return state.T_C * float(self.tank.Wh_per_K(float(np.mean(self._T_C)), self.tank.T_out_mean_C)) / 1000.0

    def _index(self, time_s: float) -> int:
        return int((time_s - self._at_s[0]) / self._part_s + 1e-6)

    def _targets(self, at: NDArray[np.intp], command: float | None) -> tuple[Array, NDArray[np.bool_]]:
        """Target of the device, °C, and whether it charges at once."""
        told = self._set[at] if command is None else np.full(at.size, command)
        if isinstance(self.tank.command, TankTarget):
            return np.where(np.isfinite(told), told, self._usual_C[at]), np.zeros(at.size, dtype=bool)
        return self._usual_C[at], np.nan_to_num(told) > 0.5


def _held(logged: TankRecord, at_s: Array) -> Array:
    """What was set at times (n,), NaN where that is not known."""
    last = np.searchsorted(logged.time_s, at_s + 1e-6, side="right") - 1
    return np.where(last >= 0, logged.command[np.maximum(last, 0)], np.nan)


def _means(time_s: Array, values: Array, grid_s: Array) -> Array:
    """Means of `values` between `time_s` over the steps of `grid_s`; NaN where a part of one is not known."""
    known = np.isfinite(values)
    covered = (grid_s[:-1] >= time_s[0] - 1e-6) & (grid_s[1:] <= time_s[-1] + 1e-6)
    whole = (means_between(time_s, ~known, grid_s) * np.diff(grid_s) < 1e-6) & covered
    return np.where(whole, means_between(time_s, np.where(known, values, 0.0), grid_s), np.nan)


def _wanted_C(tank: LearnedTank, time_s: Array, origin: Any) -> Array:
    """Lowest temperature that is wanted from each of `time_s` (n + 1,) on, but for the last (n,)."""
    if origin is None:
        return np.asarray(tank.comfort.bounds_C(time_s[:-1], ("tank",), "monday")[0][0])
    return np.asarray(tank.comfort.bounds_at(pd.DatetimeIndex(stamps(time_s[:-1], origin)), ("tank",))[0][0])
