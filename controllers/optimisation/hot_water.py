"""When to charge the tank of hot water of a machine that heats either it or the rooms.

In two stages, since a charge is a whole act of the device (it begins and ends by its own rules) while the plan of the
rooms is a continuous programme. First, ways to command the tank over the horizon, up to three charges a day, are each
followed on all days of draw-off that the record holds, with what the device does by itself where the tank falls below
its own limit. Then the rooms are planned with what the most promising ways leave them of the machine: in the share of a
step that the tank is charged no level gives heat, nor takes power. The best sum is taken.

Promising is what costs least with a price of the machine's time in each step. What a level at its limit would be worth
to the rooms says too much, since other hours can do its work, and nothing says too little: ways are looked for at
shares of that price (`PRICE_SHARES`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from controllers.optimisation.plan_model import Evaluator
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.commands.command import SAME, StepwiseCommand
from thermoforce_mpc.commands.tank import LearnedTank, TankCourse, TankTarget, follow_tank
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, HotWaterPlan, Layout, energy_kWh, steps_in
from thermoforce_mpc.data.clock import whole_hour
from thermoforce_mpc.data.dataframes import clock_s, stamps
from thermoforce_mpc.data.series import step_means

# Charges a day, ways that are kept from one number of them to the next, and targets that are tried. The gap to all sets
# of charges is then 0 to 1.4 % of the rooms' cost (`bench hot-water`, three draws, 2026-11-28).
_CHARGES, _KEPT, _TARGETS = 3, 24, 3
# At which shares of that price ways are looked for. Beside all sets of up to three charges, each with its plan of the
# rooms, the sum of eight drawn tanks, prices and weathers (2026-11-28) was at most 1.4 % more, below 0.2 % in six.
PRICE_SHARES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
# Days of ten on which the tank may be below what is wanted. By judgement: one in ten, as `bench hot-water` runs it
# (2026-11-28).
_COLD_DAYS = 0.1
# What a K·h below what is wanted costs, in kelvin of the tank at the dearest price: a tank that is 1 K too cold for an
# hour is charged at any price. By judgement, as `bench hot-water` runs it (2026-11-28).
_DISCOMFORT_K = 10.0
# A change of the command costs this share of a kelvin of the tank: of ways that are alike the quieter one.
_CHANGE_K = 0.05
# A share of a step below which the rooms do not feel the tank, and longest time for which a charge is asked for, h:
# longer than a home's tank takes for all of its water.
_FELT, _LONGEST_H = 0.01, 6.0
# Commands of a tank are between ice and steam, °C: beyond, unit or map is wrong.
_SENSIBLE_C = (1.0, 98.0)


@dataclass(frozen=True, eq=False)
class TankWay:
    """One way to command a tank: `cost` with discomfort and less what is stored, and the plan as it would be told."""

    cost: float
    plan: HotWaterPlan


class HotWater:
    """The tank of a building, `tank` as learned, with a plan every `step_s` seconds."""

    def __init__(self, tank: LearnedTank, layout: Layout, step_s: float, warmer_K: float = 0.0) -> None:
        """The machine that heats it is one of `layout`; its lowest temperatures are `warmer_K` above what is wanted."""
        self.tank, self._step_s, self._warmer_K = tank, step_s, warmer_K
        self.machine = layout.names.machines.index(tank.machine)
        self._fed = layout.fed_by(self.machine)

    def begin(
        self, boundary: Boundary, origin: Any, T_C: float, is_charged: bool, told: tuple[float, float] | None
    ) -> TankWays | None:
        """What is needed for one plan over the steps of `boundary`; None where the tank's temperature is not known.

        `origin`: what seconds count from; `T_C`, `is_charged`: now; `told`: what is set now, and since when, s.
        """
        if not _SENSIBLE_C[0] < T_C < _SENSIBLE_C[1]:
            return None
        tank, N, begins = self.tank, boundary.n_steps, boundary.time_s[:-1]
        if origin is None:  # a simulated year
            bounds_C = tank.comfort.bounds_C(boundary.time_s, ("tank",), "monday")
        else:
            bounds_C = tank.comfort.bounds_at(pd.DatetimeIndex(stamps(boundary.time_s, origin)), ("tank",))
        upper_C = bounds_C[1][0]
        lower_C = np.minimum(bounds_C[0][0] + self._warmer_K, upper_C)
        at_s = clock_s(begins, origin)
        T_out_C = step_means(boundary.T_out_C)
        draws_K = tank.draws_from(float(at_s[0]), N, self._step_s)
        price = boundary.price_per_kWh[self.machine, :-1]
        known = _Known(tank, T_C, is_charged, draws_K, T_out_C, self._step_s, price, lower_C[:-1], boundary)
        # What is wanted at the end of a step is wanted from its begin on, so that the device charges before.
        wanted_C, most_C = np.maximum(lower_C[:-1], lower_C[1:]), np.minimum(upper_C[:-1], upper_C[1:])
        return TankWays(known, wanted_C, most_C, at_s, told, begins)

    def price(self, evaluator: Evaluator, problem: MPCProblem, u: Array) -> Array:
        """What a share of the machine is worth to rooms with levels `u` (A, N) in each step (N,), at most."""
        _, slopes = evaluator.slopes(evaluator.numbers(problem), u)
        moves = evaluator.shape.move_of_step
        each = slopes[:, evaluator.shape.first_steps][:, moves] / np.bincount(moves)[moves]
        return np.asarray(np.maximum(-each * u, 0.0)[list(self._fed)].sum(axis=0))

    def beside(self, problem: MPCProblem, plan: HotWaterPlan) -> MPCProblem:
        """The problem of the rooms with what the tank leaves them of the machine, and of power."""
        m, fed = self.machine, list(self._fed)
        share = np.where(plan.share > _FELT, np.minimum(plan.share, 1.0), 0.0)
        left = 1.0 - share
        shape = (len(problem.machinery.actuators), problem.n_steps)
        available = np.ones(shape) if problem.available is None else problem.available.copy()
        per_u_W, fixed_W = problem.power_per_u_W.copy(), problem.power_fixed_W.copy()
        available[fed] *= left
        per_u_W[fed] *= left
        fixed_W[m] *= left
        bend_W = None if problem.power_per_u2_W is None else problem.power_per_u2_W.copy()
        if bend_W is not None:
            bend_W[fed] *= left
        cap = problem.power_cap
        exchange = problem.exchange
        return replace(
            problem,
            available=available,
            power_per_u_W=per_u_W,
            power_fixed_W=fixed_W,
            power_per_u2_W=bend_W,
            power_cap=cap and replace(cap, limit_W=np.maximum(cap.limit_W - plan.power_W, 0.0)),
            exchange=exchange and replace(exchange, others_W=exchange.others_W + plan.power_W),
        )


@dataclass(frozen=True, eq=False)
class TankWays:
    """The ways to command a tank in one plan."""

    known: _Known
    wanted_C: Array
    most_C: Array
    clock_s: Array
    told: tuple[float, float] | None
    begins_s: Array

    def cheapest(self, price: Array) -> TankWay:
        """The way that costs least with the machine's time at `price` (N,); one leaves the tank to the device."""
        known, command = self.known, self.known.tank.command
        own = known.judged(self._usual_C[None], np.zeros((1, self.clock_s.size), dtype=bool), self._nothing, price)
        found = self._charged(price)
        # What is set is held for its least time, also against leaving the device to itself.
        is_held = False
        if self.told is not None and command is not None:
            is_held = bool(self.begins_s[0] - self.told[1] < 60.0 * command.hold_min)
        best = min(found if is_held and found else [own, *found], key=lambda one: float(one.score[0]))
        return known.told(best, own)

    @property
    def _usual_C(self) -> Array:
        return self.known.tank.usual_C[whole_hour(self.clock_s)]

    @property
    def _nothing(self) -> Array:
        return np.full((1, self.clock_s.size), np.nan)

    def _charged(self, price: Array) -> list[_Judged]:
        """Ways with up to three charges a day, as good as were found by adding one to the best of one less."""
        known, N = self.known, self.clock_s.size
        tank, command, step_s = known.tank, known.tank.command, known.step_s
        if command is None:
            return []
        by_target = isinstance(command, TankTarget)
        low, targets, most_C = self._targets() if by_target else (np.zeros(N), np.ones(1), self.most_C)
        reach_K = float(most_C.max() - self.wanted_C.min()) if by_target else tank.band_K
        longest_h = min(reach_K / max(tank.rise_K_h, 0.1), _LONGEST_H)
        each = math.ceil(max(60.0 * command.hold_min, longest_h * HOUR_S, step_s) / step_s)
        every, per_day = steps_in(HOUR_S, step_s), round(DAY_S / step_s)
        of_day = np.round(self.clock_s % DAY_S / step_s).astype(np.intp)
        # Where charges may begin, each hour of the first day, and again the day after.
        windows = np.array([((of_day - of_day[k]) % per_day) < each for k in range(0, min(N, per_day), every)])
        kept, out = np.zeros((1, N), dtype=bool), list[_Judged]()
        for _ in range(_CHARGES + 1):
            found = []
            for target in targets:
                values = np.where(kept, np.minimum(target, most_C) if by_target else 1.0, low)
                values = self._as_may_be(values)
                targets_C = values if by_target else self._usual_C + 0.0 * values
                at_once = np.zeros(values.shape, dtype=bool) if by_target else values > 0.5
                found.append(known.judged(targets_C, at_once, values, price))
            scores = np.stack([one.score for one in found])
            order = np.argsort(scores.min(axis=0), kind="stable")[:_KEPT]
            out += [found[int(np.argmin(scores[:, i]))].part(int(i)) for i in order]
            kept = np.unique((kept[order][:, None, :] | windows[None]).reshape(-1, N), axis=0)
        return out

    def _targets(self) -> tuple[Array, Array, Array]:
        """The lowest target of each step (N,), with which the device keeps what is wanted, of charges, and highest."""
        command = self.known.tank.command
        assert isinstance(command, TankTarget)
        least, most = command.within(self.wanted_C + self.known.tank.band_K, self.most_C)
        values = command.values(float(np.min(least)), float(np.max(most)))
        highest = values[np.maximum(np.searchsorted(values, most + SAME, side="right") - 1, 0)]
        low = np.minimum(values[np.minimum(np.searchsorted(values, least - SAME), values.size - 1)], highest)
        charges = values[values >= low.max() - SAME]
        picked = np.unique(np.round(np.linspace(0, charges.size - 1, _TARGETS)).astype(np.intp))
        return low, charges[picked], highest

    def _as_may_be(self, values: Array) -> Array:
        """Commands (K, N) with the least time between changes and the fastest change kept, from what is set now on."""
        command, out = self.known.tank.command, values.copy()
        assert command is not None
        hold_s, told = 60.0 * command.hold_min, self.told
        last, since = (values[:, 0].copy(), np.full(len(values), -np.inf)) if told is None else (
            np.full(len(values), told[0]), np.full(len(values), told[1]),
        )  # fmt: skip
        for k, now_s in enumerate(self.begins_s.tolist()):
            held = now_s - since < hold_s - 1e-6
            # Of many ways few were changed at different times.
            ages_s, of_way = np.unique(now_s - since, return_inverse=True)
            most = np.array([command.most_change(one) for one in ages_s])[of_way]
            wanted = np.clip(values[:, k], last - most, last + most)
            if isinstance(command, StepwiseCommand):
                wanted = np.where(most < np.inf, command.nearest(wanted), wanted)
            out[:, k] = np.where(held, last, wanted)
            since = np.where(np.abs(out[:, k] - last) > SAME, now_s, since)
            last = out[:, k]
        return out


