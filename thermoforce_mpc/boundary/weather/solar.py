"""Sun position and irradiance on tilted planes: pvlib, except where the BOPTEST test case differs from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pvlib import atmosphere, irradiance, solarposition

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array

_OBLIQUITY_RAD = np.deg2rad(23.45)
_GROUND_REFLECTANCE = 0.2
_SOLAR_CONSTANT_W_M2 = 1367.0
_LEAST_DIFFUSE_W_M2 = 1e-4


@dataclass(frozen=True)
class Sun:
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
        hour_angle = np.mod(self.hour_angle + np.pi, 2.0 * np.pi) - np.pi  # pvlib takes east or west from its sign
        return np.asarray(
            solarposition.solar_azimuth_analytical(self.latitude, hour_angle, self.declination, self.zenith)
        )


def sun_position(time_s: Array, latitude_deg: float, longitude_deg: float, timezone_h: float) -> Sun:
    """Return the sun position at `time_s` (s since 1 January, local standard time).

    Declination (23.45° obliquity) and equation of time (Duffie and Beckman) are those of the IBPSA library: the zenith
    agrees with the test case to the rounding of its records, 5e-6 rad. With pvlib's formulas the zenith error is up to
    0.013 rad (Cooper), 0.015 rad (Spencer) or 0.016 rad (true sun position), and the emulator's RMSE in April rises
    from 0.010 to 0.057 K or more.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    day = time_s / DAY_S
    declination = np.arcsin(-np.sin(_OBLIQUITY_RAD) * np.cos((day + 10.0) * 2.0 * np.pi / 365.25))
    b = 2.0 * np.pi * (day + 1.0 - 81.0) / 364.0  # day number counted from 1
    equation_of_time_s = 60.0 * (9.87 * np.sin(2.0 * b) - 7.53 * np.cos(b) - 1.5 * np.sin(b))
    solar_s = time_s + (longitude_deg / 15.0 - timezone_h) * HOUR_S + equation_of_time_s
    hour_angle = (solar_s / HOUR_S - 12.0) * 2.0 * np.pi / 24.0
    latitude = np.deg2rad(latitude_deg)
    zenith = solarposition.solar_zenith_analytical(latitude, hour_angle, declination)
    return Sun(latitude, declination, hour_angle, np.asarray(zenith))


@dataclass(frozen=True)
class PlaneIrradiance:
    """Irradiance on one plane, W/m²: `beam`, and `diffuse` from sky and ground; angle of incidence in degrees."""

    beam: Array
    diffuse: Array
    incidence_deg: Array


def on_plane(weather: Weather, sun: Sun, time_s: Array, tilt_deg: float, azimuth_deg: float) -> PlaneIrradiance:
    """Return the irradiance at `time_s` on a plane; `tilt_deg` 0 faces up, `azimuth_deg` is clockwise from north."""
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
    the limit a west wall receives up to 380 W/m² more at sunset).

    Args:
        tilt_deg: tilt of the plane, 0 faces up.
        azimuth_deg: azimuth of the plane, clockwise from north.
        zenith_deg: zenith of the sun, may exceed 90, shape (n,) as all below.
        sun_azimuth_deg: azimuth of the sun, clockwise from north.
        diffuse_W_m2: diffuse horizontal irradiance.
        beam_W_m2: beam part of the global horizontal irradiance.
    """
    diffuse = np.maximum(diffuse_W_m2, _LEAST_DIFFUSE_W_M2)
    air_mass = atmosphere.get_relative_airmass(np.minimum(zenith_deg, 90.0), model="kasten1966")
    air_mass = np.minimum(air_mass, _SOLAR_CONSTANT_W_M2 / diffuse)
    sky = irradiance.perez(
        tilt_deg, azimuth_deg, diffuse, beam_W_m2, _SOLAR_CONSTANT_W_M2, zenith_deg, sun_azimuth_deg, air_mass
    )
    return np.asarray(np.where(diffuse_W_m2 > 0.0, sky, 0.0))
