"""People in buildings: by a pattern, or whom nobody announces, with habits and surprises.

The latter live by the clock, the weekday, the weather and a seed, not by the temperature of the rooms: what they do is
the same under every controller. Sources of the numbers: docs/how-it-works/random-buildings.md#people.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array

Pattern = Literal["away", "home", "workers", "always", "office"]
HOUSEHOLDS: tuple[Pattern, ...] = ("away", "home", "workers", "always")
# Hours of an office, every day (BOPTEST's `multizone_office_simple_air`).
OFFICE_HOURS = (6.0, 19.0)
PERSON_W = 80.0
# Days of the year modulo 7: 1 January is a Tuesday, as in BOPTEST.
_WEEKEND, _EVENINGS_OUT = (4, 5), (3, 4)
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
    memory = float(np.exp(-(time_s[1] - time_s[0]) / HOUR_S / _GAINS_HOURS))
    draws = rng.standard_normal(time_s.size)
    draws[1:] *= np.sqrt(1.0 - memory**2)
    # Not by SciPy's filter, which takes longer to load than all draws of a year.
    noise = np.fromiter(accumulate(draws.tolist(), lambda before, draw: draw + memory * before), float, draws.size)
    sd = np.sqrt(np.log1p(relative_sd**2))
    return np.asarray(np.exp(sd * noise - 0.5 * sd**2))


def set_back(present: Callable[[Array], NDArray[np.bool_]], time_s: Array, *, lead_s: float) -> NDArray[np.bool_]:
    """Return whether a native set-point is set back at `time_s`: nobody is `present` now or within `lead_s`."""
    # Presence within the preheating time, on the 15-min grid of the schedules.
    ahead = np.arange(0.0, lead_s + 1.0, 900.0)
    return np.asarray(~np.any([present(time_s + shift) for shift in ahead], axis=0))


STEP_S = 900.0
_PER_H, _PER_DAY = 4, 96
# Seeds of people begin with it, so that none of them draws what the building of that seed was drawn from.
_STREAM = 0x9E0B1E


@dataclass(frozen=True)
class Life:
    """What people do in `zones` Z, every 15 min of a year, n samples from 1 January 0:00 on.

    Attributes:
        present: number of people, guests included, shape (n,).
        cooking_W: heat of cooking, shape (n,).
        windows_1_h: air changes through open windows, beside infiltration, shape (Z, n).
        sun: share of the sun through a window that its blinds let pass, shape (Z, n).
    """

    present: Array
    cooking_W: Array
    windows_1_h: Array
    sun: Array


def live(
    key: Sequence[int],
    usual: NDArray[np.bool_],
    people: int,
    *,
    T_out_C: Array,
    solar_W_m2: Array,
    zones: int = 1,
    cooks: bool = True,
) -> Life:
    """Let `people` live for a year in a building that they use as `usual` says on the average.

    Args:
        key: seed and what tells this building from others; the same key gives the same life.
        usual: whether the building's schedule has people in, shape (n,).
        people: how many live or work there.
        T_out_C, solar_W_m2: outdoor temperature and global horizontal irradiance, shape (n,).
        zones: rooms with windows of their own.
        cooks: whether they cook.
    """
    rng = np.random.default_rng([_STREAM, *key])
    away = _stays(rng, _days(usual), 0.02)
    residents = sum((_resident(rng, usual, away) for _ in range(people)), np.zeros(usual.size))
    guests = _guests(rng, residents) if cooks else np.zeros(usual.size)
    cooking = _cooking(rng, residents, guests) if cooks else np.zeros(usual.size)
    windows, sun = np.zeros((zones, usual.size)), np.ones((zones, usual.size))
    for zone in range(zones):
        _open_windows(rng, residents, T_out_C, windows[zone])
        _close_blinds(rng, residents, solar_W_m2, sun[zone])
    return Life(residents + guests, cooking, windows, sun)


def _days(values: Array | NDArray[np.bool_]) -> int:
    return -(-values.size // _PER_DAY)


def _stays(rng: np.random.Generator, days: int, chance: float) -> NDArray[np.bool_]:
    """Days of absence of all, shape (days,); each is followed by another one in every second case."""
    begins, goes_on = rng.random(days) < chance, rng.random(days) < 0.5
    away = begins.copy()
    for day in range(1, days):
        away[day] |= away[day - 1] and goes_on[day]
    return away


def _resident(rng: np.random.Generator, usual: NDArray[np.bool_], away: NDArray[np.bool_]) -> Array:
    """Presence of one person, 0 or 1, shape (n,): the schedule at hours of their own, by weekday, and what differs."""
    steps, days = np.arange(usual.size), away.size
    day, hour = steps // _PER_DAY, steps % _PER_DAY / _PER_H
    weekday = np.arange(days) % 7
    late = np.rint(rng.normal(0.0, 2.0, 7)[weekday] + rng.normal(0.0, 1.5, days)).astype(int)
    here = usual[np.clip(steps - late[day], 0, usual.size - 1)]
    # Days at home: off or ill, and a weekday on which some work there.
    home_day = rng.integers(0, 7) if rng.random() < 0.3 else -1
    stays_in = (rng.random(days) < 0.04) | ((weekday == home_day) & (rng.random(days) < 0.85))
    here = here | (stays_in[day] & (hour >= 7.0) & (hour < 22.0))
    for _ in range(2):  # errands, sport, visits, on a weekday of their own
        on = (weekday == rng.integers(0, 7)) & (rng.random(days) < 0.8)
        leaves_h = rng.uniform(9.0, 19.0) + rng.normal(0.0, 0.5, days)
        here = here & ~(on[day] & (hour >= leaves_h[day]) & (hour < (leaves_h + rng.uniform(1.0, 4.0))[day]))
    return np.asarray(here & ~away[day], dtype=np.float64)


def _guests(rng: np.random.Generator, residents: Array) -> Array:
    """Number of guests, shape (n,): some evenings, more of them before a free day."""
    guests = np.zeros(residents.size)
    for day in range(_days(residents)):
        comes_h, stays_h, number = rng.uniform(17.5, 20.0), rng.uniform(2.0, 5.0), rng.integers(2, 6)
        if rng.random() < (0.2 if day % 7 in _EVENINGS_OUT else 0.05):
            guests[_span(day, comes_h, stays_h)] = number
    return guests * (residents > 0.0)


def _cooking(rng: np.random.Generator, residents: Array, guests: Array) -> Array:
    """Heat of cooking, W, shape (n,): dinners, and lunches on free days, half as much again for guests."""
    heat, dinner_h, lunch_h = np.zeros(residents.size), rng.uniform(17.5, 19.5), rng.uniform(11.5, 13.0)
    chance, usual_W = rng.uniform(0.6, 0.95, 7), rng.uniform(600.0, 1500.0)
    for day in range(_days(residents)):
        for at_h, likely in ((dinner_h, chance[day % 7]), (lunch_h, 0.5 if day % 7 in _WEEKEND else 0.1)):
            begins_h, lasts_h = at_h + rng.normal(0.0, 0.5), rng.uniform(0.5, 1.25)
            power_W = usual_W * rng.uniform(0.7, 1.3)
            span = _span(day, begins_h, lasts_h)
            if rng.random() < likely and residents[span].any():
                heat[span] = power_W * (1.5 if guests[span].any() else 1.0)
    return heat


def _open_windows(rng: np.random.Generator, residents: Array, T_out_C: Array, changes_1_h: Array) -> None:
    """Write air changes 1/h into `changes_1_h` (n,): habitual airing, less in the cold; a window left tilted."""
    airings_h, chance = (rng.uniform(6.5, 9.0), rng.uniform(19.5, 22.0)), rng.uniform(0.3, 0.9, (2, 7))
    wide_1_h = rng.uniform(0.8, 2.8)
    for day in range(_days(residents)):
        for at_h, by_weekday in zip(airings_h, chance, strict=True):
            begins_h, lasts_h, drawn = at_h + rng.normal(0.0, 0.5), rng.exponential(0.3), rng.random()
            now = min(day * _PER_DAY + round(at_h * _PER_H), residents.size - 1)
            mild = 1.0 / (1.0 + np.exp((8.0 - T_out_C[now]) / 4.0))
            if drawn < by_weekday[day % 7] * (0.4 + 0.6 * mild) and residents[now] > 0.0:
                changes_1_h[_span(day, begins_h, lasts_h * (1.0 + 4.0 * mild))] = wide_1_h
        left_h, hours, tilted_1_h = rng.uniform(7.0, 22.0), rng.uniform(3.0, 12.0), rng.uniform(0.3, 0.8)
        if rng.random() < 0.03:
            changes_1_h[_span(day, left_h, hours)] = tilted_1_h


def _close_blinds(rng: np.random.Generator, residents: Array, solar_W_m2: Array, sun: Array) -> None:
    """Write the share of the sun that blinds pass into `sun` (n,): closed when bright until evening, or left closed."""
    bright_W_m2, passing, chance = rng.uniform(200.0, 450.0), rng.uniform(0.25, 0.75), rng.uniform(0.2, 0.9, 7)
    for day in range(_days(residents)):
        today = slice(day * _PER_DAY, (day + 1) * _PER_DAY)
        cares, forgets = rng.random() < chance[day % 7], rng.random() < 0.05
        felt = (solar_W_m2[today] > bright_W_m2) & (residents[today] > 0.0)
        if cares and felt.any():
            sun[today.start + int(np.argmax(felt)) : today.stop + (_PER_DAY if forgets else 0)] = passing


def _span(day: int, begins_h: float, lasts_h: float) -> slice:
    """Samples of a time of `day`, one at least."""
    first = day * _PER_DAY + round(begins_h * _PER_H)
    return slice(first, first + max(round(lasts_h * _PER_H), 1))
