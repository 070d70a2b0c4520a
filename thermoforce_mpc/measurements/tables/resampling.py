"""Readings at any instants to equal steps.

What acts holds from one reading to the next and becomes its mean over each step; what is sampled is read at the steps'
boundaries on the straight line between readings; irradiance that is read more often than once a step is the mean over
the step around each boundary. Readings farther apart than the longest time without a gap make one: NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array

# Longest time between readings that is no gap: this many times their 90th percentile.
_LOOSE, _PERCENTILE = 1.5, 90.0


@dataclass(frozen=True)
class Readings:
    """Readings of one signal: `time_s` (n,) s, increasing; `values` (n,), finite; `longest_s`: no gap until then."""

    time_s: Array
    values: Array
    longest_s: float

    @property
    def usual_s(self) -> float:
        """Usual time between two readings, s."""
        return usual_s(self.time_s)


def usual_s(time_s: Array) -> float:
    """Median distance of instants, s; NaN for fewer than two."""
    return float(np.median(np.diff(time_s))) if time_s.size > 1 else float("nan")


def longest_s(time_s: Array, step_s: float, hold_h: float | None) -> float:
    """Longest time between readings that is no gap, s: as given, or by the usual one, a step at least."""
    if hold_h is not None:
        return hold_h * 3600.0
    if time_s.size < 2:
        return step_s
    return max(_LOOSE * float(np.percentile(np.diff(time_s), _PERCENTILE)), step_s)


def durations_s(time_s: Array, longest: float, marks: str) -> Array:
    """Length of the interval of each reading (n,), s: to the next one (marks start) or from the one before (end)."""
    usual = min(usual_s(time_s), longest) if time_s.size > 1 else longest
    between = np.diff(time_s)
    between = np.where(between <= longest, between, usual)
    return np.append(between, usual) if marks == "start" else np.insert(between, 0, usual)


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


def sampled(readings: Readings, at_s: Array) -> Array:
    """Values (m,) at `at_s` on the line between the readings around, NaN in gaps."""
    time_s, values = readings.time_s, readings.values
    if not values.size:
        return np.full(at_s.size, np.nan)
    after = np.clip(np.searchsorted(time_s, at_s), 0, time_s.size - 1)
    before = np.maximum(np.where(time_s[after] > at_s, after - 1, after), 0)
    inside = (time_s[before] <= at_s) & (at_s <= time_s[after])
    line = np.interp(at_s, time_s, values)
    bridged = inside & (time_s[after] - time_s[before] <= readings.longest_s)
    # Clocks that are off by a little: the nearest reading, within a quarter of the usual distance and of the step.
    step_s = float(at_s[1] - at_s[0]) if at_s.size > 1 else np.inf
    nearest = np.where(np.abs(at_s - time_s[before]) <= np.abs(time_s[after] - at_s), before, after)
    near = np.abs(time_s[nearest] - at_s) <= 0.25 * min(readings.longest_s, readings.usual_s or 0.0, step_s)
    return np.where(bridged, line, np.where(near, values[nearest], np.nan))


def around(readings: Readings, at_s: Array, step_s: float, coverage: float) -> Array:
    """Means (m,) over the step around each of `at_s`, if readings are denser than half a step; else `sampled`."""
    if not readings.values.size or not readings.usual_s <= 0.5 * step_s:
        return sampled(readings, at_s)
    # Readings are instants: each holds for half the time to the ones before and after it.
    after, before = (0.5 * durations_s(readings.time_s, readings.longest_s, marks) for marks in ("start", "end"))
    edges = np.append(at_s - 0.5 * step_s, at_s[-1] + 0.5 * step_s)
    return means(readings.time_s - before, before + after, readings.values, edges, coverage)


def held(readings: Readings, at_s: Array) -> Array:
    """The last reading before or at each of `at_s` (m,): what follows a schedule; NaN in gaps."""
    if not readings.values.size:
        return np.full(at_s.size, np.nan)
    last = np.searchsorted(readings.time_s, at_s, side="right") - 1
    fresh = (last >= 0) & (at_s - readings.time_s[np.maximum(last, 0)] <= readings.longest_s)
    return np.where(fresh, readings.values[np.maximum(last, 0)], np.nan)
