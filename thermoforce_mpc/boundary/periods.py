"""BOPTEST's scored windows: two weeks around the peak and around the typical heating day of a weather year.

Rule (BOPTEST's tool for finding days, facts only): from a year under native control, the peak day holds the highest
15-minute mean of the heat pump's electric power; the typical day's highest such mean is the nearest at or below the
median over all heating days. Windows begin seven days before.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.types import DAY_S, Array, Period

_QUARTERS = 96
_HALF_WINDOW_D = 7
# A window needs its warm-up before and its second week after the day.
_FIRST_DAY, _LAST_DAY = 14, 358
_HEATING_W = 1.0


# BOPTEST publishes the days it found for its own weather file; the rule ranks days by watts, so an emulator that is a
# watt off may pick a neighbour in rank that lies months away. Days by the start of the file's sha256.
_PUBLISHED = {"0c800b9e861c": {"peak_heat_day": 23, "typical_heat_day": 115}}


def published_windows(weather_name: str) -> dict[str, Period] | None:
    """The windows BOPTEST publishes for its own weather file (Brussels), or None for any other weather."""
    for digest, days in _PUBLISHED.items():
        if digest in weather_name:
            return {name: _window(name, day) for name, day in days.items()}
    return None


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
    return {name: _window(name, day) for name, day in (("peak_heat_day", peak), ("typical_heat_day", typical))}


def _window(name: str, day: int) -> Period:
    return Period(name, (day - _HALF_WINDOW_D) * DAY_S)
