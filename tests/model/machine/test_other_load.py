"""Another load on a machine's meter: found by what it shows while the machine is off, and only then."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.other_load import OtherLoad, left_while_off, other_load, own_W
from thermoforce_mpc.model.machine.power import PowerModel

STEP_S, N = 900.0, 4 * 96
TIME_S = 30 * DAY_S + STEP_S * np.arange(N)
FULL_W = 4000.0


def weather(rng):
    return 5.0 - 4.0 * np.cos(2 * np.pi * TIME_S / DAY_S) + rng.normal(0.0, 0.3, N).cumsum() * 0.1


def levels(rng):
    return np.repeat(rng.random(N // 8) < 0.4, 8).astype(float)[None]


def coil_W(T_out_C, size=1500.0):
    hour = TIME_S % DAY_S / HOUR_S
    return 0.3 * size + size * ((hour >= 6) & (hour < 19)) * (18.0 - T_out_C) / 15.0


@pytest.mark.parametrize("seed", range(4))
def test_what_the_meter_shows_while_off_is_told_by_hour_and_weather(seed):
    rng = np.random.default_rng(seed)
    u, T = levels(rng), weather(rng)
    other = coil_W(T) * (1.0 + 0.05 * rng.standard_normal(N))
    found = other_load(u, TIME_S, T, FULL_W * u[0] + other)
    assert found is not None
    assert np.sqrt(np.mean((found(TIME_S, T) - coil_W(T)) ** 2)) < 0.25 * coil_W(T).mean()
    assert abs(found(TIME_S, T).mean() / coil_W(T).mean() - 1.0) < 0.05
    assert "another load" in found.in_words()
    assert (found(TIME_S, T + 60.0) >= 0.0).all()


def test_a_machine_alone_on_its_meter_has_none():
    rng = np.random.default_rng(1)
    u, T = levels(rng), weather(rng)
    assert other_load(u, TIME_S, T, FULL_W * u[0]) is None
    assert other_load(u, TIME_S, T, FULL_W * u[0] + 0.01 * FULL_W) is None, "a standby is not worth a law"
    assert other_load(u, TIME_S, T, np.zeros(N)) is None, "a dead meter"


def test_a_machine_that_runs_on_is_not_taken_for_another_load():
    rng = np.random.default_rng(2)
    u, T = levels(rng), weather(rng)
    after = np.concatenate([[0.0], u[0, :-1]]) * (u[0] == 0.0)
    assert other_load(u, TIME_S, T, FULL_W * (u[0] + 0.5 * after)) is None


def test_without_enough_steps_off_nothing_is_told():
    rng = np.random.default_rng(3)
    T = weather(rng)
    always = np.ones((1, N))
    always[0, :8] = 0.0
    assert other_load(always, TIME_S, T, FULL_W * always[0] + coil_W(T)) is None
    two = np.vstack([levels(rng), 1.0 - levels(np.random.default_rng(3))])
    two[1] = 1.0 - two[0]
    assert other_load(two, TIME_S, T, FULL_W + coil_W(T)) is None, "one of them is always on"


def test_a_load_that_hour_and_weather_hardly_tell_is_said():
    rng = np.random.default_rng(4)
    u, T = levels(rng), weather(rng)
    tank = 3000.0 * (rng.random(N) < 0.1)
    found = other_load(u, TIME_S, T, FULL_W * u[0] + tank)
    assert found is not None
    assert "hardly tell it" in found.in_words()


def test_what_an_emitter_still_gives_off_is_not_taken_for_another_load():
    rng = np.random.default_rng(5)
    u, T = levels(rng), weather(rng)
    for lag_h in (1.0, 8.0):
        kept = np.exp(-STEP_S / HOUR_S / lag_h)
        heat = np.zeros(N)
        for k in range(1, N):
            heat[k] = kept * heat[k - 1] + (1.0 - kept) * FULL_W * u[0, k]
        assert other_load(u, TIME_S, T, heat) is None, f"a time constant of {lag_h} h"


def test_a_load_is_that_of_its_hour_and_of_the_weather_within_its_range():
    found = OtherLoad(tuple(100.0 + hour for hour in range(24)), -10.0, 5.0, (0.0, 15.0), 1.0)
    time_s, T_out_C = 6 * HOUR_S + np.zeros(4), np.array([5.0, 2.0, -30.0, 40.0])
    np.testing.assert_allclose(found(time_s, T_out_C), [106.0, 136.0, 156.0, 6.0])
    assert not OtherLoad((0.0,) * 24, -10.0, 5.0, (0.0, 15.0), 1.0)(time_s, np.full(4, 8.0)).any(), "never below 0"


def test_a_load_that_the_meter_does_not_hold_while_the_machine_is_on_is_none():
    """Off at 8 and 23 only, when hot water took much and little: between them the meter holds half of such a load."""
    hour = TIME_S % DAY_S // HOUR_S
    off = (hour == 8) | (hour == 23)
    hot_water = np.where(hour == 8, 830.0, 20.0)
    T = weather(np.random.default_rng(5))
    assert other_load((~off)[None].astype(float), TIME_S, T, np.where(off, hot_water, 400.0)) is None
    off, load = hour % 2 == 0, np.where((hour >= 8) & (hour < 16), 830.0, 20.0)
    found = other_load((~off)[None].astype(float), TIME_S, T, np.where(off, load, 4000.0))
    assert found is not None
    assert found.mean_W == pytest.approx(load.mean(), rel=0.1)


def test_hours_in_which_a_load_comes_and_goes_say_nothing_of_the_machine():
    """Hot water from 6:15 to 7:00 on three of four days: a machine that runs gives its water then, not the rooms'."""
    rng = np.random.default_rng(6)
    time_s = 30 * DAY_S + STEP_S * np.arange(30 * 96)
    T = 5.0 + rng.normal(0.0, 0.3, time_s.size).cumsum() * 0.05
    u = np.repeat(rng.random(time_s.size // 8) < 0.5, 8).astype(float)[None]
    hour, day = time_s % DAY_S / HOUR_S, time_s // DAY_S
    water = (hour >= 6.25) & (hour < 7.0) & (day % 4 > 0)
    meter = np.where(water, 5000.0, FULL_W * u[0]) + 12.0
    found = other_load(u, time_s, T, meter)
    assert found is not None
    assert found.at_times == (6,)
    assert "in the hours from 6 it comes and goes" in found.in_words()
    assert found(np.array([6.5 * HOUR_S]), np.array([5.0]))[0] == pytest.approx(0.75 * 0.75 * 5000.0, rel=0.15)
    at_s, T = np.append(time_s, time_s[-1] + STEP_S), np.append(T, T[-1])
    record = Record(at_s, np.full(at_s.size, 20.0), T, np.zeros(at_s.size), u=u[0], power_W=meter, heat_W=u[0] * np.nan)
    own = own_W(record.power_W, [found], record)[0]
    assert np.isnan(own[(hour >= 6) & (hour < 7)]).all()
    on = (u[0] > 0.0) & np.isfinite(own)
    np.testing.assert_allclose(own[on], FULL_W, rtol=0.02)


@pytest.mark.parametrize(("rmse_W", "taken_back"), [(40.0, True), (900.0, False)])
def test_a_load_that_ends_is_not_believed_any_more_until_the_meter_holds_it_again(rmse_W, taken_back):
    """Taken back within a day and a half, by hours with the machine off; one that was hardly told is kept."""
    rng = np.random.default_rng(7)
    u, T = levels(rng), weather(rng)
    by_day = np.where((np.arange(24) >= 6) & (np.arange(24) < 19), 800.0, 0.0)
    load = OtherLoad(tuple(by_day), 0.0, 5.0, (-20.0, 30.0), rmse_W)
    day = (TIME_S - TIME_S[0]) / DAY_S
    there = (day < 1.0) | (day > 2.5)
    meter_W = FULL_W * u[0] + np.where(there, load(TIME_S, T), 0.0) + 10.0 * rng.standard_normal(N)
    believed = load.there(u, TIME_S, T, meter_W)
    assert believed[day < 1.25].all()
    assert believed[-1]
    assert believed.all() != taken_back
    assert believed[(day > 1.9) & (day < 2.5)].any() != taken_back
    power = PowerModel(MachineLoad((0.0, 0.0, FULL_W, 0.0), (-20.0, 30.0)), foreign=load)
    for k in range(2, N):
        rows = u[:, :k], TIME_S[:k], T[:k], meter_W[:k]
        assert load.there(*rows)[-1] == believed[k - 1], "as it was seen then"
        assert (power.seen(*rows).foreign is None) != believed[k - 1]
    assert load.there(np.ones_like(u), TIME_S, T, meter_W).all(), "a machine that is never off tells nothing"
    assert load.there(u, TIME_S, T, np.full(N, np.nan)).all()
    told = [load.news(believed[:k]) for k in range(2, N + 1)]
    assert len(list(filter(None, told))) == 2 * taken_back
    if taken_back:
        ended, again = filter(None, told)
        assert "lacks the other load of 433 W on average while the machine is off" in ended
        assert "again" in again


def test_a_load_that_lies_where_the_machine_was_never_seen_off_is_none():
    """Off at 7, when its tank is charged, and in the afternoon: nights are not known, though the machine takes more."""
    hour, T = TIME_S % DAY_S // HOUR_S, weather(np.random.default_rng(5))

    def found(off):
        meter_W = np.where(off, np.where(hour == 7, 1040.0, 90.0), 4000.0)
        return other_load((~off)[None].astype(float), TIME_S, T, meter_W)

    assert found((hour == 7) | (hour == 13)) is None
    assert found(hour % 2 == 1) is not None


def test_what_a_meter_shows_while_the_machine_is_off_is_not_the_machines():
    """900 W on the first day, none or 500 W on the second; 2 kW more while the machine runs."""
    hour = np.arange(48.0)
    on, T = hour % 4 < 2, np.full(48, 5.0)
    rest_W = np.where(on, 2000.0, np.where(hour < 20, 900.0, np.where((hour >= 34) & (hour < 40), 500.0, 0.0)))

    def found(u, steps=slice(None)):
        return left_while_off(u[None, steps].astype(float), HOUR_S * hour[steps], T[steps], rest_W[steps])

    assert found(on) == (0.0, 500.0)
    assert found(on, slice(0, 20)) == (900.0, 900.0)
    assert found(~on, slice(40, 48)) == (2000.0, 2000.0)
    assert found(np.ones(48)) is None
    assert found(on, slice(0, 0)) is None
