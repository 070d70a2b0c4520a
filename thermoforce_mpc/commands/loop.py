"""What a building's own loop makes of a command: the level that it answers with, learned from a record.

    u_k = o(T_zone,k) x_k,   x_k = clip(c x_{k−1} + g(s_k + h (x_{k−1} − ½)), 0, 1)
    s_k = e(command_k) − w_zone T_zone,k − w_out T_out,k − Σ_b w_b (o_b,k − ō_b)

(T_zone: of the actuator's room; of a thermostat of the whole house, of the room where it is; o_b: how far the other
valves b on the same water are open, on average ō_b.)

g and e do not fall, o is not negative, c lies in [0, 1], and h and the weights are not negative: more of a command is
never less heat, in the same step and in all later ones, whatever was learned (a warmer room shuts its valve, which
leaves more for the others). A valve with a P band has c = h = 0 (g is
its line); a thermostat that switches has h, the kelvins between where it comes on and goes off (g is the share of a
step that it is on); the integral part of a PI controller is c near 1. Without h a room that was heated up was held at
once where a thermostat lets it cool for hours: of the levels of four rooms, followed from set-points and temperatures,
.26 to .30 was missed (root mean square), .10 to .15 with it (`bench commands`, houses 9714, 9718, 9731, 2026-11-30).
What the loop does within a step, and what else moves it, is `spread`.

Where what the water is above the room is logged, a level is an open valve times that: x is then what the water gives
with the valve open, which it goes on to while its machine is off, and o how far the room's own thermostat opens it,
which falls with the room's temperature. Rooms share the water: with all valves open a machine at its limit keeps it
less warm (w_b; 0 where it has power to spare). Without w_b the bath of house 9759 of `bench commands` was said to get
.70 of a level while both other rooms heat, where it gets .55, and was cold after hours in which they had rested
(2026-11-30). Elsewhere o is 1, and x the level. As one sum, a thermostat that shuts some
hours was taken for water that gives 0.4 of a level less per kelvin of the room (true 0.1), so that what an offset
brings was soon undone (`bench commands`, houses 9503 and 9508, 2026-11-28).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.commands.command import SAME, Command, StepwiseCommand
from thermoforce_mpc.data import DAY_S, HOUR_S, NORMAL_95, Array, Plan, PlannedSaving, Record, steps_in
from thermoforce_mpc.data.series import rms, step_means
from thermoforce_mpc.errors import DataError

if TYPE_CHECKING:  # loaded only where tables are read
    import pandas as pd

# Least record of a command, and least difference that it must have made to the level, with 95 % certainty.
_LEAST_H, _LEAST_EFFECT = 72.0, 0.02
# What of the last level may be left; the least of those is taken that are nearly as good as the best.
_CARRIES, _AS_GOOD = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0), 1.05
# Kelvins between where a thermostat of a room comes on and goes off, which are tried likewise; the least of those is
# taken whose levels are as good but for so much. By judgement: with .8 K between, up to 1.5 K explain levels of a
# simulated thermostat as well to .01 (`tests/commands/test_loop.py`).
_HOLDS_K, _AS_NEAR = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5), 0.02
# What a level leaves of itself at least, where all that a command moves counts: with 1 of c, all for ever.
_LEAST_LEFT = 0.1
_BINS, _LEAST_IN_BIN = 24, 8
# Levels so near to 0 or 1 are there; rounds in which levels at an end and what is fitted are made to agree.
_AT_END, _ROUNDS = 0.005, 8
_DRAWS, _SEED = 30, 64
# Water that is less above the room heats nothing, K. The level of a kelvin of it with an open valve is this quantile of
# those of hours with heat: in most the valve is open throughout, and a few levels are cut at 1. Least hours of them.
_NO_HEAT_K, _OPEN, _LEAST_OPEN = 1.0, 0.9, 24
# A level below it, or a share of the usual one, is that of a valve that is shut.
_SHUT = 0.05
# Least standard deviation of how far another valve is open that tells what it takes of the water.
_LEAST_OPENING = 0.1
# Least standard deviation of the outdoor temperature at the same hours, K, that tells what goes by it.
_LEAST_WEATHER_K = 1.0
# Variance of levels, up to rounding, of which nothing is explained: of a valve that is shut throughout.
_NO_SCATTER = 1e-9
# Least share of the scatter of the level that the map must explain: below it, the loop follows something else. Means of
# an hour at least are compared: within it, a machine that a thermostat switches is on and off with any command.
_LEAST_R2, _COMPARED_S = 0.2, HOUR_S


@dataclass(frozen=True, eq=False)
class CommandRecord:
    """What was set: `at` the boundaries of n steps (n + 1,), and the `mean` over each step (n,); NaN: not known.

    `usual` (n + 1,): what would have been set by people; None: what was set. `over_K` (n,): what the water is above the
    room, of a level that is made of it; None: the level is not. `others` (n,): how far the other valves on the same
    water were open, by name of their actuators, NaN: not known; see `on_one_water`.
    """

    at: Array
    mean: Array
    usual: Array | None = None
    over_K: Array | None = None
    others: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class LoopMap:
    """The level that a loop answers with, see the head of this module.

    `carry` is c, `holds_K` h; `values`, `effects` (k,): e of the command, straight between; `zone`, `outdoor`: the
    weights; `knots`, `levels`, `spread`, `uncertain` (m,): s, g(s), scatter of a step's level and standard error of g,
    straight between and constant beyond what was seen. Of levels followed from the commands alone over `days`: `rmse`
    of a step's, `r2` of an hour's. `shuts_C`, `opens` (j,): the room's temperature and o(T), likewise. `of_water`:
    levels are made of what the water is above the room, so that they tell heat while its machine is off too. `others`:
    w_b and ō_b, by name of the actuators.
    """

    carry: float
    values: Array
    effects: Array
    zone: float
    outdoor: float
    knots: Array
    levels: Array
    spread: Array
    uncertain: Array
    rmse: float
    r2: float
    days: float
    shuts_C: Array = field(default_factory=lambda: np.zeros(1))
    opens: Array = field(default_factory=lambda: np.ones(1))
    of_water: bool = False
    holds_K: float = 0.0
    others: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def index(self, value: float | Array, T_zone_C: float | Array, T_out_C: float | Array) -> Array:
        """s of commands at temperatures, °C; of one shape."""
        effect = np.interp(value, self.values, self.effects)
        return np.asarray(effect - self.zone * np.asarray(T_zone_C) - self.outdoor * np.asarray(T_out_C))

    def level(
        self,
        value: float | Array,
        T_zone_C: float | Array,
        T_out_C: float | Array,
        before: float | Array,
        z: float | Array = 0.0,
    ) -> Array:
        """Mean level of a step with the command `value`, mean temperatures, °C, and x `before`; of one shape.

        `z`: how many standard errors the loop lies above what was learned. Other valves are open as on average.
        """
        return np.asarray(self.opened(T_zone_C) * self.behind(value, T_zone_C, T_out_C, before, z))

    def behind(
        self,
        value: float | Array,
        T_zone_C: float | Array,
        T_out_C: float | Array,
        before: float | Array,
        z: float | Array = 0.0,
        taken: float | Array = 0.0,
    ) -> Array:
        """x of a step, as `level`; `taken`: see there."""
        s = self.index(value, T_zone_C, T_out_C) + self.held(before) - taken
        moved = np.interp(s, self.knots, self.levels) + z * np.interp(s, self.knots, self.uncertain)
        return np.clip(self.carry * np.asarray(before) + moved, 0.0, 1.0)

    def taken(self, opened: Mapping[str, float | Array]) -> Array:
        """By how much s is less for other valves that are `opened` more than on average; of one shape."""
        more = (w * (np.asarray(opened[b]) - mean) for b, (w, mean) in self.others.items() if b in opened)
        return np.asarray(sum(more), dtype=np.float64)

    def held(self, before: float | Array) -> Array:
        """By how much s is higher after x `before`."""
        return np.asarray(self.holds_K * (np.asarray(before) - 0.5))

    def at_rest(self, value: float | Array, T_zone_C: float | Array, T_out_C: float | Array) -> Array:
        """x that a command comes to where it is held, as `level`; of a thermostat midway between on and off."""
        moved = np.interp(self.index(value, T_zone_C, T_out_C), self.knots, self.levels).clip(0.0, 1.0)
        return np.asarray(moved / max(1.0 - self.carry, _LEAST_LEFT)).clip(0.0, 1.0)

    def opened(self, T_zone_C: float | Array) -> Array:
        """o of rooms at these temperatures, °C."""
        return np.asarray(np.interp(T_zone_C, self.shuts_C, self.opens))

    def scatter(self, value: float | Array, T_zone_C: float | Array, T_out_C: float | Array) -> Array:
        """Standard deviation of the level of a step around `level`."""
        return np.asarray(np.interp(self.index(value, T_zone_C, T_out_C), self.knots, self.spread))

    @property
    def moves(self) -> float:
        """By how much the level of a usual hour differs between the least and the largest command seen."""
        half, usual = 0.5 * min(float(np.ptp(self.effects)), float(np.ptp(self.knots))), float(np.median(self.knots))
        ends = np.interp([usual - half, usual + half], self.knots, self.levels) * float(np.median(self.opens))
        return min(float(ends[1] - ends[0]) / max(1.0 - self.carry, _LEAST_LEFT), 1.0)

    @property
    def in_words(self) -> str:
        """What was learned in a few words."""
        followed = "" if self.carry == 0.0 else f", {100 * self.carry:.0f} % of the last level stays"
        followed += f", it switches {self.holds_K:g} K apart" if self.holds_K else ""
        return f"explains {100 * self.r2:.0f} % of the level's scatter over {self.days:.0f} days{followed}"


@dataclass(frozen=True, eq=False)
class LearnedCommand:
    """A command with its map, and what was set until now.

    `last`: the command (NaN: not known) at `last_s`, s, held for `held_s`; `usual` (n,): what it is when left alone, at
    the times of a week, in equal parts, from `origin` on, at 0 °C outdoors where it is `usual_per_K` more per K there.
    Seconds count from there; None: from where a plan's do.
    `machine`: name of the machine of whose actuators all are set by this one command; '': the actuator's own.
    `reference`: the room whose temperature its loop works against; '': the actuator's own.
    `untold`: why the record does not tell what it does to this actuator, '' where it does. `record`, `set_to` (n,):
    what it was learned from, where the command is a machine's, and what was set over its steps.
    """

    command: Command
    loop: LoopMap
    last: float
    held_s: float
    usual: Array
    last_s: float
    origin: pd.Timestamp | None = None
    machine: str = ""
    untold: str = ""
    record: Record | None = None
    set_to: Array | None = None
    usual_per_K: float = 0.0
    reference: str = ""

    @property
    def in_words(self) -> str:
        """What is set, and what is known of its loop."""
        where = f" in {self.reference}" if self.reference else ""
        return f"set by {self.command.name_in_words}{where}, whose map {self.loop.in_words}"

    def room_of(self, zones: Sequence[str], home: int) -> int:
        """Number, of `zones`, of the room whose temperature its loop works against; `home`: the actuator's own.

        Raises `DataError` where they do not hold it.
        """
        if not self.reference:
            return home
        if self.reference not in zones:
            raise DataError(
                f"the command's thermostat is in '{self.reference}', of which the model says nothing: identify it too"
            )
        return list(zones).index(self.reference)

    def within_seen(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Limits `low` and `high` (N,) no further than what the record holds: of more it does not say what comes of it.

        Of a set-point it does, since the difference to the room counts.
        """
        if self.command.of_zone == -1.0:
            return low, high
        least, most = float(self.loop.values[0]), float(self.loop.values[-1])
        return np.clip(low, least, most), np.clip(high, least, most)

    def from_origin_s(self, time_s: Array, origin: pd.Timestamp | None) -> Array:
        """`time_s` (N,), s from `origin`, counted from that of the record, which may have begun in another year."""
        if origin is None or self.origin is None:
            return time_s
        return np.asarray(time_s + (origin - self.origin).total_seconds())

    def usual_at(self, time_s: Array, T_out_C: Array) -> Array:
        """What the command is when it is left alone, at `time_s` (N,), s, by the clock of the zone of `origin`, and
        outdoor temperatures (N,), °C.
        """
        if self.origin is not None:
            from thermoforce_mpc.data.dataframes import clock_s

            time_s = clock_s(time_s, self.origin)
        part_s = 7.0 * DAY_S / self.usual.size
        usual = np.asarray(self.usual[np.floor(time_s / part_s + 1e-6).astype(np.intp) % self.usual.size])
        if self.usual_per_K == 0.0:
            return usual
        usual = usual + self.usual_per_K * T_out_C
        return self.command.nearest(usual) if isinstance(self.command, StepwiseCommand) else usual

    def set_at(self, time_s: Array, T_out_C: Array) -> Array:
        """What was set at `time_s` (N,), s, of a machine's command; the usual one where its record does not say."""
        out = self.usual_at(time_s, T_out_C)
        if self.record is not None and self.set_to is not None:
            at = np.floor((time_s - self.record.time_s[0]) / self.record.step_s + 1e-6).astype(np.intp)
            was = self.set_to[np.clip(at, 0, self.set_to.size - 1)]
            out = np.where((at >= 0) & (at < self.set_to.size) & np.isfinite(was), was, out)
        return out


