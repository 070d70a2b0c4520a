"""What a command does on its machine's meter beside what levels take: hot water, water to be warmed, machines off.

    meter_k = law(u_k) + base(hour) + Σ_s [ a_s x_s + b_s x_s (law(u_k) + base) + c_s y_s + d_s z_s ]

x_s is the share of a step in a state s of a contact other than the usual one, or by how much a number is above the
usual one; y_s and z_s follow it within hours and within most of a day, so that what is put off comes later and what
was stored is saved then. An ordered machine charges its tank once (a and −c), and needs no charge for hours (−d); what
stays for good is a share of the power, so that a + c + d is next to nought. Where a state takes next to no power the
machine is off in it, while rooms are still warmed: then the meter shows that, z is what of the habit of the hours had
to wait, and c and d what comes later. All is linear, learned from the days in which the command was another one than
usual, with priors of nought: of what was not tried nothing is known, and the errors say so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.commands.command import SAME, Command, StepwiseCommand
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, steps_in
from thermoforce_mpc.data.clock import whole_hour
from thermoforce_mpc.data.series import first_order, rms

# How fast what follows a command follows, s: water and buffers; a tank from one charge to the next.
_LAGS_S = (1.5 * HOUR_S, 8.0 * HOUR_S)
_EACH = 2 + len(_LAGS_S)
# Prior standard deviations, as shares of the mean power: of an effect, and of a number's; of what stays of it for
# good; of the share of the power itself, of a state with less heat than usual (a machine may be off) and with more.
_PRIOR, _OF_WATER, _STAYS, _LESS, _MORE = 1.0, 0.1, 0.02, 1.0, 0.03
# Share of the power that a kelvin of water takes, mean and standard deviation. By Carnot 1 / lift, 2 to 3 %, but a
# machine that gives less heat runs longer, and takes its fixed part for longer: house 9501 of `bench commands` takes no
# less at 3 K less (2026-11-28).
_PER_K = (0.01, 0.015)
# Standard deviation of what a kelvin outdoors does to the share of the power that levels do not take. Where all days
# are alike, hours and weather cannot be told apart, and what goes by the weather is no habit of hours.
_OUTDOORS = 0.03
# What waited while a machine was off comes within so long, s, this share of it more or less; most that waits, s; hours
# of the day with the least of it.
_LATER_S, _LATER_SD, _LONGEST_S, _QUIET = 0.75 * HOUR_S, 0.5, DAY_S, 6
# Least steps with another command than usual; share of the usual power below which a machine is off in a state.
_LEAST_STEPS, _OFF = 6, 0.1
# What follows a plan is looked at for so long, s.
_AFTER_S = DAY_S
# Share of the scatter of the meter, by hours within a day, that two courses of the same day do not have in common:
# when a machine runs and a tank is charged goes with small differences.
_NOT_COMMON = 1.0
# Error of the form, as a share of what commands do on the meter: plans every 8 h of houses 421 and 9210 of `bench
# commands` by SG-Ready (2026-11-28) were off by 0.25, of 9741 by 0.35, of 9961, which costs next to nothing, by 0.85
# (five each, 2026-11-30); of a tank that charges at its own hours 0.1 (`tests/commands/test_meter.py`).
_FORM = 0.4
# Error of what levels cost, beyond all that, as a share of the root of what a plan moves of it times all of it. Hours
# that are as they were left alone are as wrong in both; those that are moved are each wrong by itself, so that errors
# grow with the root of how many there are. 31 plans of 8 houses of `bench commands` (seeds 9741, 9742, 9961 to 9964,
# 9971, 9972; offset, set-points and SG-Ready, 2026-11-30) were off by 1.09 of what all errors say, and 94 % of 90 %
# bands hold, 14 % of the cost wide; with a flat 0.055 of the cost 19 %, of plans by offset 17 % for 7.
_OF_MOVED = 0.07
_ROUNDS = 3
# Largest correlation of the errors of two steps that is believed.
_MOST_CORRELATED = 0.95


@dataclass(frozen=True, eq=False)
class MeterRecord:
    """What a command was over n steps, beside its machine's meter.

    `value`, `usual` (n,): set, and when left alone; `law_W`, `power_W` (n,): by levels, and metered, NaN where it is
    not known; `T_out_C` (n,); `clock_s` (n,): what a clock on the wall showed, s.
    """

    value: Array
    usual: Array
    law_W: Array
    power_W: Array
    T_out_C: Array
    clock_s: Array
    step_s: float


@dataclass(frozen=True, eq=False)
class CourseState:
    """What of commands in S courses is still to follow: `lagged` (2, K, S) of each signal within hours and later, as a
    share; `waits_Wh` (J, S): what had to wait, by state in which the machine is off.
    """

    lagged: Array
    waits_Wh: Array


@dataclass(frozen=True, eq=False)
class MeterCourse:
    """Commands by what they move: `columns` (p, S, N) of each effect over steps, `after_h` (p, S) after the last.

    `is_on` (S, N): share of each step in which the machine may run, `gives` (S, N): share of its levels' heat that is
    made then; `off_W` (S, N): mean power of the rest. `after`: what a course goes on from.
    """

    columns: Array
    after_h: Array
    is_on: Array
    gives: Array
    off_W: Array
    after: CourseState


@dataclass(frozen=True, eq=False)
class MeterEffect:
    """What was learned, see the head of this module.

    `states` (K,): of a contact, without the usual one `usual`; none of a number, which counts in `unit`s. `off_W` (K,):
    power in those in which the machine is off, W, NaN in others. `mean` (p,),
    `root` (p, p): of the effects, W, and a root of their covariance; `base_W` (24,); `scatter_W` (days, 24): of the
    meter around all this, without its means of days.
    """

    states: Array
    usual: float
    unit: float
    off_W: Array
    mean: Array
    root: Array
    level_W: float
    base_W: Array
    scatter_W: Array

    @property
    def off_states(self) -> tuple[float, ...]:
        """States in which the machine is off."""
        return tuple(self.states[np.isfinite(self.off_W[: self.states.size])].tolist())

    @property
    def shows_a_charge(self) -> bool:
        """Whether its machine clearly takes more at first in a state beyond the usual one: it charges a tank."""
        at_first = slice(0, _EACH * self.states.size, _EACH)
        sure = self.mean[at_first] > np.sqrt((self.root[at_first] ** 2).sum(axis=-1))
        return bool((sure & (self.states > self.usual)).any())

    def drawn(self, z: Array) -> Array:
        """Effects (S, p) by standard normal numbers (S, p)."""
        return np.asarray(self.mean + z @ self.root.T)

    def begin(self, value: float, usual: float, held_s: float, clock_s: float) -> CourseState:
        """Where a course (S = 1) begins at `clock_s`: `value` was set for `held_s`, s."""
        was = _signals(np.full((1, 1), value), np.full(1, usual), self.states, self.unit)[..., 0]
        lagged = np.stack([was * (1.0 - float(np.exp(-held_s / lag_s))) for lag_s in _LAGS_S])
        held_h = min(held_s, _LONGEST_S) / HOUR_S
        n = max(1, round(4.0 * held_h))
        ago_s = (np.arange(n) + 0.5) * held_h / n * HOUR_S
        waits_W = np.maximum(_above_least(self.base_W), 0.0)[whole_hour(clock_s - ago_s)]
        return CourseState(lagged, was[np.isfinite(self.off_W)] * waits_W.mean() * held_h)

    def course(
        self,
        values: Array,
        usual: Array,
        part_s: float,
        parts: int,
        law_W: Array,
        clock_s: Array,
        before: CourseState,
        left: float = 0.0,
    ) -> MeterCourse:
        """What commands `values` (S or 1, P) do in parts of `part_s` s, `parts` of them a step.

        `usual` (P,): when left alone; `law_W` (S, N): of the levels; `clock_s` (N,): where steps begin; `before`: see
        `begin`; `left`: share of a level that warm water still gives while the machine is off, see `left_of`.
        """
        signals = _signals(values, usual, self.states, self.unit)
        waits_W = _above_least(self.base_W)[np.repeat(whole_hour(clock_s), parts)]
        is_off = np.isfinite(self.off_W)
        follow, end = _following(signals, waits_W, is_off, part_s, before)
        x, *follow = [one.reshape(*one.shape[:-1], -1, parts).mean(axis=-1) for one in (signals, *follow)]
        is_on = 1.0 - np.einsum("ksn,k->sn", x, is_off.astype(np.float64))
        columns = np.stack(np.broadcast_arrays(x, x * (law_W + self.level_W), *follow), axis=1)
        columns[~is_off] *= is_on
        columns[is_off, :-1] *= is_on  # what waited follows only while the machine may run
        shape = columns.shape[2:]
        columns = columns.reshape(-1, *shape)
        after_h = np.broadcast_to(self.after_h(end), columns.shape[:2])
        off_W = np.einsum("ksn,k->sn", x, np.nan_to_num(self.off_W))
        # Levels are means of steps, which hold already that next to nothing comes while it is off.
        gives = is_on / np.maximum(is_on + (1.0 - is_on) * left, 1e-9)
        return MeterCourse(columns, after_h, is_on, gives, off_W, end)

    def after_h(self, end: CourseState) -> Array:
        """For how long each effect goes on after courses that end so, h (p, S); of what had to wait, Wh."""
        shares = zip(end.lagged, _LAGS_S, strict=True)
        last = [lagged * lag_s / HOUR_S * (1.0 - np.exp(-_AFTER_S / lag_s)) for lagged, lag_s in shares]
        last[-1][np.isfinite(self.off_W)] = end.waits_Wh
        nothing = np.zeros_like(last[0])
        return np.stack([nothing, nothing, *last], axis=1).reshape(-1, nothing.shape[-1])

    def power_W(self, course: MeterCourse, effects: Array, law_W: Array, clock_s: Array) -> Array:
        """Power beside the law (S, N) in steps that begin at `clock_s` (N,), by `effects` (S or 1, p).

        What the meter shows is never below nought.
        """
        W = np.einsum("psn,sp->sn", course.columns, np.broadcast_to(effects, (len(law_W), effects.shape[-1])))
        base_W = self.base_W[whole_hour(clock_s)]
        return np.maximum(course.gives * law_W + course.is_on * base_W + W + course.off_W, 0.0) - law_W


def off_commands(learned: LearnedCommand, meter: MeterEffect | None) -> tuple[float, ...]:
    """Commands with which the machine is off, so that no heat comes, however open its valve is.

    None where levels are made of the water, which tells what it still gives.
    """
    return () if meter is None or learned.loop.of_water else meter.off_states


def left_of(learned: LearnedCommand, meter: MeterEffect, usual: float, T_zone_C: float, T_out_C: float) -> float:
    """Share of a usual level that is left in the first step in which the machine is off, rooms at `T_zone_C`."""
    off, loop = meter.off_states, learned.loop
    if not off or not loop.of_water:
        return 0.0
    before = float(loop.at_rest(usual, T_zone_C, T_out_C))
    return float(loop.behind(off[0], T_zone_C, T_out_C, before)) / max(before, 1e-9)


def share_on(values: Array, off: tuple[float, ...]) -> Array:
    """Share of a step in which the machine may run, with commands (S, n) in its parts, (S,); `off`: `off_commands`."""
    is_off = np.abs(values[..., None] - np.array(off)) <= SAME
    return np.asarray(1.0 - is_off.any(axis=-1).mean(axis=-1))


def beyond_sd(moved: float, by_levels: float, cost: float, by_chance: float) -> float:
    """Standard deviation of what a day costs more or less than is said, beyond errors of effects, currency.

    `moved`: what commands do on meters; `by_levels`: what levels cost more in some hours and less in others, together,
    of the `cost` of all when the building is left alone; `by_chance`: see `chance_sd`, currency.
    """
    of_levels = _OF_MOVED**2 * by_levels * max(cost, 0.0)
    return float(np.sqrt(by_chance**2 + (_FORM * moved) ** 2 + of_levels))


def chance_sd(scatter_W: Array, price: Array, clock_s: Array, step_s: float) -> float:
    """Standard deviation, currency, of what two courses of the same hours cost by when a machine runs and charges.

    `scatter_W` (days, 24): see `scatter_of_days`; `price` (N,): per kWh, at `clock_s` (N,).
    """
    if len(scatter_W) < 2:
        return 0.0
    at = whole_hour(clock_s)
    by_hour = np.array([price[at == h].mean() if (at == h).any() else price.mean() for h in range(24)])
    of_day = scatter_W @ (by_hour - by_hour.mean()) / 1000.0
    return float(_NOT_COMMON * np.std(of_day) * np.sqrt(price.size * step_s / DAY_S))


def learn_meter(command: Command, seen: MeterRecord) -> MeterEffect | None:
    """What the record tells; None where the command was hardly ever another one than usual, or nothing was metered."""
    known = np.isfinite(seen.value) & np.isfinite(seen.power_W) & np.isfinite(seen.law_W) & np.isfinite(seen.T_out_C)
    usual = float(np.median(seen.usual))
    states, unit = np.empty(0), 1.0
    if isinstance(command, StepwiseCommand):
        unit = float(np.nanmax(np.abs(seen.value - seen.usual), initial=0.0))
    else:
        set_to = np.unique(np.round(seen.value[np.isfinite(seen.value)], 6))
        states = set_to[np.abs(set_to - usual) > 0.5]
    if not unit > 0.0 or not (isinstance(command, StepwiseCommand) or states.size):
        return None
    value = np.where(np.isfinite(seen.value), seen.value, seen.usual)
    signals = _signals(value[None], seen.usual, states, unit)[:, 0]
    if (known & (np.abs(signals) > 0.1).any(axis=0)).sum() < _LEAST_STEPS:
        return None
    others = known & (np.abs(signals) < 0.1).all(axis=0)
    if not others.any():
        return None
    level_W = float(np.mean((seen.power_W - seen.law_W)[others]))
    off_W = np.array([_off_W(seen.power_W, known & (x > 0.9), others) for x in signals])
    off_W = off_W if states.size else np.full(len(signals), np.nan)
    known &= (signals[np.isfinite(off_W)] < 0.1).all(axis=0)
    law_W = np.nan_to_num(seen.law_W) + level_W
    hours = whole_hour(seen.clock_s)
    left_W = seen.power_W - seen.law_W
    base_W = np.array(
        [left_W[others & (hours == h)].mean() if (others & (hours == h)).any() else level_W for h in range(24)]
    )
    is_off = np.isfinite(off_W)
    nothing = CourseState(np.zeros((len(_LAGS_S), len(signals), 1)), np.zeros((int(is_off.sum()), 1)))
    follow, _ = _following(signals[:, None], _above_least(base_W)[hours], is_off, seen.step_s, nothing)
    columns = np.stack([signals, signals * law_W, *(one[:, 0] for one in follow)], axis=1).reshape(-1, value.size)
    outdoors = seen.T_out_C - np.mean(seen.T_out_C[known])
    design = np.vstack([columns, (hours == np.arange(24)[:, None]).astype(np.float64), outdoors[None]]).T[known]
    left_W, mean_W = left_W[known], max(float(np.mean(seen.power_W[known])), 1.0)
    prior = np.zeros((design.shape[1],) * 2)
    prior[-25:-1, -25:-1] = 1e-9 * np.eye(24)
    prior[-1, -1] = (_OUTDOORS * mean_W) ** -2.0
    expected = np.zeros(design.shape[1])
    for i in range(len(signals)):
        of = slice(_EACH * i, _EACH * (i + 1))
        if np.isfinite(off_W[i]):  # what comes later alone
            prior[of, of] = np.diag([1e6, 1e6, (_PRIOR * mean_W) ** -2.0, _LATER_SD**-2.0])
            expected[of.stop - 1] = 1.0
            continue
        share = _LESS if states.size and states[i] < usual else _MORE
        if not states.size and command.of_flow:
            expected[of.start + 1], share = _PER_K[0] * unit, _PER_K[1] * unit
        stays = np.array([1.0, 0.0, *[1.0] * len(_LAGS_S)])
        prior[of, of] = np.outer(stays, stays) / (_STAYS * mean_W) ** 2
        # A number moves the water of the rooms, of which levels tell most; a state may charge a tank.
        sd_W = mean_W * (_PRIOR if states.size else _OF_WATER)
        prior[of, of] += np.diag([sd_W**-2.0, share**-2.0, *[sd_W**-2.0] * len(_LAGS_S)])
    error_W = float(np.std(left_W)) or 1.0
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(design.T @ design / error_W**2 + prior)
        found = inverse @ (design.T @ left_W / error_W**2 + prior @ expected)
        error = left_W - design @ found
        error_W = _of_a_step(error)
    p = len(columns)
    every = np.full(known.size, np.nan)
    every[known] = error
    scatter = scatter_of_days(every, seen.clock_s, seen.step_s)
    root = np.asarray(np.linalg.cholesky(inverse[:p, :p] + 1e-12 * np.eye(p)), dtype=np.float64)
    return MeterEffect(states, usual, unit, off_W, found[:p], root, level_W, found[p : p + 24], scatter)


def _off_W(power_W: Array, rows: NDArray[np.bool_], others: NDArray[np.bool_]) -> float:
    """Mean power of a state's `rows` (n,) where the machine is off in it, W; NaN where it is not, or for too few."""
    if rows.sum() < _LEAST_STEPS or np.median(power_W[rows]) > _OFF * np.median(power_W[others]):
        return float("nan")
    return float(np.median(power_W[rows]))