@dataclass(frozen=True, eq=False)
class _Judged:
    """K ways: what each costs with the machine's time, without (with discomfort and less what is stored), its energy
    alone, and its course by steps."""

    score: Array
    own: Array
    cost: Array
    below_Kh: Array
    values: Array
    T_C: Array
    low_C: Array
    share: Array
    Wh: Array

    def part(self, i: int) -> _Judged:
        """One of them."""
        return _Judged(*(getattr(self, name)[i : i + 1] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class _Known:
    """What all ways have in common."""

    tank: LearnedTank
    T_C: float
    is_charged: bool
    draws_K: Array
    T_out_C: Array
    step_s: float
    price: Array
    lower_C: Array
    boundary: Boundary

    def judged(self, target_C: Array, at_once: NDArray[np.bool_], values: Array, of_rooms: Array) -> _Judged:
        """K ways by what the device makes of them, (K, N) each."""
        course: TankCourse = follow_tank(
            self.tank, self.T_C, self.is_charged, target_C, at_once, self.draws_K, self.T_out_C, self.step_s
        )
        hours = self.step_s / HOUR_S
        low_C = np.quantile(course.lowest_C, _COLD_DAYS, axis=1)
        below = (np.maximum(self.lower_C - low_C, 0.0) * hours).sum(axis=1)
        Wh = course.Wh.mean(axis=1)
        cost = (Wh / 1000.0 * self.price).sum(axis=1) - self._own_generation(Wh / hours)
        kelvin = self.tank.Wh_per_K(float(np.median(self.lower_C)), float(self.T_out_C.mean())) / 1000.0
        stored = course.T_C[:, :, -1].mean(axis=1) * kelvin * float(np.quantile(self.price, 0.25))
        dear = kelvin * max(float(self.price.max()), 1e-3)
        known = np.nan_to_num(values)
        changes = (np.abs(np.diff(known, axis=1)) > SAME).sum(axis=1)
        own, share = cost - stored + dear * (_DISCOMFORT_K * below + _CHANGE_K * changes), course.share.mean(axis=1)
        score = own + share @ of_rooms
        return _Judged(score, own, cost, below, values, course.T_C.mean(axis=1), low_C, share, Wh)

    def _own_generation(self, power_W: Array) -> Array:
        """What K ways (K, N) save since they use what would be fed in for less, (K,)."""
        b = self.boundary
        if not b.others_W.size:
            return np.zeros(len(power_W))
        spare_W = np.maximum(-np.nan_to_num(b.others_W[:-1]), 0.0)
        earns = np.nan_to_num(b.export_per_kWh[:-1]) if b.export_per_kWh.size else np.zeros(spare_W.size)
        less = np.maximum(self.price - earns, 0.0)
        used = energy_kWh(np.minimum(power_W, spare_W), self.step_s)
        return np.asarray((used * less).sum(axis=1))

    def told(self, way: _Judged, alone: _Judged) -> TankWay:
        """A way as a plan, beside the tank left alone."""
        values = tuple(None if math.isnan(one) else float(one) for one in way.values[0].tolist())
        return TankWay(
            float(way.own[0]),
            HotWaterPlan(
                command=values,
                T_C=way.T_C[0],
                low_C=way.low_C[0],
                lower_C=self.lower_C,
                share=way.share[0],
                power_W=way.Wh[0] * HOUR_S / self.step_s,
                cost=float(way.cost[0]),
                cost_alone=float(alone.cost[0]),
                below_Kh=float(way.below_Kh[0]),
                below_alone_Kh=float(alone.below_Kh[0]),
                T_now_C=self.T_C,
            ),
        )
