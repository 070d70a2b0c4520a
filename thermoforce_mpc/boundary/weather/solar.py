"""Sun position, irradiance on planes (pvlib, except where the BOPTEST test case differs), and sun from humidity.

pvlib is loaded where the sun is first computed: it takes half a second of a core, and processes that only carry weather
around, such as those of EnergyPlus, need none of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.errors import WeatherError

_OBLIQUITY_RAD = np.deg2rad(23.45)
_GROUND_REFLECTANCE = 0.2
_SOLAR_CONSTANT_W_M2 = 1367.0
_LEAST_DIFFUSE_W_M2 = 1e-4
# Least-squares fit of daily clearness to humidity and its square over the 16 TMY3 years of the United States shipped
# with EnergyPlus, days weighted by clear-sky energy. RMSE there: 0.11 to 0.21.
_COEFFICIENTS = (0.884, 0.484, -1.150)
# Overcast days keep a diffuse share; the maximum is the clear sky.
_CLEARNESS_RANGE = (0.1, 1.0)


@dataclass(frozen=True)
class SunPosition:
    """Sun position, rad, shape of the times: `declination`, `hour_angle` (0 at solar noon, positive after), `zenith`.

    `latitude` is that of the site, rad.
    """

    latitude: float
    declination: Array
    hour_angle: Array
    zenith: Array

    @property
    def azimuth(self) -> Array:
        """Azimuth clockwise from north, rad."""
        from pvlib import solarposition

        hour_angle = np.mod(self.hour_angle + np.pi, 2.0 * np.pi) - np.pi  # pvlib takes east or west from its sign
        return np.asarray(
            solarposition.solar_azimuth_analytical(self.latitude, hour_angle, self.declination, self.zenith)
        )


def sun_position(time_s: Array, latitude_deg: float, longitude_deg: float, timezone_h: float) -> SunPosition:
    """Return the sun position at `time_s` (s since 1 January, local standard time).

    Declination (23.45° obliquity) and equation of time (Duffie and Beckman) are those of the IBPSA library: the zenith
    agrees with the test case to the rounding of its records, 5e-6 rad. With pvlib's formulas its error is 0.013 rad or
    more, and the emulator's RMSE in April rises from 0.010 to 0.057 K or more.
    """
    from pvlib import solarposition

    time_s = np.asarray(time_s, dtype=np.float64)
    day = time_s / DAY_S
    declination = np.arcsin(-np.sin(_OBLIQUITY_RAD) * np.cos((day + 10.0) * 2.0 * np.pi / 365.25))
    b = 2.0 * np.pi * (day + 1.0 - 81.0) / 364.0  # day number counted from 1
    equation_of_time_s = 60.0 * (9.87 * np.sin(2.0 * b) - 7.53 * np.cos(b) - 1.5 * np.sin(b))
    solar_s = time_s + (longitude_deg / 15.0 - timezone_h) * HOUR_S + equation_of_time_s
    hour_angle = (solar_s / HOUR_S - 12.0) * 2.0 * np.pi / 24.0
    latitude = np.deg2rad(latitude_deg)
    zenith = solarposition.solar_zenith_analytical(latitude, hour_angle, declination)
    return SunPosition(latitude, declination, hour_angle, np.asarray(zenith))


@dataclass(frozen=True)
class PlaneIrradiance:
    """Irradiance on one plane, W/m²: `beam`, and `diffuse` from sky and ground; angle of incidence in degrees."""

    beam: Array
    diffuse: Array
    incidence_deg: Array


def on_plane(weather: Weather, sun: SunPosition, time_s: Array, tilt_deg: float, azimuth_deg: float) -> PlaneIrradiance:
    """Return the irradiance at `time_s` on a plane; `tilt_deg` 0 faces up, `azimuth_deg` is clockwise from north."""
    from pvlib import irradiance

    normal, diffuse = weather.at("normal_W_m2", time_s), weather.at("diffuse_W_m2", time_s)
    global_horizontal = weather.at("global_W_m2", time_s)
    angles = (tilt_deg, azimuth_deg, np.rad2deg(sun.zenith), np.rad2deg(sun.azimuth))
    beam = irradiance.beam_component(*angles, normal)
    sky = sky_diffuse(*angles, diffuse, global_horizontal - diffuse)
    ground = irradiance.get_ground_diffuse(tilt_deg, global_horizontal, albedo=_GROUND_REFLECTANCE)
    return PlaneIrradiance(np.asarray(beam), sky + ground, np.asarray(irradiance.aoi(*angles)))


def sky_diffuse(
    tilt_deg: float,
    azimuth_deg: float,
    zenith_deg: Array,
    sun_azimuth_deg: Array,
    diffuse_W_m2: Array,
    beam_W_m2: Array,
) -> Array:
    """Return sky diffuse irradiance on a plane, W/m², shape (n,): Perez et al. (1990) as in the test case.

    Three differences from pvlib's defaults, as in the test case's release of the IBPSA library. Clearness is taken from
    *horizontal* beam irradiance (corrected there in May 2021, issue 1477; 0.1 K in the emulator's zone). Diffuse
    irradiance counts after sunset as long as the weather file has any (up to 0.06 K). Brightness is at most 1 (without
    the limit a west wall receives up to 380 W/m² more at sunset). `diffuse_W_m2` and `beam_W_m2` are horizontal;
    azimuths are clockwise from north, `tilt_deg` 0 faces up, and the sun's zenith may exceed 90.
    """
    from pvlib import atmosphere, irradiance

    diffuse = np.maximum(diffuse_W_m2, _LEAST_DIFFUSE_W_M2)
    air_mass = atmosphere.get_relative_airmass(np.minimum(zenith_deg, 90.0), model="kasten1966")
    air_mass = np.minimum(air_mass, _SOLAR_CONSTANT_W_M2 / diffuse)
    sky = irradiance.perez(
        tilt_deg, azimuth_deg, diffuse, beam_W_m2, _SOLAR_CONSTANT_W_M2, zenith_deg, sun_azimuth_deg, air_mass
    )
    return np.asarray(np.where(diffuse_W_m2 > 0.0, sky, 0.0))


def clear_sky_W_m2(sun: SunPosition) -> Array:
    """Return clear-sky global horizontal irradiance, W/m², shape of `sun.zenith` (Haurwitz 1945)."""
    from pvlib import clearsky

    zenith_deg = pd.Series(np.rad2deg(sun.zenith).ravel())
    return clearsky.haurwitz(zenith_deg)["ghi"].to_numpy().reshape(sun.zenith.shape)


def sunlight_from_humidity(time_s: Array, humidity: Array, sun: SunPosition) -> Array:
    """Estimate global horizontal irradiance, W/m², (n,): clear-sky irradiance times one clearness per day.

    A day's clearness follows from its mean relative humidity, weighted by clear-sky irradiance: humidity stays high on
    cloudy days and falls on sunny ones, which holds for days, not for hours. RMSE of the daily clearness on Brussels'
    year, which is not in the fit: 0.16 (clear sky 0.51). The daily temperature range (Hargreaves and Samani 1982) does
    no better there and worse in most places (tests/boundary/weather/test_clearness.py).

    `time_s` (n,): s since 1 January, local standard time, of whole days; `humidity` (n,): 0 to 1, NaN if not measured;
    `sun` at `time_s`. The answer is 0 at night, NaN in daylight on days without a humidity measured in daylight. Raises
    `WeatherError` where shapes differ, or a humidity is not between 0 and 1.
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