def _signals(value: Array, usual: Array, states: Array, unit: float) -> Array:
    """By how much commands (S, n) are others than usual (n,): (K, S, n), of each state, or of a number in `unit`s."""
    if not states.size:
        return np.asarray((value - usual) / unit)[None]
    return np.asarray(np.maximum(1.0 - np.abs(value[None] - states[:, None, None]), 0.0))


def _above_least(by_hour_W: Array) -> Array:
    """Power by hour of the day (24,) above its least: of what people use, such as hot water."""
    return np.asarray(by_hour_W - np.sort(by_hour_W)[:_QUIET].mean())


def _following(
    signals: Array, waits_W: Array, is_off: NDArray[np.bool_], step_s: float, before: CourseState
) -> tuple[list[Array], CourseState]:
    """What follows `signals` (K, S, n) within hours and later, (K, S, n) each, and where they end.

    Of states in which the machine is off the second is the power of what waited, W. `waits_W` (n,): what people use by
    habit.
    """
    means, ends = [], []
    for lag_s, lagged in zip(_LAGS_S, before.lagged, strict=True):
        mean, end = _lagged(signals, step_s, lag_s, lagged)
        means.append(mean)
        ends.append(end)
    hours, shares = step_s / HOUR_S, 1.0 - float(np.exp(-step_s / _LATER_S))
    off, later = signals[is_off], np.empty(signals[is_off].shape)
    stored_Wh = np.broadcast_to(before.waits_Wh, off.shape[:-1])
    for k in range(signals.shape[-1]):
        x = off[..., k]
        comes_Wh = (1.0 - x) * shares * stored_Wh
        later[..., k] = comes_Wh / hours
        stored_Wh = stored_Wh - comes_Wh + x * np.maximum(waits_W[k], 0.0) * hours
    means[-1][is_off] = later
    return means, CourseState(np.stack(ends), stored_Wh)


