"""Whether a weather year can be that of its place: what cannot is refused, what is doubtful is said."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.errors import WeatherError
from thermoforce_mpc.files import DoubtfulInput

# Mean of a year, °C: the extremes on Earth are Vostok (-55) and Dallol (35).
_MEAN_C = (-60.0, 40.0)
_USUAL_MEAN_C = (-25.0, 32.0)
# An hour is dark if the sun is so far below the horizon in its middle: 7.5 degrees to its end, and astronomical dusk.
_DARK_DEG = -12.0
_MOST_IN_THE_DARK = 0.01
_STUCK_H = 72


def check_plausible(weather: Weather, path: Path) -> None:
    """Check a weather year that was read from `path`; `DoubtfulInput` warns of what is improbable.

    Raises:
        WeatherError: the mean temperature is that of no place on Earth, or the sun shines at night.
    """
    mean_C = float(weather.T_dry_C.mean())
    if not _MEAN_C[0] <= mean_C <= _MEAN_C[1]:
        raise WeatherError(
            f"{path}: the year's mean temperature is {mean_C:.1f} °C, that of no place on Earth; is the column in °C?"
        )
    sun = weather.global_W_m2 + weather.normal_W_m2 + weather.diffuse_W_m2
    shining = float(sun.sum())
    if shining > 0:
        # Rows are means over the hour that ends there.
        middle_s: Array = (np.arange(float(sun.size)) - 0.5) * HOUR_S
        zenith = sun_position(middle_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).zenith
        share = float(sun[np.rad2deg(zenith) > 90.0 - _DARK_DEG].sum()) / shining
        if share > _MOST_IN_THE_DARK:
            raise WeatherError(
                f"{path}: {100 * share:.0f} % of the year's sun shines in the dark at latitude "
                f"{weather.latitude_deg:g}, longitude {weather.longitude_deg:g}, time zone {weather.timezone_h:g} h; "
                "these are wrong, or the rows are shifted"
            )
    for doubt in _doubts(weather, mean_C, shining):
        warnings.warn(f"{path}: {doubt}", DoubtfulInput, stacklevel=3)


def _doubts(weather: Weather, mean_C: float, shining: float) -> list[str]:
    doubts = []
    if not _USUAL_MEAN_C[0] <= mean_C <= _USUAL_MEAN_C[1]:
        doubts.append(f"the year's mean temperature is {mean_C:.1f} °C: few people live there")
    if shining == 0:
        doubts.append("the sun never shines in it: the columns of irradiance are empty")
    changes = np.flatnonzero(np.diff(weather.T_dry_C) != 0)
    stuck = np.diff(np.concatenate([[-1], changes, [weather.T_dry_C.size - 1]]))
    if stuck.max() > _STUCK_H:
        first = int(np.concatenate([[0], changes + 1])[int(stuck.argmax())])
        doubts.append(
            f"the temperature is {weather.T_dry_C[first]:g} °C for {int(stuck.max())} hours from day {first // 24 + 1}"
        )
    return doubts
