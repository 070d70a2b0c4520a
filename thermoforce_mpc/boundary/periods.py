"""BOPTEST's scored windows: two weeks around the peak and the typical heating day of a weather year.

Rule (BOPTEST's tool for finding days): in a year of native control, the peak day has the highest 15-min mean of the
heat pump's electric power; the typical day's highest 15-min mean is the nearest at or below the median over all heating
days. Both days must leave room for the warm-up and the second week (BOPTEST requires this of the peak day only).
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Period

NAMES = ("peak_heat_day", "typical_heat_day")
_QUARTERS = 96
_HALF_WINDOW_D = 7
# Days that leave room for the warm-up and first week before, and the second week after.
_FIRST_DAY, _LAST_DAY = 14, 358
_HEATING_W = 1.0


# Days that BOPTEST publishes for its own weather, by the weather's fingerprint. The emulator reproduces the peak day by
# the rule, but not the typical day: days next to the median in rank lie months apart, so a difference of 1 W, or
# another release of the test case, changes it.
_PUBLISHED = {"7856f6e4b8b7": {"peak_heat_day": 23, "typical_heat_day": 115}}


def published_windows(fingerprint: str) -> dict[str, Period] | None:
    """Return the windows BOPTEST publishes for its own weather (Brussels), or None for any other weather."""
    days = _PUBLISHED.get(fingerprint)
    return None if days is None else {name: centred_window(name, day) for name, day in days.items()}


def heating_windows(power_W: Array) -> dict[str, Period]:
    """Return both windows by BOPTEST's rule from a year's 15-min means of electric heating power, W, (35040,)."""
    highest = np.asarray(power_W).reshape(365, _QUARTERS).max(axis=1)
    available = np.arange(_FIRST_DAY, _LAST_DAY)
    peak = int(available[np.argmax(highest[available])])
    median = float(np.median(highest[highest > _HEATING_W])) if (highest > _HEATING_W).any() else 0.0
    not_above = available[highest[available] <= median]
    typical = int(not_above[np.argmax(highest[not_above])])
    return {name: centred_window(name, day) for name, day in zip(NAMES, (peak, typical), strict=True)}


def centred_window(name: str, day: int) -> Period:
    """Return the two weeks around `day` (day of the year, from 0), as in BOPTEST's scenarios."""
    return Period(name, (day - _HALF_WINDOW_D) * DAY_S)
