"""People who do not keep to the schedule: habits, surprises, and what the plants make of them."""

from __future__ import annotations

import copy
from functools import partial

import numpy as np
import pytest

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants import random_houses, rooms
from thermoforce_mpc.plants.embedded import EmbeddedPlant, kernel
from thermoforce_mpc.plants.people import live
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.rooms import house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import PlantSpec

HOURS = np.arange(0.0, 365 * 24, 0.25)
USUAL = (HOURS // 24 % 7 >= 4) | (HOURS % 24 < 7) | (HOURS % 24 >= 17)
COLD, MILD = np.full(HOURS.size, -5.0), np.full(HOURS.size, 18.0)
SUN = 500.0 * np.maximum(np.sin((HOURS % 24 - 6) / 12 * np.pi), 0.0)
lived = partial(live, usual=USUAL, people=4, T_out_C=COLD, solar_W_m2=SUN)
PLANTS = {
    "embedded": lambda people: EmbeddedPlant(synthetic_weather(), people=people),
    "generated": lambda people: GeneratedHousePlant(draw_house(2026, 0), people=people),
    "rooms": partial(house_of_rooms, "house:3rooms"),
    "office": partial(house_of_rooms, "office:2rooms"),
}
STEPPED_BY = {"embedded": kernel, "generated": random_houses.physics, "rooms": rooms.physics, "office": rooms.physics}


def test_a_seed_is_one_life_and_another_seed_another():
    first, again, other = lived([7]), lived([7]), lived([8])
    for name in ("present", "cooking_W", "windows_1_h", "sun"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert (getattr(first, name) != getattr(other, name)).mean() > 0.01


def test_people_keep_to_the_schedule_on_the_average_but_on_hardly_a_working_day():
    present = lived([7]).present
    assert present.mean() == pytest.approx(4 * USUAL.mean(), rel=0.15)
    differs = (present != 4 * USUAL).reshape(-1, 96).any(axis=1)
    assert differs[np.arange(365) % 7 < 4].mean() > 0.95
    assert present.max() > 4  # guests
    assert (present.reshape(-1, 96) == 0).all(axis=1).any()  # a day away


def test_habits_are_those_of_the_weekday():
    present = np.concatenate([lived([seed]).present[: 52 * 672].reshape(52, 672) for seed in range(4)], axis=1)
    habit, week = present[::2].mean(axis=0).reshape(4, 7, 96), present[1::2].mean(axis=0).reshape(4, 7, 96)
    workdays = [0, 1, 2, 3, 6]
    same = np.abs(habit[:, workdays] - week[:, workdays]).mean()
    next_day = np.abs(habit[:, workdays] - np.roll(week[:, workdays], 1, axis=1)).mean()
    assert same < 0.8 * next_day


def test_nobody_cooks_airs_or_closes_blinds_in_an_empty_house_and_no_office_cooks():
    nobody = live([7], np.zeros(HOURS.size, dtype=bool), 0, T_out_C=MILD, solar_W_m2=SUN)
    assert not nobody.present.any()
    assert not nobody.cooking_W.any()
    assert (nobody.sun == 1.0).all()
    assert nobody.windows_1_h.max() < 0.8 < lived([7]).windows_1_h.max()  # but a window may be left
    assert not lived([7], cooks=False).cooking_W.any()


def test_windows_are_open_longer_in_mild_weather_and_each_room_has_its_own():
    cold, mild = lived([7], zones=3).windows_1_h, lived([7], zones=3, T_out_C=MILD).windows_1_h
    assert (mild > 0).mean() > 1.5 * (cold > 0).mean()
    assert (cold[0] != cold[1]).any()


def test_blinds_close_in_bright_sun_only():
    life = lived([7])
    assert life.sun.min() >= 0.25
    assert (life.sun[0, SUN > 400] < 1.0).mean() > 0.1
    dark = lived([7], solar_W_m2=np.full(HOURS.size, 100.0))
    assert (dark.sun == 1.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_people_change_the_building_and_nobody_announces_them(name):
    usual, lively = PLANTS[name](None), PLANTS[name](7)
    window = "typical_heat_day"
    assert lively.period(window) == usual.period(window)
    for plant in (usual, lively):
        plant.reset(44 * DAY_S, 3 * DAY_S)
    told = [plant.forecast(DAY_S, HOUR_S) for plant in (usual, lively)]
    for field in ("T_out_C", "solar_W_m2", "occupancy", "lower_C", "upper_C"):
        np.testing.assert_array_equal(*(getattr(boundary, field) for boundary in told))
    assert np.abs(usual.past(HOUR_S).T_zone_C - lively.past(HOUR_S).T_zone_C).max() > 0.1
    copy.deepcopy(lively).advance(None, 900.0)
    assert len(STEPPED_BY[name].advance.signatures) == 1, "compiled anew, for seconds: for arrays that may be written?"


@pytest.mark.slow
def test_windows_of_the_weather_are_the_same_with_and_without_people():
    weather = synthetic_weather(3)
    lively = EmbeddedPlant(weather, people=7)
    before = lively.past(HOUR_S)
    np.testing.assert_array_equal(
        lively.native_powers_W()["P_heat_pump"], EmbeddedPlant(weather).native_powers_W()["P_heat_pump"]
    )
    np.testing.assert_array_equal(lively.past(HOUR_S).T_zone_C, before.T_zone_C)


def test_people_move_into_the_plants_that_have_room_for_them_and_no_other():
    for name in ("bestest_hydronic_heat_pump", "generated:2026:1", "house:2rooms"):
        plant = build_plant(PlantSpec(people=3), load_testcase(name), 1)
        plant.reset(44 * DAY_S, DAY_S)
    with pytest.raises(ConfigError, match=r"plant\.people"):
        build_plant(PlantSpec(people=3, kind="boptest"), load_testcase("bestest_hydronic_heat_pump"), 1)