def learn_command(
    command: Command,
    was: CommandRecord,
    T_zone_C: Array,
    T_out_C: Array,
    u: Array,
    time_s: Array,
    where: str,
    *,
    clock_s: Array | None = None,
    may_be_untold: bool = False,
) -> LearnedCommand:
    """Learn what the loop makes of `command` from a record of n steps.

    Args:
        command: the command.
        was: what was set.
        T_zone_C, T_out_C: of the room that its loop works against, and outdoors, at the boundaries (n + 1,), °C.
        u: mean level of each step (n,).
        time_s: boundaries (n + 1,), s.
        where: what it is the command of, for messages.
        clock_s: what a clock on the wall showed at `time_s` (n + 1,), s, by which habits go; default: the same.
        may_be_untold: it is enough that the record tells of another one: of a room that was never cold it tells
            nothing (`untold`, see `check_told`).

    Raises:
        DataError: the record is too short, or does not tell what the command does; says what to do.
    """
    step_s = float(time_s[1] - time_s[0])
    signals = _Signals(was.mean, step_means(T_zone_C), step_means(T_out_C), u, was.over_K, was.others)
    loop, untold = _learn_loop(command, signals, step_s, time_s, where)
    if untold and not may_be_untold:
        raise DataError(untold)
    value = was.at
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        raise DataError(f"{where}: it was never read: check its column")
    last = float(value[known[-1]])
    changed = known[np.abs(value[known] - last) > SAME]
    since = int(changed[-1]) + 1 if changed.size else int(known[0])
    held_s, now_s = float(time_s[-1] - time_s[since]), float(time_s[-1])
    usual = value if was.usual is None else was.usual
    if not np.isfinite(usual).any():
        raise DataError(f"{where}: usual: its column holds no value: check it, or give a number")
    habits_s = (time_s if clock_s is None else clock_s)[:-1]
    per_K = _usual_per_K(usual[:-1], signals.T_out_C, habits_s) if command.follows_weather else 0.0
    habits = _usual(usual[:-1] - per_K * signals.T_out_C if per_K else usual[:-1], habits_s)
    return LearnedCommand(command, loop, last, held_s, habits, now_s, untold=untold, usual_per_K=per_K)