def _lagged(signals: Array, step_s: float, lag_s: float, before: Array) -> tuple[Array, Array]:
    """Means over steps of what follows `signals` (K, S, n) within `lag_s`, from `before` (K, S) on, and at the end."""
    left = float(np.exp(-step_s / lag_s))
    before = np.broadcast_to(before, signals.shape[:-1])
    ends = first_order(np.array([left]), (1.0 - left) * signals[..., None], before[..., None])[..., 0]
    begins = np.concatenate([before[..., None], ends[..., :-1]], axis=-1)
    return signals + (begins - signals) * lag_s / step_s * (1.0 - left), ends[..., -1]


def _of_a_step(error: Array) -> float:
    """Standard deviation that a step counts with, whose errors (n,) follow one another (first-order autoregression)."""
    sd = max(rms(error), 1e-3)
    correlation = float(np.clip(np.mean(error[1:] * error[:-1]) / sd**2, 0.0, _MOST_CORRELATED))
    return sd * float(np.sqrt((1.0 + correlation) / (1.0 - correlation)))


def scatter_of_days(error: Array, clock_s: Array, step_s: float) -> Array:
    """Errors (n,) of steps that begin at `clock_s` (n,) as means of the hours of whole days (days, 24), each day's mean
    taken away; of days with an hour without any that is known (NaN) none."""
    of_hour, day = whole_hour(clock_s), np.arange(error.size) // steps_in(DAY_S, step_s)
    out = []
    for one in np.unique(day):
        rows = (day == one) & np.isfinite(error)
        sums, counts = (np.bincount(of_hour[rows], weights=w, minlength=24) for w in (error[rows], None))
        if (counts > 0).all():
            out.append(sums / counts - np.mean(sums / counts))
    return np.array(out).reshape(-1, 24)
