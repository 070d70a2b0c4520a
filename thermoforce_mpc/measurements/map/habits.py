"""Comfort bounds of a first map from what people set: around what is usual, and by the hour where they lower it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.measurements.map.guesses import Column
from thermoforce_mpc.measurements.map.mapping import converted

# Comfort bounds of a room of which nothing is known, °C: the least of EN 16798-1's category II for dwellings in winter,
# and 4 K above it.
COMFORT_C = (20.0, 24.0)
# A set-point that is lowered by this, K, tells of hours in which less is asked for.
SETBACK_K = 1.0
# Of a habit: so many days, and hours in which it is followed, at least; and times a day at which it is warm, at most.
_LEAST_HABIT, _ALIKE, _MOST_SPANS = pd.Timedelta("3D"), 0.75, 2


def bounds_around(asked_C: float) -> tuple[float, float]:
    """Comfort bounds around a set-point, °C: a band of 3 K at least, in half degrees."""
    low = float(np.floor(2.0 * asked_C) / 2.0 - 0.5)
    return low, max(COMFORT_C[1], low + 3.0)


@dataclass(frozen=True)
class Habit:
    """A set-point, °C: `high_C` within `spans` of whole hours of the day, also beyond midnight, else `low_C`."""

    high_C: float
    low_C: float
    spans: tuple[tuple[int, int], ...]


def habit_of(column: Column, unit: str, zone: str) -> Habit | None:
    """What people set by the hour of the day in `zone`; None where days have no such hours, or are too few."""
    known = np.isfinite(column.values)
    at = pd.DatetimeIndex(pd.to_datetime(column.time_s[known], unit="s"))
    # Stamps that cannot be read are counted from 1970.
    if not len(at) or at[-1] - at[0] < _LEAST_HABIT or at[0].year == 1970:
        return None
    celsius = converted(column.values[known], unit or "°C")
    if column.clock:
        first = np.ones(len(at), dtype=bool)
        at = (
            at.tz_localize(column.clock, ambiguous=first, nonexistent="shift_forward")
            .tz_convert(zone)
            .tz_localize(None)
        )
    hours = pd.date_range(at[0].ceil("1h"), at[-1].floor("1h"), freq="1h")
    # In the middle of each hour, which changes at full hours leave alone.
    held = pd.Series(celsius[np.searchsorted(at, hours + pd.Timedelta("30min"), side="right") - 1])
    hour = pd.Series(hours.hour)
    usual = held.groupby(hour).median()
    parted_C = float(usual.min() + usual.max()) / 2.0
    warm = usual >= parted_C
    alike = float(((held >= parted_C) == hour.map(warm)).mean())
    if float(usual[warm].median() - usual[~warm].median() if (~warm).any() else 0.0) < SETBACK_K or alike < _ALIKE:
        return None
    begins = [int(h) for h in usual.index if warm[h] and not warm[(h - 1) % 24]]
    ends = [int(h) for h in usual.index if not warm[h] and warm[(h - 1) % 24]]
    if len(begins) > _MOST_SPANS:
        return None
    of_hours = hour.map(warm)
    spans = tuple((b, min((e for e in ends if e > b), default=min(ends)) or 24) for b in begins)
    return Habit(float(held[of_hours].median()), float(held[~of_hours].median()), spans)
