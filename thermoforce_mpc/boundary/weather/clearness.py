"""Estimate of global irradiance from relative humidity: clear-sky irradiance times one clearness per day.

Relative humidity stays high on cloudy days and falls on sunny ones. This holds for days, not for hours, so each day
gets one clearness. RMSE of the daily clearness on Brussels' year, which is not in the fit: 0.16 (clear sky 0.51; the
best constant, chosen on that year, 0.20). The daily temperature range (Hargreaves and Samani 1982) has the same error
there and a larger one in most other places (tests/boundary/weather/test_clearness.py).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from pvlib import clearsky

from thermoforce_mpc.boundary.weather.solar import Sun
from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.errors import WeatherError

# Least-squares fit of daily clearness to humidity and its square over the 16 TMY3 years of the United States shipped
# with EnergyPlus, days weighted by clear-sky energy. RMSE there: 0.11 to 0.21.
_COEFFICIENTS = (0.884, 0.484, -1.150)
# Overcast days keep a diffuse share; the maximum is the clear sky.
_CLEARNESS_RANGE = (0.1, 1.0)


def clear_sky_W_m2(sun: Sun) -> Array:
    """Return clear-sky global horizontal irradiance, W/m², shape of `sun.zenith` (Haurwitz 1945)."""
    zenith_deg = pd.Series(np.rad2deg(sun.zenith).ravel())
    return clearsky.haurwitz(zenith_deg)["ghi"].to_numpy().reshape(sun.zenith.shape)


def sunlight_from_humidity(time_s: Array, humidity: Array, sun: Sun) -> Array:
    """Estimate global horizontal irradiance, W/m², shape (n,). Valid for daily sums, not for single hours.

    A day's clearness follows from its mean relative humidity, weighted by clear-sky irradiance. Only the given,
    measured hours of a day count. Give whole days: mornings alone are more humid than their day.

    Args:
        time_s: s since 1 January, local standard time, shape (n,); a day runs from midnight to midnight.
        humidity: outdoor relative humidity, 0 to 1, shape (n,), NaN if not measured.
        sun: sun position at `time_s`.

    Returns:
        Irradiance: 0 at night, NaN in daylight on days without a humidity measured in daylight.

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
