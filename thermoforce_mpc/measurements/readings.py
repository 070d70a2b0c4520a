"""Readings of a signal: which of them hold, and what they are at equal steps.

| rule | flags (what is flagged is taken as not measured) | overridden in the map by |
|---|---|---|
| range | readings outside what is physically possible | `range` |
| jump | readings that come too far too fast, or go `spike` away and come back within 6 h | `spike` |
| frozen | stretches of one and the same reading for longer than `stuck_h` | `stuck_h` (0: never) |

They are those of `data/limits.py`, which a running controller asks too. More than 10 % of a signal out of range is a
wrong unit, not a fault, and refused.

What acts holds from one reading to the next and becomes its mean over each step; what is sampled is read at the steps'
boundaries on the straight line between readings; irradiance that is read more often than once a step is the mean over
the step around each boundary. Readings farther apart than the longest time without a gap make one: NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, limits
from thermoforce_mpc.data.limits import SignalRule
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.mapping import Signal, likelier

_MOST_REFUSED = 0.1
# Flagged readings that are kept for a picture.
_SHOWN = 200
# A level may lie outside its range by this much from calibration; it is cut, not refused.
LEVEL_SLACK = 0.02
# Stored on change: least readings and share of those that repeat the one before; share of the longest time without one
# after which one repeats to show that it lives; steps that a value makes which stayed; share of gaps before which a
# value is one of rest; share of gaps in which the value stayed; share of distances that are not the usual one,
# or gaps, from which on readings do not come by the clock.
_LEAST_CHANGES, _MOST_SAME, _ALIVE, _STEPS, _RESTS, _STAYED = 3, 0.02, 0.7, 3.0, 0.2, 0.7
_IRREGULAR, _LEAST_GAPS = 0.15, 3
# Set-points of rooms, °C and °F.
_SETPOINTS = ((10.0, 32.0), (50.0, 90.0))
# What ends at an instant does not hold there any more, s.
_NO_TIME_S = 1e-3
# Longest time between readings that is no gap: this many times their 90th percentile.
LOOSE, _PERCENTILE = 1.5, 90.0


def with_map(rule: SignalRule, signal: Signal) -> SignalRule:
    """`rule` with what the map sets for `signal`."""
    return replace(
        rule,
        range=signal.range or rule.range,
        spike=signal.spike or rule.spike,
        times_usual=0.0 if signal.spike else rule.times_usual,
        stuck_h=rule.stuck_h if signal.stuck_h is None else signal.stuck_h,
    )


# Of signals that a record has, by its names, and of others that a table may have. A level of a table may be off by its
# calibration.
ZONE, OUTDOOR, WATER = (limits.RULES[name] for name in ("T_zone_C", "T_out_C", "T_return_C"))
SOLAR = limits.RULES["solar_W_m2"]
POWER = replace(limits.RULES["power_W"], range=limits.POWER_W)
LEVEL = replace(limits.RULES["u"], range=(-LEVEL_SLACK, 1.0 + LEVEL_SLACK))
SIGNED_LEVEL = replace(LEVEL, range=(-1.0 - LEVEL_SLACK, 1.0 + LEVEL_SLACK))
HUMIDITY = replace(LEVEL, range=(0.0, 1.0 + LEVEL_SLACK))
BOUND = SignalRule("temperature", "°C", ZONE.range, ZONE.usual)
PRICE = SignalRule("price", "per kWh")
TANK = SignalRule("temperature", "°C", WATER.range, (25.0, 75.0))
COMMAND = SignalRule("command", "")
# Kinds of what was set, whose maps have no `range` and `factor`.
_SET = ("command", "set temperature")


@dataclass(frozen=True)
class Flag:
    """Readings that a rule refused: `count` of them, the `first` in words, and up to 200 as (s, value) `points`.

    `last_s`: time of the last one, s.
    """

    rule: str
    count: int
    first: str
    points: tuple[tuple[float, float], ...] = ()
    last_s: float = float("nan")


def screened(
    time_s: Array,
    values: Array,
    raw: Array,
    rules: SignalRule,
    name: str,
    declared: str,
    where: Callable[[int], str],
    *,
    refuse: bool = True,
) -> tuple[NDArray[np.bool_], tuple[Flag, ...]]:
    """Which readings of a signal hold (n,), and what was flagged.

    `time_s` increases, `values` are in the unit inside and finite, `raw` as in the table, (n,) each; `name` (of signal
    and column), `declared` unit and `where` (time stamp of a reading) are for messages. Raises `DataError` where more
    than 10 % are out of range; says which unit they look like. Without `refuse` that is said of what is flagged.
    """
    flags: list[Flag] = []

    def flag(rule: str, wrong: NDArray[np.bool_], kept: NDArray[np.intp], what: str) -> NDArray[np.intp]:
        if not wrong.any():
            return kept
        rows = kept[wrong]
        shown = rows[:: -(-rows.size // _SHOWN)]
        points = tuple(zip(time_s[shown].tolist(), values[shown].tolist(), strict=True))
        words = f"{values[rows[0]]:.4g} {rules.unit} at {where(int(rows[0]))}{what}"
        flags.append(Flag(rule, int(rows.size), words, points, float(time_s[rows[-1]])))
        return kept[~wrong]

    low, high = rules.range
    kept = np.arange(values.size)
    outside = limits.outside(values, rules.range)
    if refuse and outside.mean() > _MOST_REFUSED:
        unit = likelier(raw, declared, rules.kind, rules.usual)
        has_range = rules.kind not in _SET
        check = "check column, unit and factor" if has_range else "check column and unit"
        hint = f"they look like {unit}: set unit: '{unit}'" if unit else check
        if not unit and np.ptp(raw[outside]) == 0.0 and not outside.all():
            code = f"{raw[outside][0]:.10g}"
            hint = (
                f"all of them are {code}: if that stands for no reading, set csv: {{missing: ['{code}']}}; else {hint}"
            )
        if rules.kind == "level" and looks_like_setpoints(raw):
            hint = (
                "these look like set-points in °C or °F, and a set-point is no level: name what the machine did "
                "(valve, "
                "speed, on and off), or leave the level out, and the power of its machine over the full one is "
                "taken for it"
            )
        possible = f"between {low:g} and {high:g} {rules.unit}".rstrip()
        read_as = f"read as {declared}; " if declared else ""
        raise DataError(
            f"{name}: {100 * outside.mean():.0f} % of the readings are no {rules.kind} {possible} "
            f"(first {values[int(np.argmax(outside))]:.4g} at {where(int(np.argmax(outside)))}, {read_as}"
            f"readings from {np.min(raw):.4g} to {np.max(raw):.4g}); {hint}{', or set range' if has_range else ''}"
        )
    possible = f", possible are {low:g} to {high:g}"
    if outside.any() and (unit := likelier(raw[outside], declared, rules.kind, rules.usual)):
        possible += f"; in {unit} they were usual: set unit: '{unit}' if it is so"
    kept = flag("range", outside, kept, possible)
    far = limits.jumps(time_s[kept], values[kept], rules)
    kept = flag("jump", far, kept, f", {rules.in_words}")
    stuck = limits.frozen(time_s[kept], values[kept], rules)
    kept = flag("frozen", stuck, kept, f", unchanged for more than {rules.stuck_h:g} h")
    holds = np.zeros(values.size, dtype=bool)
    holds[kept] = True
    return holds, tuple(flags)


def looks_like_setpoints(values: Array) -> bool:
    """Whether levels (n,) are rather set-points: few values in half or fifth degrees, between 10 and 32 °C or in °F.

    Off or fully on is never among them.
    """
    distinct = np.unique(values)
    if distinct.size > max(4, min(20, values.size // 8)) or distinct.size < 2:
        return False
    steps = np.allclose(2.0 * distinct, np.round(2.0 * distinct)) or np.allclose(
        5.0 * distinct, np.round(5.0 * distinct)
    )
    low, high = float(distinct[0]), float(distinct[-1])
    return bool(steps and any(least <= low and high <= most for least, most in _SETPOINTS))


@dataclass(frozen=True)
class SignalReadings:
    """Readings of one signal: `time_s` (n,) s, increasing; `values` (n,), finite.

    `ends_s` (n,): until when each says something, where none comes before; `held`: whether it holds for so long, as
    where changes are stored, and does not merely bridge.
    """

    time_s: Array
    values: Array
    ends_s: Array
    held: bool = False

    @property
    def usual_s(self) -> float:
        """Usual time between two readings, s."""
        return usual_s(self.time_s)

    @property
    def reaches(self) -> NDArray[np.bool_]:
        """Which readings (n - 1,) hold until the next one: those before no gap."""
        return np.asarray(self.time_s[1:] <= self.ends_s[:-1] + 1e-3)


def usual_s(time_s: Array) -> float:
    """Median distance of instants, s; NaN for fewer than two."""
    return float(np.median(np.diff(time_s))) if time_s.size > 1 else float("nan")


def longest_s(time_s: Array, step_s: float, hold_h: float | None) -> float:
    """Longest time between readings that is no gap, s: as given, or by the usual one, a step at least."""
    if hold_h is not None:
        return hold_h * 3600.0
    if time_s.size < 2:
        return step_s
    return max(LOOSE * float(np.percentile(np.diff(time_s), _PERCENTILE)), step_s)


def ends_s(time_s: Array, longest: float, breaks_s: Array) -> Array:
    """Until when readings at `time_s` (n,) say something, s: `longest`, or until the signal was not available."""
    ends = time_s + longest
    if breaks_s.size:
        after = np.searchsorted(breaks_s, time_s, side="right")
        ends = np.minimum(ends, np.append(breaks_s, np.inf)[after])
    return np.asarray(ends)


def stored_on_change(time_s: Array, values: Array, breaks_s: Array, longest: float, most: float) -> Array | None:
    """Until when readings hold (n,), s, of a signal that is stored only when it changes; None where it is not.

    Its signature: a reading does not repeat the one before (but to show that it lives, after a long time without
    change), and where none was stored for long the value stayed: it goes on by a step as small as any, or leaves a
    value at which the signal rests. Where it goes on by more, readings are missing. `longest`: time without a gap by
    the usual distances, `most`: the longest that is believed, s.
    """
    apart, change = np.diff(time_s), np.diff(values)
    if breaks_s.size:  # the first reading after it may repeat the last
        broken = np.searchsorted(breaks_s, time_s[1:]) > np.searchsorted(breaks_s, time_s[:-1])
        apart, change = apart[~broken], change[~broken]
    if apart.size < _LEAST_CHANGES:
        return None
    same = change == 0.0
    alive_s = np.inf
    if same.mean() > _MOST_SAME:
        alive_s = float(np.max(apart)) * LOOSE
        seldom = apart[same] >= _ALIVE * np.max(apart)
        if not seldom.all():
            return None
    long = apart > longest
    irregular = (np.abs(apart / np.median(apart) - 1.0) > 0.25).mean()
    if irregular < _IRREGULAR and long.sum() < _LEAST_GAPS:
        return None
    steps = np.abs(change[~same])
    usual = float(np.median(steps))
    whole = np.flatnonzero(np.diff(time_s) > longest)
    before, jump = values[whole], np.abs(np.diff(values)[whole])
    rest, times = np.unique(before, return_counts=True)
    rests = {float(values.min()), float(values.max()), *rest[times >= max(2.0, _RESTS * before.size)].tolist()}
    stayed = (jump <= _STEPS * usual) | np.isin(before, list(rests))
    if long.any() and stayed.mean() < _STAYED:
        return None
    ends = ends_s(time_s, min(most, alive_s), breaks_s)
    ends[whole[~stayed]] = time_s[whole[~stayed]] + min(usual_s(time_s), longest)
    return ends


def durations_s(readings: SignalReadings, marks: str) -> Array:
    """Length of the interval of each reading (n,), s: to the next one (marks start) or from the one before (end)."""
    time_s = readings.time_s
    reaches, between, room = readings.reaches, np.diff(time_s), readings.ends_s - time_s
    usual = np.minimum(usual_s(time_s) if time_s.size > 1 else room, room)
    if marks == "end":
        return np.insert(np.where(reaches, between, usual[:-1]), 0, usual[0])
    # A reading that holds does so until it was not available, and to the end of the record.
    lasts = np.append(np.where(reaches, between, np.where(room[:-1] < between, usual[:-1], between)), usual[-1])
    if readings.held:
        lasts[-1] = room[-1]
    return lasts


def means(starts_s: Array, lasts_s: Array, values: Array, edges_s: Array, coverage: float) -> Array:
    """Means (m,) over the steps between `edges_s` (m + 1,) of values that hold from `starts_s` for `lasts_s`.

    NaN where less than the share `coverage` of a step is covered.
    """
    if not values.size:
        return np.full(edges_s.size - 1, np.nan)
    knots = np.empty(2 * values.size)
    knots[0::2], knots[1::2] = starts_s, starts_s + lasts_s
    amount, covered = np.zeros(knots.size), np.zeros(knots.size)
    amount[1::2] = np.cumsum(values * lasts_s)
    covered[1::2] = np.cumsum(lasts_s)
    amount[2::2], covered[2::2] = amount[1:-1:2], covered[1:-1:2]
    total = np.diff(np.interp(edges_s, knots, amount))
    time_s = np.diff(np.interp(edges_s, knots, covered))
    enough = time_s >= coverage * np.diff(edges_s) * (1.0 - 1e-9)
    return np.where(enough, total / np.where(enough, time_s, 1.0), np.nan)


def sampled(readings: SignalReadings, at_s: Array) -> Array:
    """Values (m,) at `at_s` on the line between the readings around, NaN in gaps.

    The last one holds until the next would be there, and longer where changes are stored.
    """
    time_s, values = readings.time_s, readings.values
    if not values.size:
        return np.full(at_s.size, np.nan)
    after = np.clip(np.searchsorted(time_s, at_s), 0, time_s.size - 1)
    before = np.maximum(np.where(time_s[after] > at_s, after - 1, after), 0)
    inside = (time_s[before] <= at_s) & (at_s <= time_s[after])
    line = np.interp(at_s, time_s, values)
    bridged = inside & ((before == after) | np.append(readings.reaches, True)[before])
    # Clocks that are off by a little: the nearest reading, within a quarter of the usual distance and of the step.
    step_s = float(at_s[1] - at_s[0]) if at_s.size > 1 else np.inf
    nearest = np.where(np.abs(at_s - time_s[before]) <= np.abs(time_s[after] - at_s), before, after)
    room = float(np.median(readings.ends_s - time_s))
    near = np.abs(time_s[nearest] - at_s) <= 0.25 * min(room, readings.usual_s or 0.0, step_s)
    newest = (at_s > time_s[-1]) & (at_s - time_s[-1] < min(readings.usual_s, readings.ends_s[-1] - time_s[-1]) - 1.0)
    found = np.where(bridged, line, np.where(near | newest, values[nearest], np.nan))
    if not readings.held:
        return found
    holds = (time_s[before] <= at_s) & (at_s < readings.ends_s[before]) & ~bridged
    return np.where(holds, values[before], found)


def around(readings: SignalReadings, at_s: Array, step_s: float, coverage: float) -> Array:
    """Means (m,) over the step around each of `at_s`, if readings are denser than half a step; else `sampled`."""
    if not readings.values.size or not readings.usual_s <= 0.5 * step_s:
        return sampled(readings, at_s)
    # Readings are instants: each holds for half the time to the ones before and after it.
    after, before = (0.5 * durations_s(readings, marks) for marks in ("start", "end"))
    if readings.held:  # but for one that stays, or ended when the signal was not available
        reaches = np.append(readings.reaches, False)
        after = np.where(reaches, after, 2.0 * after)
        before = np.where(np.append(False, reaches[:-1]), before, 0.0)
        after = np.minimum(after, at_s[-1] + step_s)
    edges = np.append(at_s - 0.5 * step_s, at_s[-1] + 0.5 * step_s)
    return means(readings.time_s - before, before + after, readings.values, edges, coverage)


def held(readings: SignalReadings, at_s: Array) -> Array:
    """The last reading before or at each of `at_s` (m,): what follows a schedule; NaN in gaps."""
    if not readings.values.size:
        return np.full(at_s.size, np.nan)
    last = np.searchsorted(readings.time_s, at_s, side="right") - 1
    fresh = (last >= 0) & (at_s <= readings.ends_s[np.maximum(last, 0)])
    return np.where(fresh, readings.values[np.maximum(last, 0)], np.nan)


def held_means(readings: SignalReadings, lasts_s: Array, grid_s: Array, step_s: float, coverage: float) -> Array:
    """What holds over the steps of `step_s` that begin at `grid_s` (n,): its mean, or where little is known, what holds
    at their begin; NaN where nothing does.

    `lasts_s`: how long each reading holds, see `durations_s`; `coverage`: see `means`.
    """
    over_step = means(readings.time_s, lasts_s, readings.values, np.append(grid_s, grid_s[-1] + step_s), coverage)
    at_begin = held(replace(readings, ends_s=readings.time_s + lasts_s - _NO_TIME_S), grid_s)
    return np.where(np.isfinite(over_step), over_step, at_begin)
