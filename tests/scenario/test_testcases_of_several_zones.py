"""Test cases of several zones: what they say, and how a wrong name is refused."""

from __future__ import annotations

import pytest

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.keys import canonical
from thermoforce_mpc.plants.rooms import house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase


@pytest.fixture
def apartment():
    from thermoforce_mpc.scenario.settings import find_config

    return read_yaml(find_config("testcases", "twozone_apartment_hydronic"))


def test_one_zone_is_the_building_of_one_of_each():
    points = load_testcase("bestest_hydronic_heat_pump").points
    assert points.layout.names.single
    assert (len(points.zones), len(points.actuators), len(points.machines)) == (1, 1, 1)
    assert points.layout.floor_area_m2 == (192.0,)


def test_what_acts_where_is_read(apartment):
    layout = validate(TestCase, apartment, "file").layout
    assert layout.names.zones == ("Day", "Night")
    assert layout.home == (0, 1)
    assert layout.machine_of == (0, 0)
    assert layout.shares == (0.5, 0.5), "equal shares of the machine where none are given"


def test_what_was_derived_of_a_building_is_not_that_of_a_changed_copy_nor_part_of_its_key(apartment):
    building = validate(TestCase, apartment, "file")
    key = canonical(building)
    zones = building.points.zones
    assert canonical(building) == key
    larger = building.zones | {"Day": building.zones["Day"].model_copy(update={"floor_area_m2": 99.0})}
    copy = building.model_copy(update={"zones": larger})
    assert copy.layout.floor_area_m2[0] == 99.0
    assert (building.points.zones, building.model_copy().points.zones) == (zones, zones)


def test_every_shipped_building_of_several_zones_loads():
    assert load_testcase("energyplus:small_office").layout.mode(0) == "both"
    house = load_testcase("house:3rooms")
    assert len(house.layout.home) == 3
    assert house.layout.shares == pytest.approx(house_of_rooms("house:3rooms").layout.shares)
    with pytest.raises(ConfigError, match="house:0rooms"):
        load_testcase("house:0rooms")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actuators": {"day_valve": {"zone": "Dya"}}}, r"actuators.day_valve.zone: there is no zone 'Dya'.*'Day'"),
        ({"actuators": {"day_valve": {"machine": "pump"}}}, "actuators.day_valve.machine: there is no machine 'pump'"),
        ({"machines": {"boiler": {"power": ["x"]}}}, "machines.boiler: it feeds no actuator"),
        ({"zones": {"Day": {"temperature": None}}}, "zones.Day.temperature"),
        ({"actuator": {"point": "x"}}, "leave out actuator"),
    ],
    ids=["zone", "machine", "idle machine", "no sensor", "both forms"],
)
def test_what_does_not_fit_is_refused_by_key(apartment, change, message):
    from thermoforce_mpc.scenario.settings import merge

    with pytest.raises(ConfigError, match=message):
        validate(TestCase, merge(apartment, change), "file")
