"""Random offices: names, what is drawn beside houses, and hours, bands and gains of their use."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.plants.people import HOUSEHOLDS, OFFICE_HOURS, at_home
from thermoforce_mpc.plants.rooms import draw_rooms, house_of_rooms
from thermoforce_mpc.plants.rooms.house import HOUSE, OFFICE
from thermoforce_mpc.plants.rooms.plant import bounds_C, gains_W, native_setpoints_C, people
from thermoforce_mpc.plants.testcases import load_testcase

# A week of quarter hours.
WEEK_S = 20 * DAY_S + np.arange(0.0, 7 * DAY_S, 900.0)
HOURS = WEEK_S % DAY_S / HOUR_S
IN_USE = (HOURS >= 6.0) & (HOURS < 19.0)


@pytest.fixture(scope="module")
def offices():
    return [draw_rooms(n, seed, OFFICE) for n in (1, 3, 5, 12, 30) for seed in range(8)]


@pytest.mark.slow
def test_names_resolve_to_offices():
    plant = house_of_rooms("office:5rooms:3")
    assert plant.zones == ("open_1", "open_2", "meeting", "corridor", "cell")
    assert plant.house == draw_rooms(5, 3, OFFICE)
    assert house_of_rooms(plant.house.name).house == plant.house
    assert house_of_rooms("office:2rooms").house.seed == house_of_rooms("house:2rooms").house.seed


def test_a_test_case_is_made_of_an_office():
    made, plant = load_testcase("office:3rooms:3"), house_of_rooms("office:3rooms:3")
    assert made.layout.names == plant.layout.names
    assert made.layout.floor_area_m2 == pytest.approx(plant.layout.floor_area_m2)
    assert made.area_m2 == pytest.approx(plant.house.floor_area_m2)


@pytest.mark.parametrize("name", ["office:0rooms", "office:31rooms", "office:rooms", "office:5", "shop:5rooms"])
def test_other_names_are_refused(name):
    with pytest.raises(InputError, match=r"expected house:Nrooms, house:Nrooms:SEED or office:…"):
        house_of_rooms(name)


def test_a_test_case_of_an_office_that_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="office:0rooms"):
        load_testcase("office:0rooms")


def test_a_number_of_rooms_is_refused_in_the_name_of_its_use():
    with pytest.raises(InputError, match="office of 31 rooms: expected a whole number from 1 to 30"):
        draw_rooms(31, 1, OFFICE)


def test_houses_are_as_before_there_were_offices():
    """Figures of the revision before offices."""
    house = draw_rooms(5, 15)
    assert (house.use, house.name) == ("house", "house:5rooms:15")
    assert [room.kind for room in house.rooms] == ["living", "kitchen", "bath", "bedroom", "bedroom"]
    assert (house.people, house.pattern, house.weather_seed) == (2, "home", 1594672906)
    assert house.floor_area_m2 == pytest.approx(78.73629498721895, rel=1e-12)
    assert house.heat_pump.capacity_W == pytest.approx(3596.8840711949547, rel=1e-12)
    large = draw_rooms(14, 3)
    assert (large.people, large.pattern, large.weather_seed) == (4, "away", 1153267735)
    assert large.floor_area_m2 == pytest.approx(181.96238980991757, rel=1e-12)


def test_offices_are_drawn_from_their_own_ranges(offices):
    assert {room.kind for office in offices for room in office.rooms} == set(OFFICE.kinds)
    assert not set(OFFICE.kinds) & set(HOUSE.kinds)
    assert {office.mass for office in offices} == set(OFFICE.masses) == {"very light", "light", "medium"}
    assert {frozenset(room.emitter for room in office.rooms) for office in offices} == {
        frozenset({"air"}),
        frozenset({"radiator"}),
    }
    assert {office.pattern for office in offices} == {"office"}
    assert "office" not in HOUSEHOLDS
    for office in offices:
        assert 1.5 <= office.sizing <= 2.2
        assert office.heat_pump.capacity_W == pytest.approx(office.sizing * office.design_load_W)
        assert 0.15 <= office.unshaded <= 0.35
        assert 3.0 <= office.gains_home_W_m2 <= 7.0
        assert office.floor_area_m2 / 31.0 - 0.5 <= office.people <= office.floor_area_m2 / 15.0 + 0.5
        assert office.words.endswith(", ".join(f"{room.name} ({room.emitter})" for room in office.rooms))
    assert offices[0] == draw_rooms(1, 0, OFFICE)


def test_a_coil_is_light_gives_its_heat_to_the_air_and_has_a_curve(offices):
    office = next(office for office in offices if office.rooms[0].emitter == "air")
    assert set(office.curves) == {"air"}
    for room in office.rooms:
        assert (room.convective, room.emitter_exponent, room.slab_J_K) == (1.0, 1.0, 0.0)
        assert room.emitter_J_K / room.emitter_W_Kn == pytest.approx(270.0), "s"


def test_an_office_is_in_use_from_6_to_19_h_every_day(offices):
    assert OFFICE_HOURS == (6.0, 19.0)
    np.testing.assert_array_equal(at_home("office", WEEK_S), IN_USE)
    office = offices[10]
    lower, upper = bounds_C(office, WEEK_S)
    for room, low, high in zip(office.rooms, lower, upper, strict=True):
        np.testing.assert_array_equal(low, np.where(IN_USE, room.lower_C, 15.0))
        np.testing.assert_array_equal(high, np.where(IN_USE, room.upper_C, 30.0))
        assert 19.0 <= room.lower_C <= 21.0
        assert 4.0 <= room.upper_C - room.lower_C <= 6.0


def test_nobody_sleeps_there_and_appliances_rest_at_night(offices):
    office = offices[10]
    there = people(office, WEEK_S).sum(axis=0)
    assert there[~IN_USE].max() == 0.0
    assert there[IN_USE] == pytest.approx(np.full(IN_USE.sum(), float(office.people)))
    gains = gains_W(office, WEEK_S).sum(axis=0)
    assert gains[IN_USE].mean() > 3.0 * gains[~IN_USE].mean() > 0.0


def test_native_control_sets_back_at_night_and_is_up_again_at_6(offices):
    office = next(office for office in offices if office.rooms[0].emitter == "air")
    setpoints = native_setpoints_C(office, WEEK_S)
    for room, T in zip(office.rooms, setpoints, strict=True):
        assert T[IN_USE].min() == T.max() == pytest.approx(room.lower_C + 0.4)
        assert T[HOURS == 2.0].max() < T.max() - 1.0