def behind_levels(
    u: Array, learned: Mapping[int, LearnedCommand], usual: Mapping[int, float], T_zone_C: Array, T_out_C: float
) -> Array:
    """x (A,), see the head of this module, of a step with levels `u` (A,) of which nobody says by what command.

    `usual`: what is usual then, by actuator; `T_zone_C` (A,): the room of each, `T_out_C`: outdoors, °C. Of levels that
    are made of water, the most open valve of a command shows what the water is of what the usual command brings; where
    none is open, it is that.
    """
    out = np.array(u, dtype=np.float64)
    of_water = {a: one for a, one in learned.items() if one.loop.of_water}
    at_rest = {a: float(one.loop.at_rest(usual[a], T_zone_C[a], T_out_C)) for a, one in of_water.items()}
    shown: dict[str | int, float] = {}
    for a, one in of_water.items():
        share = float(u[a]) / max(at_rest[a], _SHUT)
        shown[one.machine or a] = max(share, shown.get(one.machine or a, 0.0))
    for a, one in of_water.items():
        share = shown[one.machine or a]
        out[a] = min(at_rest[a] * (share if share > _SHUT else 1.0), 1.0)
    return out


def check_told(learned: Collection[LearnedCommand]) -> None:
    """Raise `DataError` where the record tells of no command what it does."""
    if learned and all(one.untold for one in learned):
        raise DataError(next(iter(learned)).untold)


