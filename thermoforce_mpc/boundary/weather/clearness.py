"""Sunlight where none was measured: a clear sky's, dimmed day by day by how humid the outdoor air was.

Cloud leaves its mark in what nearly every station records: a clouded day is humid throughout, on a sunny one the air
warms and dries. The mark is a matter of days, not of hours, so a day gets one clearness. On Brussels' year, which the
coefficients have not seen, the error of a day's clearness is 0.16 (a clear sky's 0.51, one constant's, chosen
afterwards, 0.20); the range of temperature of the day (Hargreaves and Samani 1982) does as well there, and worse in
most other places (tests/boundary/weather/test_clearness.py).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from pvlib import clearsky

from thermoforce_mpc.boundary.weather.solar import Sun
from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.errors import WeatherError

# Least squares of a day's clearness on its humidity and its square over sixteen typical years of the United States
# (TMY3, those that EnergyPlus brings), days weighted by a clear sky's energy. Its errors there are 0.11 to 0.21.
_COEFFICIENTS = (0.884, 0.484, -1.150)
# Some light comes through any cloud, and no day beats a clear one.
_CLEARNESS_RANGE = (0.1, 1.0)


def clear_sky_W_m2(sun: Sun) -> Array:
    """Global horizontal irradiance under a clear sky, W/m², shape of `sun.zenith` (Haurwitz 1945)."""
    zenith_deg = pd.Series(np.rad2deg(sun.zenith).ravel())
    return clearsky.haurwitz(zenith_deg)["ghi"].to_numpy().reshape(sun.zenith.shape)


def sunlight_from_humidity(time_s: Array, humidity: Array, sun: Sun) -> Array:
    """Estimated global horizontal irradiance, W/m², shape (n,): right for days, not for the clouds of an hour.

    A day's clearness follows from its relative humidity, averaged with a clear sky's irradiance as the weight. A day of
    which only a part is given is judged by that part, and hours in which humidity was not measured do not count: what
    is left may be a morning, more humid than its day, so give whole days.

    Args:
        time_s: s since 1 January, local standard time, shape (n,); a day is from midnight to midnight.
        humidity: relative humidity outdoors, 0 to 1, shape (n,), NaN where not measured.
        sun: its position at `time_s`.

    Returns:
        NaN by daylight on days without any humidity measured by daylight, zero at night.

    Raises:
        WeatherError: shapes differ, or a humidity is not between 0 and 1.
    """
    time_s, humidity = np.asarray(time_s, dtype=np.float64), np.asarray(humidity, dtype=np.float64)
    if not time_s.shape == humidity.shape == sun.zenith.shape or time_s.ndim != 1:
        raise WeatherError(
            f"sunlight from humidity: {time_s.shape} times, {humidity.shape} humidities and {sun.zenith.shape} "
            "positions of the sun; give the same number of each, in one dimension"
        )
    wrong = np.flatnonzero((humidity < 0.0) | (humidity > 1.0))
    if wrong.size:
        raise WeatherError(
            f"sunlight from humidity: humidity is {humidity[wrong[0]]:g} at {time_s[wrong[0]]:g} s ({wrong.size} "
            "such); expected 0 to 1, so divide percentages by 100"
        )
    clear = clear_sky_W_m2(sun)
    day = np.unique(np.floor(time_s / DAY_S), return_inverse=True)[1]
    weight = np.where(np.isfinite(humidity), clear, 0.0)
    total = np.bincount(day, weight)
    of_day = np.full(total.size, np.nan)
    np.divide(np.bincount(day, weight * np.nan_to_num(humidity)), total, out=of_day, where=total > 0.0)
    constant, linear, square = _COEFFICIENTS
    clearness = np.clip(constant + linear * of_day + square * of_day**2, *_CLEARNESS_RANGE)
    return np.where(clear > 0.0, clear * clearness[day], 0.0)
