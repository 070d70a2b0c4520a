"""Actuator maps: strictly increasing, `level` the inverse of `value`, and the room's part in them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.scenario.testcase import Actuator, TestCase

WATER = {"point": "water", "minimum": 293.15, "maximum": 343.15, "unit": "K", "held": {"pump": 1.0}, "switch": "pump"}
AIR = {"point": "fan", "map": "fan_coil", "supply": "air"}
MAPS = {
    "linear": Actuator(point="a", minimum=10.0, maximum=30.0),
    "falling": Actuator(point="a", minimum=10.0, maximum=30.0, rising=False),
    "radiator": Actuator(**WATER, map="radiator"),
    "floor": Actuator(**WATER, map="radiator", exponent=1.1),
    "fan coil, heating": Actuator(**AIR, held={"air": 313.15}),
    "fan coil, cooling": Actuator(**AIR, held={"air": 285.15}),
}


@pytest.mark.parametrize("name", MAPS)
def test_the_level_is_the_inverse_of_the_value_and_both_are_strictly_monotone(name):
    actuator = MAPS[name]
    for T_zone_C in (math.nan, 16.0, 20.0, 23.5, 28.0):
        u = np.linspace(0.02, 1.0, 99)
        values = np.array([actuator.value(one, T_zone_C) for one in u])
        # At its end the value cannot follow: a warm room cannot have all of a radiator's heat.
        free = (values > actuator.minimum) & (values < actuator.maximum)
        assert free.sum() > 40
        steps = np.diff(values[free])
        assert (steps > 0).all() if actuator.rising else (steps < 0).all()
        np.testing.assert_allclose(actuator.level(values[free], np.full(free.sum(), T_zone_C)), u[free], atol=1e-9)
        assert (np.diff(values) >= 0).all() if actuator.rising else (np.diff(values) <= 0).all()


@pytest.mark.parametrize("name", MAPS)
def test_values_and_levels_stay_inside_their_ranges(name):
    actuator = MAPS[name]
    for T_zone_C in (-10.0, 15.0, 25.0, 45.0):
        values = [actuator.value(u, T_zone_C) for u in (0.0, 1e-6, 0.5, 1.0)]
        assert min(values) >= actuator.minimum
        assert max(values) <= actuator.maximum
        levels = actuator.level(np.linspace(0.0, 400.0, 50), np.full(50, T_zone_C))
        assert levels.min() >= 0.0
        assert levels.max() <= 1.0


def test_a_radiator_gives_its_heat_by_the_waters_excess_to_the_exponent():
    radiator = MAPS["radiator"]
    assert radiator.value(0.5, 18.0) == pytest.approx(273.15 + 18.0 + 50.0 * 0.5 ** (1 / 1.3))
    assert float(radiator.level(313.15, 22.0)) == pytest.approx((18.0 / 50.0) ** 1.3)
    assert float(radiator.level(293.15, 21.0)) == 0.0, "water colder than the room"
    assert radiator.value(1.0, 25.0) == 343.15
    assert float(radiator.level(343.15, 25.0)) == pytest.approx((45.0 / 50.0) ** 1.3)


def test_without_its_switch_nothing_flows():
    radiator = MAPS["radiator"]
    assert radiator.inputs(0.3, 20.0)["pump_u"] == 1.0
    assert radiator.inputs(0.0, 15.0)["pump_u"] == 0.0
    level = radiator.level(np.full(2, 323.15), np.full(2, 20.0), {"pump": np.array([0.0, 1.0])})
    assert level[0] == 0.0 < level[1]


def test_a_fan_coils_flow_counts_for_less_as_the_room_nears_the_air():
    heating = MAPS["fan coil, heating"]
    assert float(heating.level(0.5, 20.0)) == pytest.approx(0.5)
    assert float(heating.level(0.5, 30.0)) == pytest.approx(0.25)
    assert heating.value(0.25, 30.0) == pytest.approx(0.5)
    warm_air = {"air": np.array(293.15)}
    assert float(heating.level(1.0, 25.0, warm_air)) == 0.0, "native control blows air colder than the room"
    assert float(MAPS["fan coil, cooling"].level(0.5, 24.0)) == pytest.approx(0.5 * 12 / 8)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"switch": "pomp"}, "switch: 'pomp' is not one of the points in held"),
        ({"map": "radiator", "unit": "1"}, "map radiator: the value is a water temperature in K"),
        ({"map": "radiator", "rising": False}, "the value rises with u"),
        ({"map": "fan_coil"}, "map fan_coil and supply go together"),
        ({"map": "fan_coil", "supply": "pump", "held": {"pump": 293.15}}, "held at the room's temperature"),
        ({"map": "valve"}, "map"),
    ],
)
def test_a_map_that_does_not_fit_is_refused(wrong, words):
    with pytest.raises(ConfigError, match=words):
        validate(Actuator, WATER | wrong, "x.yaml")


def test_a_radiator_is_a_machine_whose_heat_follows_the_level():
    assert load_testcase("bestest_hydronic").actuator.map == "radiator"


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("bestest_hydronic_heat_pump", {"rising": False}, r"(?s)x\.yaml.*actuator\.rising: False.*`embedded`"),
        ("bestest_hydronic_heat_pump", {"maximum": 0.8}, r"(?s)x\.yaml.*actuator\.maximum: 0\.8.*compressor speed"),
        ("bestest_hydronic_heat_pump", {"held": {"ovePum": 1.0}}, r"(?s)x\.yaml.*actuator\.held.*would ignore it"),
        (
            "energyplus_heating_chicago",
            {"map": "radiator", "unit": "K", "minimum": 300.0, "maximum": 340.0},
            r"actuator\.map: radiator.*`energyplus`",
        ),
        ("energyplus_heating_chicago", {"minimum": 400.0}, r"actuator\.minimum: 400\.0.*the level as heat"),
    ],
)
def test_what_an_emulator_would_ignore_is_refused(name, wrong, words):
    given = load_testcase(name).model_dump()
    given["actuator"] |= wrong
    with pytest.raises(ConfigError, match=words):
        validate(TestCase, given, "x.yaml")
    validate(TestCase, given | {"embedded": False, "energyplus": None}, "x.yaml")  # over REST it counts


def test_an_energyplus_zone_has_the_source_that_its_test_case_names():
    zone = load_testcase("energyplus:heating_chicago")
    other = zone.model_copy(update={"actuator": zone.actuator.model_copy(update={"maximum": 5000.0})})
    with pytest.raises(ConfigError, match=r"actuator\.maximum is 5000.*4000 W"):
        EnergyPlusPlant(other)
