"""The sun of the test case, and its sky where it is not pvlib's default."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pvlib
import pytest

from thermoforce_mpc.boundary.weather import Weather, load_weather, synthetic_weather
from thermoforce_mpc.boundary.weather.solar import on_plane, sky_diffuse, sun_position
from thermoforce_mpc.data import DAY_S, HOUR_S

SOUTH, WEST = 180.0, 270.0


def weather_of(normal_W_m2: float, diffuse_W_m2: float, global_W_m2: float) -> Weather:
    """A year with the same light at every row, in Brussels."""
    light = {"normal_W_m2": normal_W_m2, "diffuse_W_m2": diffuse_W_m2, "global_W_m2": global_W_m2}
    rest = {"T_dry_C": 5.0, "T_dew_C": 1.0, "wind_m_s": 4.0, "wind_from_rad": 1.0, "opaque_cover": 0.5}
    rest |= {"relative_humidity": 0.75, "infrared_W_m2": 300.0, "total_cover": 0.5, "ceiling_m": 22_000.0}
    columns = {name: np.full(8760, value) for name, value in (light | rest | {"pressure_Pa": 101_300.0}).items()}
    return Weather(name="constant", latitude_deg=50.9, longitude_deg=4.53, timezone_h=1.0, **columns)


def test_the_zenith_is_that_of_the_test_cases_records(shared):
    real = pd.read_csv(shared / "boptest_hp" / "boundary_hourly.csv.gz").iloc[:8760]
    brussels = load_weather(shared / "boptest_hp" / "Brussels.mos")
    sun = sun_position(real.time.to_numpy(), brussels.latitude_deg, brussels.longitude_deg, brussels.timezone_h)
    np.testing.assert_allclose(sun.zenith, real.solZen, atol=6e-6)


@pytest.mark.parametrize("longitude_deg", [4.53, -7.0], ids=["east", "west"])
def test_at_every_hour_the_sun_stands_within_a_degree_of_the_true_one(longitude_deg):
    # The declination is taken from a cosine; far west of the zone's meridian the solar day ends after midnight.
    time_s = (np.array([20, 110, 200, 290])[:, None] * DAY_S + np.arange(24)[None] * HOUR_S).ravel()
    ours = sun_position(time_s, 50.9, longitude_deg, 1.0)
    stamps = pd.Timestamp("2019-01-01", tz="Etc/GMT-1") + pd.to_timedelta(time_s, unit="s")
    true = pvlib.solarposition.get_solarposition(stamps, 50.9, longitude_deg)
    np.testing.assert_allclose(np.rad2deg(ours.zenith), true.zenith, atol=1.0)
    off = (np.rad2deg(ours.azimuth) - true.azimuth + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(off, 0.0, atol=1.5)


def test_a_flat_plane_receives_the_global_irradiance():
    weather = synthetic_weather()
    time_s = np.arange(150 * DAY_S, 160 * DAY_S, HOUR_S)
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    flat = on_plane(weather, sun, time_s, 0.0, SOUTH)
    total = (flat.beam + flat.diffuse).sum()
    assert total == pytest.approx(weather.at("global_W_m2", time_s).sum(), rel=0.05)


def test_south_collects_most_in_winter_and_north_no_beam():
    weather = synthetic_weather()
    time_s = np.arange(0, 30 * DAY_S, HOUR_S)
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    sums = {azimuth: on_plane(weather, sun, time_s, 90.0, azimuth).beam.sum() for azimuth in (0.0, 90.0, SOUTH, WEST)}
    assert sums[SOUTH] > 2 * max(sums[WEST], sums[90.0])
    assert sums[0.0] == 0.0


def test_mornings_shine_on_the_east_and_noon_straight_on_the_south():
    weather = weather_of(500.0, 100.0, 300.0)
    time_s = 80 * DAY_S + np.array([9.0, 13.0, 16.0]) * HOUR_S  # solar noon is at 12:49
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    east, south = (on_plane(weather, sun, time_s, 90.0, azimuth) for azimuth in (90.0, SOUTH))
    assert (east.beam > 0).tolist() == [True, False, False]
    assert south.incidence_deg[1] == pytest.approx(90.0 - np.rad2deg(sun.zenith[1]), abs=1.5)
    assert south.incidence_deg.argmin() == 1


def test_the_sky_is_judged_by_horizontal_beam_light_and_so_duller_than_pvlibs_at_low_sun():
    weather = weather_of(300.0, 60.0, 120.0)
    time_s = 10 * DAY_S + np.array([11.0, 12.0, 13.0]) * HOUR_S
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    zenith, azimuth = np.rad2deg(sun.zenith), np.rad2deg(sun.azimuth)
    air_mass = pvlib.atmosphere.get_relative_airmass(zenith, "kasten1966")
    theirs = pvlib.irradiance.perez(90.0, SOUTH, 60.0, 300.0, 1367.0, zenith, azimuth, air_mass)
    ground = 0.1 * 120.0
    assert (on_plane(weather, sun, time_s, 90.0, SOUTH).diffuse - ground < 0.9 * theirs).all()


def test_light_goes_on_when_the_sun_has_just_set():
    after = sky_diffuse(90.0, WEST, np.array([91.0]), np.array([WEST]), np.array([40.0]), np.array([5.0]))
    assert after > 10.0


def test_a_sky_is_no_brighter_than_the_sun():
    at_the_horizon = np.array([89.9])
    west = sky_diffuse(90.0, WEST, at_the_horizon, np.array([WEST]), np.array([70.0]), np.array([10.0]))
    brightness_of_one = 1367.0 / 37.0  # diffuse light at which the air mass there makes it 1
    limit = sky_diffuse(90.0, WEST, at_the_horizon, np.array([WEST]), np.array([brightness_of_one]), np.array([10.0]))
    assert west / 70.0 < 1.2 * limit / brightness_of_one


def test_no_diffuse_light_is_no_light():
    zenith = np.array([57.0, 100.0])
    assert (sky_diffuse(90.0, SOUTH, zenith, np.full(2, 200.0), np.zeros(2), np.zeros(2)) == 0.0).all()