def left_alone(learned: Mapping[int, LearnedCommand]) -> dict[int, str]:
    """Why actuators, by number, are left alone: the record tells of none that their command sets what it does."""
    out: dict[int, str] = {}
    for a, one in learned.items():
        members = [each for b, each in learned.items() if b == a or (one.machine and each.machine == one.machine)]
        if all(each.untold for each in members):
            out[a] = one.untold
    return out


@dataclass(frozen=True, eq=False)
class _Signals:
    """Means over the n steps of a record (n,): command, temperatures, level, and `over_K` of `CommandRecord`."""

    value: Array
    T_zone_C: Array
    T_out_C: Array
    u: Array
    over_K: Array | None
    others: Mapping[str, Array]


def on_one_water(was: Mapping[str, CommandRecord], u: Mapping[str, Array]) -> dict[str, CommandRecord]:
    """Records of commands of one machine, by actuator, each with how far the others' valves were open.

    `u` (n,): levels of the steps. Nothing is known of levels that are not made of water.
    """
    opened: dict[str, Array] = {}
    for name, one in was.items():
        water = None if one.over_K is None else _water_levels(u[name], one.over_K, np.arange(u[name].size))
        if water is not None:
            open_share = np.minimum(u[name] / np.maximum(water[0], _SHUT), 1.0)
            opened[name] = np.where(water[0] > _SHUT, open_share, np.nan)
    return {a: replace(one, others={b: each for b, each in opened.items() if b != a}) for a, one in was.items()}


