"""Hours of the day in which a plant's own schedule keeps an actuator off, whatever is asked of it.

An hour in which heat was asked for and none came is blocked if the actuator has worked since; one that has not is a
fault, which the watch tells. Hours after it count too as long as the zone is no better off and native control gets
nothing either. Where the plant's own loops keep room set-points, heat is asked for only while the reading is so far on
the wrong side of the set-point that a loop would act (`called_for`). Heating and cooling are two machines: what one
refuses says nothing of the other. Plans leave blocked hours out, but for the hour of now: at once where only probing
has seen them, later after some days, so that a wrong claim or a schedule that ended is noticed. A schedule that differs
by weekday is taken for one of every day; hours here and there are none. Schedules go by the clock on the wall, hours
here by seconds from a new year: after the clock is changed, what is known is moved (`moved`).

What plans do without, readings cannot contradict: who has heated before an hour has no need to ask for anything in it.
Where such an hour costs, it is asked for something once (`level_to_try`).

Where the plant reports what it was asked for, or its schedule blows cold air, no level tells: `HourEffects` compares
predictions an hour ahead with what came, by hour of the day.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record, steps_in
from thermoforce_mpc.data.clock import DAY_H, hour_at, whole_hour
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import LEVEL_EDGE
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K

# Mean level asked for over an hour from which it can be refused, and level measured from which the actuator works; the
# house that is blocked from 22:00 to 5:00 went from 13 to 7 K·h in three days with them (2026-11-26).
_ASKED, _WORKS = 0.25, 0.1
# More hours than this are no schedule, nor are more stretches of them. By judgement.
_MOST, _MOST_STRETCHES = 12, 2
# Days from which on a plan may try the hour that it begins in, though blocked: after one day of it and after more. By
# judgement: a week has each day of the week.
_AGAIN_DAYS = (0.5, 7.0)
# Distance of the reading from the set-point from which any loop acts, K: proportional bands and dead bands are less.
_CALLS_K = 0.5
# Level that is asked for to try an hour: just above what tells, since twice as much costs more than a wrong belief in a
# light house of 6 K an hour (2026-11-30).
_TRIED = 0.3
# Parts of a step that are looked up each: of a step of an hour, its quarters, since schedules begin at these.
_PARTS = 4


@dataclass(frozen=True)
class BlockedHours:
    """What is known of the hours of one actuator.

    `refused`: hour of the day and the time, s, at which it was first refused; `last_s`: the last time one was, on
    `days` days so far; `since_C`: zone temperature when heat was asked for and none came, NaN while heat comes;
    `worked_s`: when the actuator last worked.
    """

    refused: tuple[tuple[int, float], ...] = ()
    last_s: float = -math.inf
    days: int = 0
    since_C: float = math.nan
    worked_s: float = -math.inf

    @classmethod
    def known(cls, hours: Collection[int], now_s: float) -> BlockedHours:
        """Hours that were found before `now_s`, s; not confirmed yet, so that a plan may try the hour it begins in."""
        if not hours:
            return cls()
        return cls(tuple((hour, -math.inf) for hour in sorted(hours)), worked_s=now_s)

    @classmethod
    def found(cls, asked: Array, record: Record, sign: int) -> BlockedHours:
        """What a record (one zone and actuator, n steps) of levels that were `asked` for (n,), NaN for none, tells."""
        known, each = cls(), steps_in(HOUR_S, record.step_s) if record.n_steps else 1
        requests = list(zip(record.time_s[:-1].tolist(), asked.tolist(), strict=True))
        for n in range(each, record.n_steps + 1):
            known = known.after(requests[n - each : n], record.slice(n - each, n), sign)
        return known

    def moved(self, later_s: float) -> BlockedHours:
        """The same hours so much later in the day, whole hours in s."""
        hours = round(later_s / HOUR_S)
        return replace(self, refused=tuple(((hour + hours) % DAY_H, first_s) for hour, first_s in self.refused))

    @cached_property
    def hours(self) -> frozenset[int]:
        """Hours that are blocked: refused before the actuator worked again, and refused ones beside these."""
        refused = {hour for hour, _ in self.refused}
        found = {hour for hour, first_s in self.refused if first_s < self.worked_s}
        while beside := {hour for hour in refused - found if {(hour - 1) % DAY_H, (hour + 1) % DAY_H} & found}:
            found |= beside
        stretches = sum((hour - 1) % DAY_H not in found for hour in found)
        return frozenset(found) if len(found) <= _MOST and stretches <= _MOST_STRETCHES else frozenset()

    def available(self, time_s: Array, step_s: float) -> Array:
        """Share of the steps from `time_s` (n,), s, on in which heat comes, (n,), as plans count with it."""
        parts_s = time_s[:, None] + step_s * (np.arange(_PARTS) + 0.5) / _PARTS
        blocked = np.isin(whole_hour(parts_s), list(self.hours))
        if self.may_be_tried(float(time_s[0])):
            blocked &= parts_s // HOUR_S != parts_s[0, 0] // HOUR_S
        return np.asarray(1.0 - blocked.mean(axis=1))

    def may_be_tried(self, time_s: float) -> bool:
        """Whether it is so long ago that an hour was refused that the one of `time_s`, s, may come all the same."""
        return time_s - self.last_s > _AGAIN_DAYS[self.days > 1] * DAY_S

    def level_to_try(self, now_s: float, tried_s: float) -> float:
        """Level by which the hour that begins at `now_s`, s, is tried, 0 where it is not blocked or was tried lately.

        `tried_s`: when an hour was last tried. What was not answered is tried again after a week.
        """
        answered = self.last_s > tried_s
        again = answered or now_s - tried_s > _AGAIN_DAYS[1] * DAY_S
        return _TRIED if again and self.may_be_tried(now_s) and hour_at(now_s) in self.hours else 0.0

    def outside(self, asked: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
        """What was `asked` (start of the step s, level) outside blocked hours."""
        return tuple(item for item in asked if not self.hours or hour_at(item[0]) not in self.hours)

    def after(self, asked: Sequence[tuple[float, float]], history: Record, sign: int) -> BlockedHours:
        """What is known after the last step of a record (one zone and actuator), where an hour ends with it.

        `asked`: (start of the step s, mean level) of the last plans, NaN for native control; `sign`: of the actuator.
        An hour with a step whose level is not known (NaN) tells nothing.
        """
        if not hour_ends(history):
            return self
        now, steps = float(history.time_s[-1]), _steps_of_an_hour(history)
        last = history.last(steps)
        got, hour = float(np.mean(np.abs(last.u[0]))), hour_at(float(last.time_s[0]))
        levels = [level for time_s, level in asked if time_s >= last.time_s[0] - 1.0]
        if math.isnan(got):
            return self
        if got >= _WORKS:
            # A stretch without work that is longer than a schedule's is an outage: none of its hours is one, also not
            # those that are left once others have worked again.
            since = [item for item in self.refused if item[1] >= self.worked_s]
            outage = since if len(since) > _MOST else []
            kept = tuple(item for item in self.refused if item[0] != hour and item not in outage)
            return replace(self, refused=kept, since_C=math.nan, worked_s=now)
        T_C, needs = float(last.T_zone_C[0, -1]), np.abs(levels).sum() / steps >= _ASKED
        waits = not levels or not np.isfinite(levels).all()
        goes_on = waits and sign * (self.since_C - T_C) >= 0.0
        if got > LEVEL_EDGE or not (needs or goes_on):
            return self
        first = () if any(item[0] == hour for item in self.refused) else ((hour, float(last.time_s[0])),)
        return replace(
            self,
            refused=(*self.refused, *first),
            last_s=now,
            days=self.days + (now - self.last_s > 0.5 * DAY_S),
            since_C=T_C if needs and math.isnan(self.since_C) else self.since_C,
        )

    def in_words(self, what: str = "nothing") -> str:
        """The hours, for people; `what` it is that does not come."""
        starts = sorted(hour for hour in self.hours if (hour - 1) % DAY_H not in self.hours)
        spans = []
        for start in starts:
            end = next(start + n for n in range(1, DAY_H + 1) if (start + n) % DAY_H not in self.hours)
            spans.append(f"{start}:00 to {end % DAY_H}:00")
        return (
            f"{what} comes from {' and '.join(spans)}, whatever is asked for: the plant's own schedule, and plans "
            "do without these hours (controller.options.watch.blocked_hours)"
            if spans
            else "no hour is blocked by the plant's own schedule any more"
        )


# Levels from which a machine's power is compared with that of its like, the share below which it stands, and steps that
# tell what is usual. Set with the fault of `bench detectors` in which a machine stands and reports its level
# (2026-11-28).
_RUNS, _STANDS, _USUAL_STEPS = 0.25, 0.05, 8


def _steps_of_an_hour(record: Record) -> int:
    return steps_in(HOUR_S, record.step_s)


def hour_ends(record: Record) -> bool:
    """Whether an hour of the day ends with the last step of a record that holds all of it."""
    if not record.n_steps or float(record.time_s[-1]) % HOUR_S > 1.0:
        return False
    return record.n_steps >= _steps_of_an_hour(record)


def running(record: Record) -> Record:
    """A record (one zone, an actuator with a machine of its own) with level 0 where the machine stood.

    A plant may report the level that was asked for: where its meter reads next to nothing beside what it usually reads
    at such levels, nothing came. A meter that is dead or holds other loads tells nothing.
    """
    u, per_level = np.abs(record.u[0]), np.full(record.n_steps, np.nan)
    asked = np.isfinite(u) & (u >= _RUNS)
    per_level[asked] = record.power_W[0, asked] / u[asked]
    known = np.isfinite(per_level)
    if np.count_nonzero(known) < _USUAL_STEPS:
        return record
    # Of hours that stand in between the median of those above the middle says what is usual.
    usual = float(np.median(per_level[known & (per_level >= np.median(per_level[known]))]))
    stood = known & (per_level < _STANDS * usual)
    return replace(record, u=np.where(stood, 0.0, record.u)) if stood.any() else record


def called_for(asked: Array, heating_C: Array, cooling_C: Array, T_zone_C: Array) -> Array:
    """What was surely asked of an actuator in n steps (n,).

    `asked` (n,): levels. Where a step had set-points, `heating_C` and `cooling_C` (n,), else NaN, it is what the loops
    would give at the readings `T_zone_C` (n + 1,) from its start to its end: full level, below 0 for cooling, or 0.
    """
    by_loops = np.isfinite(heating_C) & np.isfinite(cooling_C)
    coldest, warmest = np.minimum(T_zone_C[:-1], T_zone_C[1:]), np.maximum(T_zone_C[:-1], T_zone_C[1:])
    calls = 1.0 * (warmest < heating_C - _CALLS_K) - 1.0 * (coldest > cooling_C + _CALLS_K)
    return np.where(by_loops, calls, asked)


# Effect of an hour's levels from which it can be missed, K, and its least share that is; in promised half-widths, at 2
# of which one error in 200 is by chance; on how many days running. An office of `bench detectors` whose mornings are
# blocked went from 8.03 to 2.42 K·h in three days with these (2026-11-28).
_TELLS_K, _MISSING, _BEYOND, _DAYS = 0.25, 0.5, 2.0, 2
# Days that are kept of each hour, besides those that told, and for how long, s. By judgement: two tries a week apart
# stand in for those that are forgotten.
_KEPT, _KEPT_S = 4, 21 * DAY_S
# Prior standard deviations of what an hour takes of the effect, and of what it does to the zone besides, K. The same
# two days tell only their sum: half of each makes plans count on less heat and begin earlier.
_SHARE_SD, _DIP_SD_K = 0.5, 1.0
# How fast a zone forgets what an hour did to it, s, as air and furniture do; the most of it that is believed, K. By
# judgement.
FORGETS_S, _MOST_DIP_K = 3 * HOUR_S, 3.0


class HourSeen(NamedTuple):
    """A prediction an hour ahead that came due at `time_s`: error (measured − predicted), predicted effect of the
    levels of the hour and promised half-width of the error, K.
    """

    time_s: float
    error_K: float
    effect_K: float
    promise_K: float

    @property
    def hour(self) -> int:
        """The hour of the day that was predicted."""
        return hour_at(self.time_s - HOUR_S)

    @property
    def tells(self) -> bool:
        """Whether it can be judged: all is finite, and something was promised."""
        return all(map(math.isfinite, self)) and self.promise_K > 0.0


@dataclass(frozen=True)
class HourLaw:
    """What an hour of the day is believed to do: `share` of the effect of acting comes, and `dip_K` besides, K."""

    share: float
    dip_K: float


@dataclass(frozen=True)
class HourEffects:
    """What predictions an hour ahead tell of the hours of the day, for one actuator with this `sign`.

    An hour is believed to differ where on two days running less than half of the effect of acting came, each time by
    more than twice the promise and 0.3 K; one day on which it comes takes that back. `seen`: the last days of each
    hour, and the last on which something was asked of it.
    """

    sign: int = 1
    seen: tuple[HourSeen, ...] = ()

    def __post_init__(self) -> None:
        """Raise `DataError` for what cannot be judged, of a file that was edited."""
        if wrong := [tuple(one) for one in self.seen if not one.tells]:
            raise DataError(
                f"hour_effects: {wrong[0]}: expected a time, s, error, effect and a promise above 0, K, all finite"
            )

    def after(self, told: HourSeen) -> HourEffects:
        """With one prediction more, where that can be judged."""
        if not told.tells:
            return self
        hour, same, others = told.hour, list[HourSeen](), list[HourSeen]()
        for one in self.seen:
            if one.hour != hour:
                others.append(one)
            elif told.time_s - one.time_s < _KEPT_S:
                same.append(one)
        # Who knows of an hour keeps out of it: days on which nothing was asked do not push out those that told.
        asked = [one for one in same[: 1 - _KEPT] if self._asked(one)]
        return replace(self, seen=(*others, *asked[-_DAYS:], *same[1 - _KEPT :], told))

    def _asked(self, one: HourSeen) -> bool:
        """Whether so much was asked of an hour that what is missing can be told."""
        return self.sign * one.effect_K >= _TELLS_K

    def at(self, now_s: float) -> HourEffects:
        """What was seen before a run, as if it had been seen in the days before `now_s`."""
        last_s = max((one.time_s for one in self.seen), default=now_s)
        later_s = (now_s - last_s) // DAY_S * DAY_S
        return replace(self, seen=tuple(one._replace(time_s=one.time_s + later_s) for one in self.seen))

    def moved(self, later_s: float) -> HourEffects:
        """The same hours so much later in the day, s."""
        return replace(self, seen=tuple(one._replace(time_s=one.time_s + later_s) for one in self.seen))

    @property
    def believed(self) -> HourEffects:
        """Only the hours that are believed to differ."""
        return replace(self, seen=tuple(one for one in self.seen if one.hour in self.laws))

    @cached_property
    def laws(self) -> dict[int, HourLaw]:
        """What the hours do that are believed to differ, by hour."""
        found, seen = {}, defaultdict[int, list[HourSeen]](list)
        for one in self.seen:
            seen[one.hour].append(one)
        for hour, of_hour in sorted(seen.items()):
            asked = list(filter(self._asked, of_hour))[-_DAYS:]
            if len(asked) == _DAYS and all(map(self._misses, asked)):
                found[hour] = self._law(of_hour)
        return found

    def _misses(self, one: HourSeen) -> bool:
        # What a thermostat keeps inside its bound needs no plan around it: in the clean office 1 of seed 62171 an hour
        # was claimed for 0.2 K (`bench detectors`, 2026-11-28).
        lacking_K = -self.sign * one.error_K
        return lacking_K > max(_BEYOND * one.promise_K, _MISSING * abs(one.effect_K), THERMOSTAT_INSIDE_K)

    def _law(self, seen: Sequence[HourSeen]) -> HourLaw:
        """The most likely law given the errors of its days, error = (share − 1) effect + dip, neither of help."""
        from scipy.optimize import lsq_linear

        _, error, effect, promise = np.array(seen).T
        rows = np.stack([effect, np.ones(effect.size)], axis=1) / promise[:, None]
        rows = np.vstack([rows, np.diag([1.0 / _SHARE_SD, 1.0 / _DIP_SD_K])])
        lowest, highest = np.sort(np.array([0.0, -self.sign * _MOST_DIP_K]))
        bounds = np.array([-1.0, lowest]), np.array([0.0, highest])
        share, dip = lsq_linear(rows, np.append(error / promise, [0.0, 0.0]), bounds).x
        return HourLaw(1.0 + float(share), float(dip))

    def over(self, start_s: float, lasts_s: float) -> bool:
        """Whether an hour that is believed to differ lies in the time from `start_s` on, s."""
        laws, hours = self.laws, range(math.ceil(lasts_s / HOUR_S))
        return bool(laws) and any(hour_at(start_s + k * HOUR_S) in laws for k in hours)

    def share(self, time_s: Array, step_s: float) -> Array:
        """Share of the effect of each step from `time_s` (n,), s, on that plans count with, (n,).

        The hour of now is tried again after some days in which nothing was asked of it.
        """
        parts_s = time_s[:, None] + step_s * (np.arange(_PARTS) + 0.5) / _PARTS
        hours, shares = whole_hour(parts_s), np.ones(parts_s.shape)
        now = parts_s // HOUR_S == parts_s[0, 0] // HOUR_S
        for hour, law in self.laws.items():
            shares[(hours == hour) & ~(self.may_be_tried(hour, float(time_s[0])) & now)] = law.share
        return np.asarray(shares.mean(axis=1))

    def may_be_tried(self, hour: int, time_s: float) -> bool:
        """Whether nothing was asked of this hour, of those believed to differ, for some days before `time_s`, s."""
        asked_s = max(one.time_s for one in self.seen if one.hour == hour and self._asked(one))
        return time_s - asked_s > _AGAIN_DAYS[1] * DAY_S

    def level_to_try(self, now_s: float, tried_s: float, effect_K: float) -> float:
        """Level by which the hour that begins at `now_s`, s, is tried, 0 where it does not differ or cannot tell.

        `tried_s`: when an hour was last tried; `effect_K`: what an hour at full level adds to the zone by the model, K.
        """
        hour, needed_K = hour_at(now_s), _TRIED / _ASKED * _TELLS_K
        waits = hour not in self.laws or now_s - tried_s < _AGAIN_DAYS[1] * DAY_S or not self.may_be_tried(hour, now_s)
        return 0.0 if waits or abs(effect_K) < needed_K else max(needed_K / abs(effect_K), _TRIED)

    def dips_K(self, time_s: Array, step_s: float) -> Array:
        """What the hours do to the zone besides, at the end of each step from `time_s` (n,), s, on, (n,), K."""
        out, left, kept = np.zeros(time_s.size), 0.0, math.exp(-step_s / FORGETS_S)
        if not self.laws:
            return out
        for k, start_s in enumerate(time_s.tolist()):
            law = self.laws.get(hour_at(start_s))
            left = kept * left + (law.dip_K * step_s / HOUR_S if law else 0.0)
            out[k] = left
        return out

    def in_words(self) -> str:
        """What is believed, for people; empty where nothing is."""
        told = []
        for hour, law in self.laws.items():
            *_, last = [one for one in self.seen if one.hour == hour and self._asked(one)]
            came_K = last.effect_K + last.error_K
            besides = f", and {law.dip_K:+.1f} K besides" if abs(law.dip_K) > 0.05 else ""
            told.append(
                f"from {hour}:00 to {(hour + 1) % DAY_H}:00 acting does {100.0 * law.share:.0f} % of what it does "
                f"else{besides} ({last.effect_K:+.1f} K were expected of it and {came_K:+.1f} K came, "
                f"where ±{last.promise_K:.1f} K was promised, and the day before likewise)"
            )
        if not told:
            return ""
        return (
            f"{'; '.join(told)}: the plant's own schedule, and plans count on that "
            "(controller.options.watch.blocked_hours)"
        )


def ahead_s(time_s: float, origin: Any) -> float:
    """How far the clock on the wall is ahead of seconds from `origin` (`Record.origin`): an hour in summer time, s."""
    if origin is None:  # of a simulated building
        return 0.0
    from thermoforce_mpc.data.dataframes import clock_s

    return float(clock_s(np.array([time_s]), origin)[0] - time_s)


Directions = tuple[BlockedHours, ...]
"""Of one actuator: what is known of its hours; where levels are signed of heating, then of cooling."""


def each_direction(asked: Array, record: Record, sign: int, *, signed: bool) -> list[tuple[Array, Record, int]]:
    """Levels asked for (n,) and the record (n steps, one actuator) as each direction of it sees them, and its sign."""
    if not signed:
        return [(asked, record, sign)]
    return [(np.maximum(way * asked, 0.0), replace(record, u=np.maximum(way * record.u, 0.0)), way) for way in (1, -1)]


def said(directions: Directions) -> str:
    """The hours of an actuator, for people."""
    if len(directions) == 1:
        return directions[0].in_words()
    told = [each.in_words(what) for each, what in zip(directions, ("no heat", "no cold"), strict=True) if each.hours]
    return "; ".join(told) or directions[0].in_words()
