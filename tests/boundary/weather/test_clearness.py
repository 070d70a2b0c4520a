"""Sunlight where none was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pvlib
import pytest

from thermoforce_mpc.boundary.weather import Weather, load_weather
from thermoforce_mpc.boundary.weather.solar import clear_sky_W_m2, sun_position, sunlight_from_humidity
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import WeatherError

YEAR = np.arange(8760) * HOUR_S


def june(days: int = 3):
    time_s = (170 + np.arange(days * 24) / 24.0) * DAY_S
    return time_s, sun_position(time_s, 50.5, 4.0, 1.0)


def errors_of_a_year(weather: Weather) -> dict[str, float]:
    """Root mean square error of the clearness of days by several methods, days weighted by a clear sky's energy."""
    sun = sun_position(YEAR, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    clear = clear_sky_W_m2(sun).reshape(365, 24).mean(axis=1)
    truth = weather.at("global_W_m2", YEAR).reshape(365, 24).mean(axis=1) / clear
    humidity = np.minimum(pvlib.atmosphere.rh_from_tdew(weather.T_dry_C, weather.T_dew_C) / 100.0, 1.0)
    estimate = sunlight_from_humidity(YEAR, humidity, sun).reshape(365, 24).mean(axis=1) / clear
    T = weather.T_dry_C.reshape(365, 24)
    by_range = np.minimum(0.16 * np.sqrt(T.max(axis=1) - T.min(axis=1)) / 0.75, 1.0)

    def rms(clearness):
        return float(np.sqrt(np.average((clearness - truth) ** 2, weights=clear)))

    constant = np.average(truth, weights=clear)
    return {"humidity": rms(estimate), "range": rms(by_range), "clear": rms(1.0), "constant": rms(constant)}


def test_a_clear_sky_is_bright_at_noon_dark_at_night_and_keeps_its_shape():
    _, sun = june(2)
    clear = clear_sky_W_m2(replace(sun, zenith=sun.zenith.reshape(2, 24)))
    np.testing.assert_array_equal(clear.ravel(), clear_sky_W_m2(sun))
    assert 850 < clear[0].max() < 1000
    assert (clear[np.cos(sun.zenith.reshape(2, 24)) <= 0] == 0).all()


def test_a_humid_day_is_darker_than_a_dry_one_and_nights_are_dark():
    time_s, sun = june()
    humidity = np.repeat([0.4, 0.7, 0.95], 24)
    light = sunlight_from_humidity(time_s, humidity, sun)
    share = light.reshape(3, 24).sum(axis=1) / clear_sky_W_m2(sun).reshape(3, 24).sum(axis=1)
    assert 0.8 < share[0] <= 1.0
    assert share[0] > share[1] + 0.1 > share[2] + 0.3
    assert share[2] >= 0.1
    assert (light[np.cos(sun.zenith) <= 0] == 0).all()


def test_only_humidity_by_daylight_counts_and_gaps_are_left_out():
    time_s, sun = june(1)
    humidity = np.full(24, 0.5)
    light = sunlight_from_humidity(time_s, humidity, sun)
    changed = np.where(clear_sky_W_m2(sun) > 0, humidity, 0.99)
    changed[10:14] = np.nan
    np.testing.assert_allclose(sunlight_from_humidity(time_s, changed, sun), light)


def test_a_part_of_a_day_is_judged_by_that_part():
    time_s, sun = june(1)
    humidity = np.linspace(0.9, 0.4, 24)
    whole = sunlight_from_humidity(time_s, humidity, sun)
    morning = slice(0, 10)
    part = sunlight_from_humidity(time_s[morning], humidity[morning], sun_position(time_s[morning], 50.5, 4.0, 1.0))
    assert part[8] < 0.9 * whole[8]


def test_a_day_without_humidity_has_no_estimate():
    time_s, sun = june()
    humidity = np.full(72, 0.5)
    humidity[24:48] = np.nan
    light = sunlight_from_humidity(time_s, humidity, sun)
    daylight = clear_sky_W_m2(sun) > 0
    np.testing.assert_array_equal(np.isnan(light), daylight & np.isnan(humidity))


def test_percentages_and_other_shapes_are_refused():
    time_s, sun = june(1)
    with pytest.raises(WeatherError, match="divide percentages by 100"):
        sunlight_from_humidity(time_s, np.full(24, 55.0), sun)
    with pytest.raises(WeatherError, match="same number of each"):
        sunlight_from_humidity(time_s, np.full(23, 0.5), sun)


def test_on_a_year_it_was_not_fitted_to_days_are_told_apart(shared):
    errors = errors_of_a_year(load_weather(shared / "boptest_hp" / "Brussels.mos"))
    assert errors["humidity"] < 0.165
    assert errors["humidity"] < 0.85 * errors["constant"] < 0.5 * errors["clear"]
    assert errors["range"] < errors["humidity"] < 1.05 * errors["range"]


@pytest.mark.slow
def test_over_many_climates_humidity_says_more_than_the_range_of_temperature():
    energyplus = pytest.importorskip("pyenergyplus")
    years = sorted((Path(energyplus.__file__).parent / "data" / "weather").glob("*.epw"))
    found = [errors_of_a_year(load_weather(year)) for year in years]
    assert len(found) >= 16
    mean = {name: np.mean([errors[name] for errors in found]) for name in found[0]}
    assert mean["humidity"] < 0.16 < 0.9 * mean["range"]
    assert all(errors["humidity"] < 0.22 for errors in found)