def _learn_loop(command: Command, seen: _Signals, step_s: float, time_s: Array, where: str) -> tuple[LoopMap, str]:
    """The map, and why the record does not tell what the command does, '' where it does."""
    value, u = seen.value, seen.u
    measured = np.isfinite(value) & np.isfinite(seen.T_zone_C) & np.isfinite(seen.T_out_C) & np.isfinite(u)
    follows = measured.copy()
    follows[1:] &= measured[:-1]
    follows[0] = False
    hours = follows.sum() * step_s / HOUR_S
    if hours < _LEAST_H:
        raise DataError(
            f"{where}: {hours:.0f} h of the record hold command, level and temperatures together, need {_LEAST_H:g}: "
            "check the column, or give a longer record"
        )
    day = np.floor(time_s[:-1] / DAY_S).astype(np.intp)
    rows = np.flatnonzero(follows)
    candidates = [_fit(command, rows, seen, carry) for carry in _CARRIES]
    if command.of_zone == -1.0:
        candidates += [_fit(command, rows, seen, 0.0, holds_K) for holds_K in _HOLDS_K]
    groups = _alike_days(value[rows], day[rows])
    water = None if command.of_zone == -1.0 else _by_water(seen, rows)
    behind, told = (u, rows) if water is None else (water.level, np.intersect1d(water.rows, rows))
    if water is not None:  # what of it stays, the days tell in which the command moves it
        others = told[np.isin(day[told], groups[-1])]
        told = others if others.size >= _LEAST_OPEN else told
    courses = [_followed(loop, rows, seen, measured, behind) for loop in candidates]
    rmse = [rms((behind - course)[told]) for course in courses]
    chosen = next(i for i, one in enumerate(rmse) if one <= _AS_GOOD * min(rmse[: len(_CARRIES)]))
    least = min(rmse)
    if _AS_GOOD * least < rmse[chosen]:
        chosen = next(i for i, one in enumerate(rmse) if i >= len(_CARRIES) and one <= least + _AS_NEAR)
    loop = candidates[chosen]
    error = u[rows] - (loop.opened(seen.T_zone_C) * courses[chosen])[rows]
    r2 = _explained(u[rows], error, np.floor(time_s[rows] / _COMPARED_S + 1e-6))
    rng = np.random.default_rng(_SEED)
    again = []
    for _ in range(_DRAWS):
        some = np.concatenate([rng.choice(days, days.size) for days in groups])
        again.append(np.concatenate([rows[day[rows] == one] for one in some]))
    drawn = [_fit(command, draw, seen, loop.carry, loop.holds_K) for draw in again]
    s = (_index(loop, seen)[1:] + loop.held(courses[chosen][:-1]))[rows - 1]
    uncertain = np.std([_at(one, loop) for one in drawn], axis=0)
    untold = _untold(command, loop, drawn, value[rows], seen.T_zone_C[rows], seen.T_out_C[rows], r2, where)
    spread = _by_bins(s, error**2, loop.knots) ** 0.5
    seen_for = {"rmse": rms(error), "days": hours * HOUR_S / DAY_S}
    loop = replace(loop, spread=spread, uncertain=uncertain, r2=r2, of_water=seen.over_K is not None, **seen_for)
    return loop, untold


def _explained(u: Array, error: Array, hour: Array) -> float:
    """Share of the scatter of levels (n,), as means of the same `hour` (n,), that is not in their errors (n,)."""
    _, of, count = np.unique(hour, return_inverse=True, return_counts=True)
    level, wrong = (np.bincount(of, weights=one) / count for one in (u, error))
    # Weighted by what is known of each, so that of steps of an hour or more nothing changes.
    scatter = float(np.average((level - np.average(level, weights=count)) ** 2, weights=count))
    if scatter < _NO_SCATTER:
        return 0.0
    return 1.0 - float(np.average(wrong**2, weights=count)) / scatter


