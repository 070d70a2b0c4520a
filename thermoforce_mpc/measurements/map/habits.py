"""Comfort bounds of a first map from what people set: around what is usual, and by the hour where they lower it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.measurements.map.guesses import Column
from thermoforce_mpc.measurements.units import converted

# Comfort bounds of a room of which nothing is known, °C: the least of EN 16798-1's category II for dwellings in winter,
# and 4 K above it.
COMFORT_C = (20.0, 24.0)
# The upper bound of EN 16798-1's category II in summer, °C: who sets cooling higher does not ask for a warmer room.
WARMEST_C = 26.0
# A set-point that is lowered by this, K, tells of hours in which less is asked for.
SETBACK_K = 1.0
# Of a habit: so many days, and hours in which it is followed, at least; and times a day at which it is warm, at most.
_LEAST_HABIT, _ALIKE, _MOST_SPANS = pd.Timedelta("3D"), 0.75, 2
# Days of a weekend differ from others where there are so many, and in so many hours more is foretold by hours of their
# own than by those of all days, as a share.
_LEAST_DAYS, _DIFFER = 4, 0.075
_WEEK = {"weekdays ": False, "weekend ": True}


def bounds_around(asked_C: float, cool_from_C: float | None = None) -> tuple[float, float]:
    """Comfort bounds around a set-point, °C, in half degrees, 3 K apart at least; cooling is from `cool_from_C` on."""
    low = float(np.floor(2.0 * asked_C) / 2.0 - 0.5)
    high = COMFORT_C[1] if cool_from_C is None else min(float(np.ceil(2.0 * cool_from_C) / 2.0), WARMEST_C)
    return low, max(high, low + 3.0)


@dataclass(frozen=True)
class Habit:
    """A set-point, °C: `high_C` within `spans`, else `low_C`.

    `spans`: days, as a comfort schedule names them with a space behind ('' for all), and whole hours of them, also
    beyond midnight.
    """

    high_C: float
    low_C: float
    spans: tuple[tuple[str, int, int], ...]


def habit_of(column: Column, unit: str, zone: str) -> Habit | None:
    """What people set by the hour of the day in `zone`, at weekends by other hours where these clearly differ.

    None where days have no such hours, or are too few.
    """
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
    hour, weekend = pd.Series(hours.hour), pd.Series(hours.day_of_week >= 5)
    of_all, of_week = (held.groupby(by).transform("median") for by in (hour, [hour, weekend]))
    days = pd.Series(hours.normalize()).groupby(weekend).nunique()
    if len(days) == 2 and days.min() >= _LEAST_DAYS:
        parted_C = _parted_C(of_week)
        by_own, by_all = (((held >= parted_C) == (of >= parted_C))[weekend].mean() for of in (of_week, of_all))
        if by_own - by_all >= _DIFFER and (found := _habit(held, hour, weekend, of_week)) is not None:
            return found
    return _habit(held, hour, None, of_all)


def _parted_C(usual: pd.Series) -> float:
    """What parts the warm ones of usual set-points from the others, °C."""
    return float(usual.min() + usual.max()) / 2.0


def _habit(held: pd.Series, hour: pd.Series, weekend: pd.Series | None, usual: pd.Series) -> Habit | None:
    """The habit by which a set-point (n,) is as is `usual` in hours like it; None where it is not, or nobody has it."""
    parted_C = _parted_C(usual)
    warm = usual >= parted_C
    followed = float(((held >= parted_C) == warm).mean())
    if warm.all() or held[warm].median() - held[~warm].median() < SETBACK_K or followed < _ALIKE:
        return None
    spans: list[tuple[str, int, int]] = []
    for days, is_weekend in {"": None}.items() if weekend is None else _WEEK.items():
        ours = warm if weekend is None else warm[weekend == is_weekend]
        of = ours.groupby(hour[ours.index]).first()
        found = _spans([bool(of.get(h, False)) for h in range(24)])
        if len(found) > _MOST_SPANS:
            return None
        spans += [(days, *span) for span in found]
    return Habit(float(held[warm].median()), float(held[~warm].median()), tuple(spans))


def _spans(warm: list[bool]) -> list[tuple[int, int]]:
    """When it is warm, of the 24 hours of a day: from, until; beyond midnight as one."""
    if all(warm):
        return [(0, 24)]
    begins = [h for h in range(24) if warm[h] and not warm[h - 1]]
    ends = [h for h in range(24) if not warm[h] and warm[h - 1]]
    return [(b, min((e for e in ends if e > b), default=min(ends)) or 24) for b in begins]
