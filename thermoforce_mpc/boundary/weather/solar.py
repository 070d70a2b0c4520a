"""The sun's position in solar time, and irradiance on tilted planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.boundary.weather.perez import sky_diffuse
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array

_OBLIQUITY_RAD = np.deg2rad(23.45)
_GROUND_REFLECTANCE = 0.2


@dataclass(frozen=True)
class Sun:
    """Position at each instant, rad: `declination`, `hour_angle` (0 at solar noon, positive after) and `zenith`."""

    latitude: float
    declination: Array
    hour_angle: Array
    zenith: Array

    def cos_incidence(self, tilt: float, azimuth: float) -> Array:
        """Cosine of the angle to a plane's normal; `azimuth` 0 south, positive towards west, `tilt` 0 facing up, rad.

        Duffie and Beckman, Solar Engineering of Thermal Processes, eq. 1.6.2.
        """
        phi, delta, omega = self.latitude, self.declination, self.hour_angle
        return np.asarray(
            np.sin(delta) * np.sin(phi) * np.cos(tilt)
            - np.sin(delta) * np.cos(phi) * np.sin(tilt) * np.cos(azimuth)
            + np.cos(delta) * np.cos(phi) * np.cos(tilt) * np.cos(omega)
            + np.cos(delta) * np.sin(phi) * np.sin(tilt) * np.cos(azimuth) * np.cos(omega)
            + np.cos(delta) * np.sin(tilt) * np.sin(azimuth) * np.sin(omega)
        )

    @property
    def azimuth(self) -> Array:
        """0 south, positive towards west, rad."""
        east_west = np.cos(self.declination) * np.sin(self.hour_angle)
        north_south = np.sin(self.latitude) * np.cos(self.declination) * np.cos(self.hour_angle) - np.cos(
            self.latitude
        ) * np.sin(self.declination)
        return np.asarray(np.arctan2(east_west, north_south))


def sun_position(time_s: Array, latitude_deg: float, longitude_deg: float, timezone_h: float) -> Sun:
    """Position of the sun at `time_s` (s since 1 January, local standard time).

    Declination with 23.45° obliquity and the equation of time of Duffie and Beckman, as in the IBPSA Modelica library.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    day = time_s / DAY_S
    declination = np.arcsin(-np.sin(_OBLIQUITY_RAD) * np.cos((day + 10.0) * 2.0 * np.pi / 365.25))
    b = 2.0 * np.pi * (day + 1.0 - 81.0) / 364.0  # day number counted from 1
    equation_of_time_s = 60.0 * (9.87 * np.sin(2.0 * b) - 7.53 * np.cos(b) - 1.5 * np.sin(b))
    solar_s = time_s + (longitude_deg / 15.0 - timezone_h) * HOUR_S + equation_of_time_s
    hour_angle = (solar_s / HOUR_S - 12.0) * 2.0 * np.pi / 24.0
    latitude = np.deg2rad(latitude_deg)
    cos_zenith = np.cos(latitude) * np.cos(declination) * np.cos(hour_angle) + np.sin(latitude) * np.sin(declination)
    return Sun(latitude, declination, hour_angle, np.arccos(np.clip(cos_zenith, -1.0, 1.0)))


@dataclass(frozen=True)
class PlaneIrradiance:
    """On one plane, W/m²: `beam`, and `diffuse` from sky and ground; `incidence` rad."""

    beam: Array
    diffuse: Array
    incidence: Array


def on_plane(weather: Weather, sun: Sun, time_s: Array, tilt: float, azimuth: float) -> PlaneIrradiance:
    """Irradiance on a plane (`azimuth` 0 south, west positive; rad) under an anisotropic sky, see `weather.perez`."""
    normal, diffuse = weather.at("normal_W_m2", time_s), weather.at("diffuse_W_m2", time_s)
    global_horizontal = weather.at("global_W_m2", time_s)
    cos_incidence = sun.cos_incidence(tilt, azimuth)
    sky = sky_diffuse(diffuse, global_horizontal - diffuse, sun.zenith, cos_incidence, tilt)
    ground = _GROUND_REFLECTANCE * global_horizontal * (1.0 - np.cos(tilt)) / 2.0
    beam = normal * np.maximum(cos_incidence, 0.0)
    return PlaneIrradiance(beam, sky + ground, np.arccos(np.clip(cos_incidence, -1.0, 1.0)))