def _alike_days(value: Array, day: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Days with the commands of most days, and others: of a month with three days of trials each draw has three."""
    of_day = {one: tuple(np.unique(np.round(value[day == one], 3))) for one in np.unique(day).tolist()}
    usual, _ = Counter(of_day.values()).most_common(1)[0]
    groups = [
        np.array([one for one, values in of_day.items() if (values == usual) is alike]) for alike in (True, False)
    ]
    return [group for group in groups if group.size]


def _fit(command: Command, rows: NDArray[np.intp], seen: _Signals, carry: float, holds_K: float = 0.0) -> LoopMap:
    """The map with the least squares of one-step errors in `rows`."""
    value, T_zone_C, T_out_C = seen.value, seen.T_zone_C, seen.T_out_C
    water = None if command.of_zone == -1.0 else _by_water(seen, rows)
    level, per_K = (seen.u, 0.0) if water is None else (water.level, water.per_K)
    rows = rows if water is None else water.rows
    y = level[rows] - carry * level[rows - 1]
    set_to = np.unique(np.round(value[rows], 6))
    values, effects, zone, outdoor = np.array([set_to[0], set_to[-1]]), np.array([set_to[0], set_to[-1]]), 1.0, 0.0
    others: dict[str, tuple[float, float]] = {}
    if command.of_zone != -1.0:
        kinds = [set_to[0], *set_to[1:]] if set_to.size <= 4 else [set_to[0], set_to[-1]]
        steps = [np.interp(value, kinds, np.eye(len(kinds))[i:].sum(axis=0)) for i in range(1, len(kinds))]
        rises = np.column_stack(steps or [np.zeros(value.size)])
        free = [-T for T, weight in ((T_zone_C, command.of_zone), (T_out_C, command.of_outdoor)) if weight is None]
        # A kelvin of the room is one less of the water above it; a controller with a room sensor takes more.
        less = (1.0 - carry) * per_K
        away = _away(seen, rows) if water is not None else {}
        columns = np.column_stack(
            [rises, *free, *(-x for x, _ in away.values()), np.ones(value.size), -np.ones(value.size)]
        )
        found = _between_ends(columns[rows], y, -less * T_zone_C[rows], carry * level[rows - 1])
        each, weights = found[: rises.shape[1]], list(found[rises.shape[1] :])
        values, effects = np.array(kinds), np.concatenate([[0.0], np.cumsum(each)])[: len(kinds)]
        zone = less + (float(weights.pop(0)) if command.of_zone is None else 0.0)
        outdoor = float(weights.pop(0)) if command.of_outdoor is None else 0.0
        others = {b: (float(weights.pop(0)), mean) for b, (_, mean) in away.items()}
    if values.size == 1 or values[0] == values[-1]:  # one value all the time
        values, effects = np.array([set_to[0] - 0.5, set_to[0] + 0.5]), np.array([set_to[0] - 0.5, set_to[0] + 0.5])
    nothing = np.zeros(1)
    loop = LoopMap(carry, values, effects, zone, outdoor, nothing, nothing, nothing, nothing, 0.0, 0.0, 0.0)
    loop = replace(loop, holds_K=holds_K, others=others)
    if command.of_zone == -1.0:  # the difference counts, also of commands that were never set
        loop = replace(loop, values=np.array([-1e3, 1e3]), effects=np.array([-1e3, 1e3]))
    knots, levels = _monotone(_index(loop, seen)[rows] + loop.held(level[rows - 1]), y)
    none = np.zeros(knots.size)
    loop = replace(loop, knots=knots, levels=levels, spread=none, uncertain=none)
    return loop if water is None else replace(loop, shuts_C=water.shuts_C, opens=water.opens)


def _away(seen: _Signals, rows: NDArray[np.intp]) -> dict[str, tuple[Array, float]]:
    """By how much other valves were open more than on average in `rows` (n,), nought where that is not known, and that
    average, by name; of those that were open now more and now less."""
    out = {}
    for b, opened in seen.others.items():
        known = opened[rows][np.isfinite(opened[rows])]
        if known.size and known.std() > _LEAST_OPENING:
            mean = float(known.mean())
            out[b] = np.nan_to_num(opened - mean), mean
    return out


def _index(loop: LoopMap, seen: _Signals) -> Array:
    """s of the steps of a record (n,), other valves as they were."""
    opened = {b: np.where(np.isfinite(seen.others[b]), seen.others[b], mean) for b, (_, mean) in loop.others.items()}
    return np.asarray(loop.index(seen.value, seen.T_zone_C, seen.T_out_C) - loop.taken(opened))


def _between_ends(columns: Array, y: Array, known: Array, carried: Array) -> Array:
    """Coefficients (k,), none negative, of `columns` (n, k) by least squares of y − `known`, each (n,).

    A level ends at 0 and at 1: one that is there, where `carried` (n,) with the fit is at or beyond it, says no more
    than that. Counted as it is, it is taken for little effect: an offset of −3 K in mild weather, where water of the
    curve is no warmer than the room already.
    """
    from scipy.optimize import nnls

    level, active = carried + y, np.ones(y.size, dtype=bool)
    for _ in range(_ROUNDS):
        found, _ = nnls(columns[active], (y - known)[active])
        reached = carried + known + columns @ found
        beyond = ((level <= _AT_END) & (reached <= 0.0)) | ((level >= 1.0 - _AT_END) & (reached >= 1.0))
        if (~beyond).sum() < _LEAST_IN_BIN * columns.shape[1] or (active == ~beyond).all():
            break
        active = ~beyond
    return np.asarray(found)


def _monotone(s: Array, y: Array, *, falls: bool = False) -> tuple[Array, Array]:
    """Knots (m,) and values there of what does not fall, or with `falls` not rise, with `s` and is nearest to `y`."""
    from scipy.optimize import isotonic_regression

    parts = _bins(s)
    knots, weights = (np.array([of(part) for part in parts]) for of in (lambda p: s[p].mean(), lambda p: float(p.size)))
    values = isotonic_regression([y[part].mean() for part in parts], weights=weights, increasing=not falls).x
    keep = np.concatenate([[True], np.diff(knots) > 1e-9])
    return knots[keep], np.asarray(values)[keep]


@dataclass(frozen=True, eq=False)
class _Water:
    """Levels with an open valve (n,), of which `rows` (k,) have one, `per_K` of the water above the room, and o."""

    level: Array
    rows: NDArray[np.intp]
    per_K: float
    shuts_C: Array
    opens: Array


def _by_water(seen: _Signals, rows: NDArray[np.intp]) -> _Water | None:
    """What of the levels is water, and what the open valve; None where they are not made of water, or it is not seen.

    What a command does to the water is told by all hours with an open valve, also where thermostats scatter the level.
    """
    if seen.over_K is None:
        return None
    over_K, u = seen.over_K, seen.u
    found = _water_levels(u, over_K, rows)
    if found is None:
        return None
    level, per_K = found
    heats = rows[np.isfinite(over_K[rows]) & (over_K[rows] >= _NO_HEAT_K)]
    shuts_C, opens = _monotone(seen.T_zone_C[heats], np.minimum(u[heats] / level[heats], 1.0), falls=True)
    # A shut valve's water tells nothing; nor does it warm the room that is too little above it.
    opened = np.isfinite(level[rows]) & np.isfinite(level[rows - 1]) & ((u[rows] > 0.0) | (over_K[rows] < _NO_HEAT_K))
    return _Water(level, rows[opened], per_K, shuts_C, opens)


def _water_levels(u: Array, over_K: Array, rows: NDArray[np.intp]) -> tuple[Array, float] | None:
    """Levels (n,) with an open valve by what the water is above the room, and a level per K; None: too few `rows`."""
    given = rows[np.isfinite(over_K[rows]) & (over_K[rows] >= _NO_HEAT_K) & (u[rows] > 0.0)]
    if given.size < _LEAST_OPEN:
        return None
    per_K = float(np.quantile(u[given] / over_K[given], _OPEN))
    return np.clip(per_K * over_K, 0.0, 1.0), per_K


def _bins(s: Array) -> list[NDArray[np.intp]]:
    """Rows by rising `s`: as many in each, and none wider than the range over their number, with a few in each."""
    order, widest = np.argsort(s, kind="stable"), max(float(np.ptp(s)) / _BINS, 1e-9)
    most = max(_LEAST_IN_BIN, -(-s.size // _BINS))
    parts, begin = [], 0
    for end in range(1, s.size + 1):
        count, full = end - begin, end == s.size
        wide = not full and s[order[end]] - s[order[begin]] > widest
        if full or count >= most or (wide and count >= _LEAST_IN_BIN):
            parts.append(order[begin:end])
            begin = end
    if len(parts) > 1 and parts[-1].size < _LEAST_IN_BIN:
        parts[-2:] = [np.concatenate(parts[-2:])]
    return parts


def _followed(
    loop: LoopMap, rows: NDArray[np.intp], seen: _Signals, measured: NDArray[np.bool_], behind: Array
) -> Array:
    """x (n,) that follows from the commands alone, from each gap and each beginning on, where it is `behind` (n,)."""
    s = _index(loop, seen)
    moved, out = np.interp(s, loop.knots, loop.levels), np.where(measured, behind, np.nan)
    if loop.carry == 0.0 and loop.holds_K == 0.0:
        out[rows] = np.clip(moved[rows], 0.0, 1.0)
        return out
    for k in rows:
        before = 0.0 if np.isnan(out[k - 1]) else out[k - 1]
        up = np.interp(s[k] + loop.holds_K * (before - 0.5), loop.knots, loop.levels) if loop.holds_K else moved[k]
        out[k] = min(max(loop.carry * before + up, 0.0), 1.0)
    return out


def _at(one: LoopMap, loop: LoopMap) -> Array:
    """g of another draw at the places of `loop`, by quantile where the two have weights of their own."""
    if (one.zone, one.outdoor, one.others) == (loop.zone, loop.outdoor, loop.others):
        return np.asarray(np.interp(loop.knots, one.knots, one.levels))
    places = np.linspace(0.0, 1.0, loop.knots.size)
    return np.asarray(np.interp(places, np.linspace(0.0, 1.0, one.levels.size), one.levels))


def _by_bins(s: Array, values: Array, knots: Array) -> Array:
    """Means (m,) of `values` of the rows nearest to each knot."""
    if knots.size == 1:
        return np.array([values.mean()])
    nearest = np.searchsorted(0.5 * (knots[1:] + knots[:-1]), s)
    count = np.bincount(nearest, minlength=knots.size)
    total = np.bincount(nearest, weights=values, minlength=knots.size)
    return np.where(count > 0, total / np.maximum(count, 1), values.mean())


def _untold(
    command: Command,
    loop: LoopMap,
    drawn: list[LoopMap],
    value: Array,
    T_zone_C: Array,
    T_out_C: Array,
    r2: float,
    where: str,
) -> str:
    """Why the record does not tell that more of the command is more heat; '' where it does."""
    if command.of_zone == -1.0:
        low, high = np.quantile(value - T_zone_C, (0.05, 0.95)) + np.median(T_zone_C)
    else:
        low, high = float(value.min()), float(value.max())
    if high - low <= SAME:
        return f"{where}: it was {low:g} all the time: try other values for some days, then plan"

    def effect(one: LoopMap) -> float:
        if command.of_zone == -1.0:
            middle = float(np.median(T_zone_C)), float(np.median(T_out_C))
            return float(one.level(high, *middle, 0.5) - one.level(low, *middle, 0.5))
        # In all hours, since in many of them a thermostat shuts the valve, and with what comes of it later.
        low_s, high_s = (one.index(value, T_zone_C, T_out_C) for value in (low, high))
        moved = np.interp(high_s, one.knots, one.levels) - np.interp(low_s, one.knots, one.levels)
        return float(np.mean(one.opened(T_zone_C) * moved)) / max(1.0 - one.carry, _LEAST_LEFT)

    found, error = effect(loop), float(np.std([effect(one) for one in drawn]))
    if found - NORMAL_95 * error < _LEAST_EFFECT or r2 < _LEAST_R2:
        return (
            f"{where}: the record does not tell what it does: from {low:.3g} to {high:.3g} the level changes by "
            f"{found:.2f} ± {error:.2f}, and it explains {100 * max(r2, 0.0):.0f} % of the level's scatter. Try "
            "different values at the same times of the day for some days, or check the columns of command and level"
        )
    return ""


def _usual(value: Array, time_s: Array) -> Array:
    """What a command usually is at the times of a week: the median of the same times of weeks, else of days."""
    step_s = float(time_s[1] - time_s[0])
    per_day = steps_in(DAY_S, step_s)
    place = np.floor(time_s / step_s + 1e-6).astype(np.intp)
    out = np.full(7 * per_day, np.nan)
    for of_week in range(7 * per_day):
        same = value[(place % (7 * per_day)) == of_week]
        same = same[np.isfinite(same)]
        if not same.size:
            same = value[(place % per_day) == of_week % per_day]
            same = same[np.isfinite(same)]
        # Of an even number the earlier of the two in the middle: a value that was set.
        out[of_week] = np.sort(same)[(same.size - 1) // 2] if same.size else np.nanmedian(value)
    return out


def _usual_per_K(value: Array, T_out_C: Array, time_s: Array) -> float:
    """By how much a command (n,) is more per K outdoors at the same time of the day, 0 at most; K per K.

    0 where days are all alike: what goes by the weather is then a habit of hours.
    """
    known = np.isfinite(value) & np.isfinite(T_out_C)
    _, of = np.unique(np.round(time_s[known] % DAY_S), return_inverse=True)
    count = np.bincount(of)
    away, away_K = (one - (np.bincount(of, weights=one) / count)[of] for one in (value[known], T_out_C[known]))
    if not known.any() or np.mean(away_K**2) < _LEAST_WEATHER_K**2:
        return 0.0
    return min(float(np.sum(away * away_K) / np.sum(away_K**2)), 0.0)


def command_rows(plan: Plan, commands: Mapping[str, LearnedCommand]) -> list[dict[str, Any]]:
    """The commands of a plan in the order of actuators and time, JSON types; `value` None: leave it to itself."""
    from thermoforce_mpc.data.dataframes import stamps

    rows, said = [], set()
    for of_actuator, settings in zip(plan.names.actuators, plan.settings, strict=bool(plan.settings)):
        machine = commands[of_actuator].machine if of_actuator in commands else ""
        name = machine or of_actuator
        if machine in said:  # one command for all that it feeds
            continue
        said |= {machine} - {""}
        for one in settings:
            begin, end = stamps(np.array([one.start_s, one.end_s]), plan.origin)
            command = commands[of_actuator].command
            text = "its own control" if one.value is None else command.in_words(one.value)
            row = {"actuator": name, "kind": command.kind, "from": begin.isoformat(), "until": end.isoformat()}
            value = None if one.value is None else command.as_told(one.value)
            rows.append(row | {"value": value, "unit": command.told_in, "text": text})
    return rows


USUAL_COMMANDS = "under the commands of the record's weeks"
"""What a plan in commands is compared with."""


def saving_in_words(saving: PlannedSaving, alone: str = "", currency: str = "") -> str:
    """What a plan saves, in two sentences; `alone`: what a plan in levels is compared with, '' of one in commands;
    `currency`: of its prices, '' where it is not known.
    """
    s, band = saving, f"(90 % band {saving.low:.2f} to {saving.high:.2f})"
    of = f" {currency}" if currency else ""
    if not alone and not s.gain > 0.0:
        what = f"Not set: the commands that were found would save {s.saved:.2f}{of} against leaving it alone {band}"
    elif s.low > 0.0:
        what = f"Saves {s.saved:.2f}{of} against leaving it alone {band}"
    elif s.high < 0.0:
        what = f"Costs {-s.saved:.2f}{of} more than leaving it alone (90 % band {-s.high:.2f} to {-s.low:.2f} more)"
    else:
        what = f"Whether it saves against leaving it alone is not certain: {s.saved:.2f}{of} {band}"
    peak = f" (of which a higher peak {s.peak:.2f}, {s.peak_alone:.2f})" if max(s.peak, s.peak_alone) >= 0.005 else ""
    return (
        f"{what}: cost {s.cost:.2f} instead of {s.cost_alone:.2f}{peak}, energy {s.energy_kWh:.1f} instead of "
        f"{s.energy_alone_kWh:.1f} kWh, outside the bounds {s.outside_Kh:.1f} instead of {s.outside_alone_Kh:.1f} K·h, "
        f"and what is stored at the end ({s.stored:.2f}). By the same model {alone or USUAL_COMMANDS}."
    )
