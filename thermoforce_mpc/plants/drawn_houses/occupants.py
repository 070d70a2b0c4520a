"""When people are at home, and appliances whose heat varies at random."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermoforce_mpc.data import DAY_S, HOUR_S, Array

Pattern = Literal["away", "home", "workers", "always", "office"]
HOUSEHOLDS: tuple[Pattern, ...] = ("away", "home", "workers", "always")
# Hours of an office, every day (BOPTEST's `multizone_office_simple_air`).
OFFICE_HOURS = (6.0, 19.0)
PERSON_W = 80.0
# Days of the year modulo 7 that are a weekend (BOPTEST: 1 January is a Tuesday).
_WEEKEND = (4, 5)
_YEAR_D = 365
_GAINS_HOURS = 2.0


def at_home(pattern: Pattern, time_s: Array) -> NDArray[np.bool_]:
    """Return presence at `time_s`, shape of `time_s`, by the pattern of a household or an office.

    away: weekdays before 7:00 and from 20:00, weekends (BOPTEST); home: daily 6:00 to 22:00; workers: weekdays 6:00
    to 8:00 and 17:00 to 22:00, weekends 7:00 to 23:00; always: all the time; office: daily `OFFICE_HOURS`. The year
    repeats, as weather and gains do.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / DAY_S + 1e-9) % _YEAR_D
    hour = hour_of_day(time_s)
    weekend = np.isin(day % 7, _WEEKEND)
    if pattern == "away":
        return np.asarray(weekend | (hour < 7.0) | (hour >= 20.0))
    if pattern == "office":
        return np.asarray((hour >= OFFICE_HOURS[0]) & (hour < OFFICE_HOURS[1]))
    if pattern == "home":
        return np.asarray((hour >= 6.0) & (hour < 22.0))
    if pattern == "workers":
        working = ((hour >= 6.0) & (hour < 8.0)) | ((hour >= 17.0) & (hour < 22.0))
        return np.asarray(np.where(weekend, (hour >= 7.0) & (hour < 23.0), working))
    return np.ones(time_s.shape, dtype=bool)


def hour_of_day(time_s: Array) -> Array:
    """Return the hour of the day at `time_s`, from 0 up to but not including 24."""
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / DAY_S + 1e-9)
    return np.asarray((time_s - day * DAY_S) / HOUR_S + 1e-9)


def varying(rng: np.random.Generator, time_s: Array, relative_sd: float) -> Array:
    """Return a log-normal first-order process of mean 1 on an equally spaced grid `time_s`; correlation time 2 h."""
    memory = np.exp(-(time_s[1] - time_s[0]) / HOUR_S / _GAINS_HOURS)
    draws = rng.standard_normal(time_s.size)
    draws[1:] *= np.sqrt(1.0 - memory**2)
    noise = lfilter([1.0], [1.0, -memory], draws)
    sd = np.sqrt(np.log1p(relative_sd**2))
    return np.asarray(np.exp(sd * noise - 0.5 * sd**2))


def set_back(present: Callable[[Array], NDArray[np.bool_]], time_s: Array, *, lead_s: float) -> NDArray[np.bool_]:
    """Return whether a native set-point is set back at `time_s`: nobody is `present` now or within `lead_s`."""
    # Presence within the preheating time, on the 15-min grid of the schedules.
    ahead = np.arange(0.0, lead_s + 1.0, 900.0)
    return np.asarray(~np.any([present(time_s + shift) for shift in ahead], axis=0))
