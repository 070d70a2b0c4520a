"""BOPTEST's scored windows: two weeks around the peak and the typical day of heating, and cooling, in a weather year.

Rule (BOPTEST's tool for finding days): in a year of native control, the peak day has the highest 15-min mean of the
power of heating; the typical day's highest 15-min mean is the nearest at or below the median over all heating days.
Both days must leave room for the warm-up and the second week (BOPTEST requires this of the peak day only). The same of
cooling. The mix day is not found as BOPTEST does, of which no rule is known: it has the most of the lesser of heating
and cooling, each by its highest mean over that of its peak day.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, Array, Period
from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.errors import InputError, StorageError
from thermoforce_mpc.files import read_json, write_json

NAMES = ("peak_heat_day", "typical_heat_day")
BOTH_NAMES = (*NAMES, "peak_cool_day", "typical_cool_day", "mix_day")
_QUARTERS = 96
_HALF_WINDOW_D = 7
# Days that leave room for the warm-up and first week before, and the second week after.
_AVAILABLE = range(14, 358)
# Of a file of kept windows.
_MOST_BYTES = 1000
_ACTING_W = 1.0


# Days that BOPTEST publishes for its own weather, by test case: hash of that year, days. The emulators reproduce the
# peak days by the rule, but not each typical day: days next to the median in rank lie months apart, so a difference of
# 1 W, or another release of the test case, changes it.
_BRUSSELS = "01b75e2289e4"
_PUBLISHED = {
    "bestest_hydronic_heat_pump": (_BRUSSELS, (23, 115)),
    "bestest_hydronic": (_BRUSSELS, (318, 341)),
    "bestest_air": ("d93ba901f897", (341, 51, 289, 153, 21)),
}


def published_windows(testcase: str, weather: Weather) -> dict[str, Period] | None:
    """Return the windows that BOPTEST publishes for a test case in its own weather, or None for any other weather."""
    year, days = _PUBLISHED.get(testcase, ("", ()))
    if _of_year(weather) != year:
        return None
    return {name: centred_window(name, day) for name, day in zip(BOTH_NAMES, days, strict=False)}


def _of_year(weather: Weather) -> str:
    """Hash of what a release of a file does not change: temperature and irradiance."""
    rows = np.concatenate([np.round(column, 1) + 0.0 for column in (weather.T_dry_C, weather.global_W_m2)])
    return hashlib.sha256(rows.astype("<f8").tobytes()).hexdigest()[:12]


def heating_windows(power_W: Array) -> dict[str, Period]:
    """Return both windows by BOPTEST's rule from a year's 15-min means of heating power, W, (35040,)."""
    return _windows(power_W, NAMES)


def all_windows(heating_W: Array, cooling_W: Array) -> dict[str, Period]:
    """Return the windows of heating, of cooling and of both, from a year's 15-min means of power, W, (35040,) each."""
    lesser = np.minimum(
        *(_highest(power_W) / max(float(power_W.max()), _ACTING_W) for power_W in (heating_W, cooling_W))
    )
    available = np.array(_AVAILABLE)
    mixed = int(available[np.argmax(lesser[available])])
    windows = _windows(heating_W, NAMES) | _windows(cooling_W, BOTH_NAMES[2:4])
    return windows | {"mix_day": centred_window("mix_day", mixed)}


def kept_windows(
    depends_on: Sequence[str], names: tuple[str, ...], find: Callable[[], dict[str, Period]]
) -> dict[str, Period]:
    """Return the windows that `find` finds: for them a year is simulated, so their days are kept in the cache folder.

    `depends_on`: all that decides about them. A file there that does not hold days by these names is written anew;
    where nothing can be kept they are found each time.
    """
    key = hashlib.sha256(" ".join(depends_on).encode()).hexdigest()[:32]
    with suppress(RuntimeError, InputError):  # RuntimeError: who runs this has no home
        file = cache_folder() / "windows" / f"{key}.json"
        kept = read_json(file, _MOST_BYTES)
        if tuple(kept) == names and all(isinstance(day, int) and day in _AVAILABLE for day in kept.values()):
            return {name: centred_window(name, day) for name, day in kept.items()}
    found = find()
    with suppress(RuntimeError, OSError, StorageError):
        file = cache_folder() / "windows" / f"{key}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        days = {name: round(window.start_s / DAY_S) + _HALF_WINDOW_D for name, window in found.items()}
        write_json(file, days, follow=True)
    return found


def _highest(power_W: Array) -> Array:
    return np.asarray(np.asarray(power_W).reshape(365, _QUARTERS).max(axis=1))


def _windows(power_W: Array, names: tuple[str, ...]) -> dict[str, Period]:
    highest = _highest(power_W)
    available = np.array(_AVAILABLE)
    peak = int(available[np.argmax(highest[available])])
    median = float(np.median(highest[highest > _ACTING_W])) if (highest > _ACTING_W).any() else 0.0
    not_above = available[highest[available] <= median]
    typical = int(not_above[np.argmax(highest[not_above])])
    return {name: centred_window(name, day) for name, day in zip(names, (peak, typical), strict=True)}


def centred_window(name: str, day: int) -> Period:
    """Return the two weeks around `day` (day of the year, from 0), as in BOPTEST's scenarios."""
    return Period(name, (day - _HALF_WINDOW_D) * DAY_S)
