"""BOPTEST's scored windows: two weeks around the peak and around the typical heating day of a weather year.

Rule (BOPTEST's tool for finding days, facts only): from a year under native control, the peak day holds the highest
15-minute mean of the heat pump's electric power; the typical day's highest such mean is the nearest at or below the
median over all heating days. Windows begin seven days before. Only days that leave room for the warm-up and for the
second week count, also for the typical day (BOPTEST asks that of the peak day alone).
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Period

_QUARTERS = 96
_HALF_WINDOW_D = 7
# A window needs its warm-up before and its second week after the day.
_FIRST_DAY, _LAST_DAY = 14, 358
_HEATING_W = 1.0


# BOPTEST publishes the days it found for its own weather. The emulator finds its peak day by the rule, but the typical
# one follows from a median between neighbours in rank that lie months apart: a watt decides, and so does the release of
# the test case they were found with. Days by the weather's fingerprint.
_PUBLISHED = {"7856f6e4b8b7": {"peak_heat_day": 23, "typical_heat_day": 115}}


def published_windows(fingerprint: str) -> dict[str, Period] | None:
    """The windows BOPTEST publishes for its own weather (Brussels), or None for any other weather."""
    days = _PUBLISHED.get(fingerprint)
    return None if days is None else {name: centred_window(name, day) for name, day in days.items()}


def heating_windows(power_W: Array) -> dict[str, Period]:
    """The windows 'peak_heat_day' and 'typical_heat_day' of a year by BOPTEST's rule.

    Args:
        power_W: 15-minute means of the heating power over 365 days under native control, shape (35040,).
    """
    highest = np.asarray(power_W).reshape(365, _QUARTERS).max(axis=1)
    available = np.arange(_FIRST_DAY, _LAST_DAY)
    peak = int(available[np.argmax(highest[available])])
    median = float(np.median(highest[highest > _HEATING_W])) if (highest > _HEATING_W).any() else 0.0
    not_above = available[highest[available] <= median]
    typical = int(not_above[np.argmax(highest[not_above])])
    return {name: centred_window(name, day) for name, day in (("peak_heat_day", peak), ("typical_heat_day", typical))}


def centred_window(name: str, day: int) -> Period:
    """The two weeks around a day of the year, counted from 0, as BOPTEST's scenarios have them."""
    return Period(name, (day - _HALF_WINDOW_D) * DAY_S)
