"""What drives the synthetic rooms: weather that hangs together, people with habits, thermostats of others."""

import numpy as np
import pytest

from benchmarks.pretraining.climate import first_order, random_weather
from benchmarks.pretraining.occupants import held_by_others, random_people

N, TOTAL = 200, 24 * 28


@pytest.fixture(scope="module")
def hour():
    return np.arange(TOTAL, dtype=float) + np.zeros((N, 1))


def test_weather_has_nights_a_daily_wave_and_days_that_resemble_the_day_before(hour):
    outdoor, sun, irradiance = random_weather(np.random.default_rng(0), hour, np.ones(N))
    assert outdoor.shape == sun.shape == irradiance.shape == (N, TOTAL)
    assert ((sun > 0) <= (irradiance > 0)).all()
    assert irradiance.max() <= 1.5
    assert (sun >= 0).all()
    of_day = sun.reshape(N, 28, 24)
    assert (of_day[:, :, :3] == 0).all()
    assert (of_day[:, :, 11:14].mean(axis=(1, 2)) > 0).all()
    wave = outdoor.reshape(N, 28, 24).mean(axis=1)
    assert (wave[:, 12:18].mean(axis=1) > wave[:, 2:6].mean(axis=1)).mean() > 0.95
    daily = of_day.sum(axis=2)
    alike = [np.corrcoef(row[:-1], row[1:])[0, 1] for row in daily]
    assert np.median(alike) > 0.2
    assert 1.0 < np.median(outdoor.std(axis=1)) < 10.0


def test_noise_is_forgotten_in_the_time_it_is_told():
    noise = first_order(np.random.default_rng(1), 400, 300, np.full(400, 0.5), np.full(400, 10.0))
    assert noise.var() == pytest.approx(1.0, abs=0.1)
    later = np.mean(noise[:, 100] * noise[:, 120])  # 20 steps of half an hour are one correlation time
    assert later == pytest.approx(np.exp(-1), abs=0.15)


def test_people_keep_hours_and_differ_from_day_to_day(hour):
    people = random_people(np.random.default_rng(2), hour).reshape(N, 28, 24)
    assert np.isfinite(people).all()
    usual = np.median(people, axis=1)
    assert ((usual.max(axis=1) - usual.min(axis=1)) > 0.2).mean() > 0.7
    assert (people.sum(axis=2).std(axis=1) > 0).all()


def test_a_room_held_by_others_is_kept_from_falling_and_follows_from_above(hour):
    free = 15 + 6 * np.sin(2 * np.pi * hour / (24 * 14))
    held = held_by_others(np.random.default_rng(3), free, hour, np.ones(N))
    low, high = np.quantile(held, [0.05, 0.95], axis=1)
    assert np.median(high - low) < 0.8 * (np.quantile(free[0], 0.95) - np.quantile(free[0], 0.05))
    assert (held.min(axis=1) > free.min(axis=1)).mean() > 0.7
    assert (held >= free - 4.0).all()  # a set-back of the thermostat, no more
