"""The written-out sky against pvlib's where the two mean the same, and its own traits where they do not."""

from __future__ import annotations

import numpy as np
import pvlib
import pytest

from thermoforce_mpc.boundary.weather.perez import relative_air_mass, sky_diffuse

RNG = np.random.default_rng(0)
N = 2000
ZENITH = RNG.uniform(0.1, np.deg2rad(84.0), N)
AZIMUTH = RNG.uniform(-np.pi / 2, np.pi / 2, N)
# No brighter than a sky can be: pvlib does not limit the brightness to 1.
DIFFUSE = RNG.uniform(5.0, 300.0, N) * np.cos(ZENITH)
NORMAL = RNG.uniform(0.0, 900.0, N)


def incidence(tilt: float) -> np.ndarray:
    """Cosine towards a plane that faces south."""
    return np.cos(ZENITH) * np.cos(tilt) + np.sin(ZENITH) * np.sin(tilt) * np.cos(AZIMUTH)


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, 90.0])
def test_with_direct_normal_it_is_pvlibs_perez(tilt_deg):
    tilt = np.deg2rad(tilt_deg)
    ours = sky_diffuse(DIFFUSE, NORMAL, ZENITH, incidence(tilt), tilt)
    theirs = pvlib.irradiance.perez(
        surface_tilt=tilt_deg, surface_azimuth=180.0, dhi=DIFFUSE, dni=NORMAL, dni_extra=1367.0,
        solar_zenith=np.rad2deg(ZENITH), solar_azimuth=np.rad2deg(AZIMUTH) + 180.0,
        airmass=relative_air_mass(ZENITH),
    )  # fmt: skip
    # pvlib rounds the coefficients to three digits; near an edge between two bins either may be right.
    off = np.abs(ours - theirs)
    assert np.quantile(off, 0.99) < 0.5
    assert off.mean() < 0.2


def test_the_air_mass_is_kastens():
    theirs = pvlib.atmosphere.get_relative_airmass(np.rad2deg(ZENITH), model="kasten1966")
    np.testing.assert_allclose(relative_air_mass(ZENITH), theirs, rtol=1e-3)
    assert relative_air_mass(np.array([2.0])) == pytest.approx(relative_air_mass(np.array([np.pi / 2])))


def test_a_flat_plane_sees_the_whole_sky():
    np.testing.assert_allclose(sky_diffuse(DIFFUSE, NORMAL, ZENITH, np.cos(ZENITH), 0.0), DIFFUSE)


def test_light_goes_on_when_the_sun_has_just_set():
    after = sky_diffuse(np.array([40.0]), np.array([5.0]), np.array([np.deg2rad(91.0)]), np.array([0.6]), np.pi / 2)
    assert after > 10.0


def test_no_diffuse_light_is_no_light():
    assert sky_diffuse(np.zeros(1), np.zeros(1), np.array([1.0]), np.array([0.5]), np.pi / 2) == 0.0


def test_the_horizontal_beam_means_a_duller_sky_and_less_light_on_a_winter_south_wall():
    zenith = np.full(1, np.deg2rad(78.0))
    towards = np.full(1, np.sin(zenith[0]))
    diffuse, normal = np.full(1, 60.0), np.full(1, 300.0)
    by_normal = sky_diffuse(diffuse, normal, zenith, towards, np.pi / 2)
    by_horizontal = sky_diffuse(diffuse, normal * np.cos(zenith), zenith, towards, np.pi / 2)
    assert by_horizontal < 0.85 * by_normal
