"""Hours of the day in which a plant's own schedule keeps an actuator off, whatever is asked of it.

An hour in which heat was asked for and none came is blocked if the actuator has worked since; one that has not is a
fault, which the watch tells. Hours after it count too as long as the zone is no better off and native control gets
nothing either. Where the plant's own loops keep room set-points, heat is asked for only while the reading is so far on
the wrong side of the set-point that a loop would act (`called_for`). Heating and cooling are two machines: what one
refuses says nothing of the other. Plans leave blocked hours out, but for the hour of now: at once where only probing
has seen them, later after some days, so that a wrong claim or a schedule that ended is noticed. A schedule that differs
by weekday is taken for one of every day; hours here and there are none.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record

# Mean level asked for over an hour from which it can be refused, and levels measured: up to the first nothing came,
# from the second on the actuator works.
_ASKED, _NOTHING, _WORKS = 0.25, 0.02, 0.1
# More hours than this are no schedule, nor are more stretches of them.
_MOST, _MOST_STRETCHES = 12, 2
# Days from which on a plan may try the hour that it begins in, though blocked: after one day of it and after more.
_AGAIN_DAYS = (0.5, 7.0)
# Distance of the reading from the set-point from which any loop acts, K: proportional bands and dead bands are less.
_CALLS_K = 0.5
# Parts of a step that are looked up each.
_PARTS = 4
_HOURS = 24


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
        known, each = cls(), max(1, round(HOUR_S / record.step_s)) if record.n_steps else 1
        requests = list(zip(record.time_s[:-1].tolist(), asked.tolist(), strict=True))
        for n in range(each, record.n_steps + 1):
            known = known.after(requests[n - each : n], record.slice(n - each, n), sign)
        return known

    @cached_property
    def hours(self) -> frozenset[int]:
        """Hours that are blocked: refused before the actuator worked again, and refused ones beside these."""
        refused = {hour for hour, _ in self.refused}
        found = {hour for hour, first_s in self.refused if first_s < self.worked_s}
        while beside := {hour for hour in refused - found if {(hour - 1) % _HOURS, (hour + 1) % _HOURS} & found}:
            found |= beside
        stretches = sum((hour - 1) % _HOURS not in found for hour in found)
        return frozenset(found) if len(found) <= _MOST and stretches <= _MOST_STRETCHES else frozenset()

    def available(self, time_s: Array, step_s: float) -> Array:
        """Share of the steps from `time_s` (n,), s, on in which heat comes, (n,), as plans count with it."""
        parts_s = time_s[:, None] + step_s * (np.arange(_PARTS) + 0.5) / _PARTS
        blocked = np.isin(parts_s % DAY_S // HOUR_S, list(self.hours))
        if time_s[0] - self.last_s > _AGAIN_DAYS[self.days > 1] * DAY_S:
            blocked &= parts_s // HOUR_S != parts_s[0, 0] // HOUR_S
        return np.asarray(1.0 - blocked.mean(axis=1))

    def outside(self, asked: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
        """What was `asked` (start of the step s, level) outside blocked hours."""
        return tuple(item for item in asked if _hour(item[0]) not in self.hours)

    def after(self, asked: Sequence[tuple[float, float]], history: Record, sign: int) -> BlockedHours:
        """What is known after the last step of a record (one zone and actuator), where an hour ends with it.

        `asked`: (start of the step s, mean level) of the last plans, NaN for native control; `sign`: of the actuator.
        An hour with a step whose level is not known (NaN) tells nothing.
        """
        now, steps = float(history.time_s[-1]), max(1, round(HOUR_S / history.step_s)) if history.n_steps else 0
        if not steps or history.n_steps < steps or now % HOUR_S > 1.0:
            return self
        last = history.last(steps)
        got, hour = float(np.mean(np.abs(last.u[0]))), _hour(float(last.time_s[0]))
        levels = [level for time_s, level in asked if time_s >= last.time_s[0] - 1.0]
        if math.isnan(got):
            return self
        if got >= _WORKS:
            kept = tuple(item for item in self.refused if item[0] != hour)
            return replace(self, refused=kept, since_C=math.nan, worked_s=now)
        T_C, needs = float(last.T_zone_C[0, -1]), np.abs(levels).sum() / steps >= _ASKED
        waits = not levels or not np.isfinite(levels).all()
        goes_on = waits and sign * (self.since_C - T_C) >= 0.0
        if got > _NOTHING or not (needs or goes_on):
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
        starts = sorted(hour for hour in self.hours if (hour - 1) % _HOURS not in self.hours)
        spans = []
        for start in starts:
            end = next(start + n for n in range(1, _HOURS + 1) if (start + n) % _HOURS not in self.hours)
            spans.append(f"{start}:00 to {end % _HOURS}:00")
        return (
            f"{what} comes from {' and '.join(spans)}, whatever is asked for: the plant's own schedule; plans do "
            "without these hours (controller.options.watch.blocked_hours)"
            if spans
            else "no hour is blocked by the plant's own schedule any more"
        )


def called_for(asked: Array, heating_C: Array, cooling_C: Array, T_zone_C: Array) -> Array:
    """What was surely asked of an actuator in n steps (n,).

    `asked` (n,): levels. Where a step had set-points, `heating_C` and `cooling_C` (n,), else NaN, it is what the loops
    would give at the readings `T_zone_C` (n + 1,) from its start to its end: full level, below 0 for cooling, or 0.
    """
    by_loops = np.isfinite(heating_C) & np.isfinite(cooling_C)
    coldest, warmest = np.minimum(T_zone_C[:-1], T_zone_C[1:]), np.maximum(T_zone_C[:-1], T_zone_C[1:])
    calls = 1.0 * (warmest < heating_C - _CALLS_K) - 1.0 * (coldest > cooling_C + _CALLS_K)
    return np.where(by_loops, calls, asked)


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


def _hour(time_s: float) -> int:
    return int((time_s % DAY_S + 1.0) // HOUR_S) % _HOURS
