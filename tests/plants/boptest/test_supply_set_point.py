"""The set-point of a machine's water: what heat is asked for, what it gave, and what native control gets back."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import numpy as np
import pytest
from places import SHARED

from thermoforce_mpc.data import DAY_S, Block, Measurement
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.points import inputs, recorded_levels
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.building import Supply
from thermoforce_mpc.scenario.settings import find_config, merge, read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase

SUPPLY = Supply(point="oveTSup", minimum=293.15, maximum=318.15, flow_W_per_K=400.0)
APARTMENT = load_testcase("twozone_apartment_hydronic")
WATER, DAY, NIGHT = "hydronicSystem_oveTHea", "hydronicSystem_oveMDayZ", "hydronicSystem_oveMNigZ"
ROOMS_C = np.array([21.0, 20.0])


@pytest.mark.parametrize("takes_W_per_K", [60.0, 150.0, 400.0])
def test_heat_comes_to_what_was_asked_for_without_overshoot(takes_W_per_K):
    """A floor at 24 °C that takes less per kelvin than the water carries."""
    last_K, gave_W, given = math.nan, math.nan, []
    for _ in range(40):
        last_K = SUPPLY.value(900.0, 21.0, last_K, gave_W)
        gave_W = max(takes_W_per_K * (last_K - 273.15 - 24.0), 0.0)
        given.append(gave_W)
    assert given[-1] == pytest.approx(900.0, rel=0.02)
    assert max(given) <= 900.0 + 1e-6


def test_water_stays_within_its_limits_and_is_warm_where_nothing_is_measured():
    assert SUPPLY.value(1e5, 21.0) == SUPPLY.maximum
    assert SUPPLY.value(0.0, 5.0, 300.0, 9000.0) == SUPPLY.minimum
    assert SUPPLY.value(900.0, math.nan) == SUPPLY.maximum


def after(**points: float) -> Measurement:
    values = {f"{name}_y": value for name, value in points.items()}
    values["hydronicSystem_reaTretFloHea_y"] = 297.15
    no = np.full(1, np.nan)
    return Measurement(
        0.0, ROOMS_C, 0.0, 0.0, np.array([0.3, 0.0]), no, np.array([600.0, 0.0]), no, values, APARTMENT.layout.names
    )


def test_the_neediest_valve_says_how_warm_the_water_is_and_the_others_are_open_or_closed():
    last = after(**{WATER: 303.15, DAY: 1.0, NIGHT: 0.0})
    sent = inputs(APARTMENT.points, Block((0.4, 0.0), 900.0), ROOMS_C, last)
    assert (sent[f"{DAY}_u"], sent[f"{NIGHT}_u"]) == (1.0, 0.0)
    assert sent[f"{WATER}_u"] == pytest.approx(303.15 + (0.4 * 2500.0 - 600.0) / 407.0)
    opened = inputs(APARTMENT.points, Block((0.1, 0.3), 900.0), ROOMS_C, last)
    assert (opened[f"{DAY}_u"], opened[f"{NIGHT}_u"]) == (1.0, 1.0)
    assert opened[f"{WATER}_u"] == pytest.approx(297.15 + 0.3 * 2500.0 / 407.0), "from the water that comes back"
    idle = inputs(APARTMENT.points, Block((0.0, 0.0), 900.0), ROOMS_C, last)
    assert (idle[f"{WATER}_u"], idle[f"{WATER}_activate"]) == (293.15, 1.0)


def test_native_control_gets_its_water_back():
    released = inputs(APARTMENT.points, Block((None, None), 900.0), ROOMS_C)
    assert {name: value for name, value in released.items() if value} == {}
    assert f"{WATER}_activate" in released
    half = inputs(APARTMENT.points, Block((None, 0.0), 900.0), ROOMS_C)
    assert half[f"{WATER}_activate"] == 0.0, "the native valve may need warm water"


def test_the_level_of_a_valve_is_its_heat():
    record = {"dayZon_reaPowFlooHea_y": np.array([0.0, 1000.0, 4000.0]), "nigZon_reaPowFlooHea_y": np.zeros(3)}
    record |= {"dayZon_reaTRooAir_y": np.full(3, 294.0), "nigZon_reaTRooAir_y": np.full(3, 294.0)}
    levels = recorded_levels(record, APARTMENT.points, {DAY: np.ones(3), NIGHT: np.ones(3), WATER: np.full(3, 303.0)})
    assert levels.tolist() == [[0.0, 0.4, 1.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"actuators": {"day_valve": {"full_W": None}}},
            "actuators.day_valve: machines.heat_pump.supply asks for valves",
        ),
        ({"actuators": {"day_valve": {"heat": []}}}, "supply asks for valves with heat"),
        ({"machines": {"heat_pump": {"supply": None}}}, "full_W belongs to a machine with supply"),
        ({"machines": {"heat_pump": {"supply": {"point": DAY}}}}, f"supply: '{DAY}' is a point of actuators.day_valve"),
        ({"machines": {"heat_pump": {"supply": {"maximum": 280.0}}}}, "must be below maximum"),
        ({"machines": {"heat_pump": {"supply": {"maximum": 35.0}}}}, "K"),
        ({"machines": {"heat_pump": {"held": {WATER: 303.0}}}}, f"supply: '{WATER}' is one of the points in held"),
    ],
    ids=["no full heat", "no meter", "no supply", "a valve", "reversed", "Celsius", "held too"],
)
def test_what_does_not_fit_is_refused_by_key(change, message):
    content = read_yaml(find_config("testcases", "twozone_apartment_hydronic"))
    with pytest.raises(ConfigError, match=message):
        validate(TestCase, merge(content, change), "file")


FMU = SHARED / "boptest_more" / "fmu" / "twozone_apartment_hydronic.fmu"


def _why_not_here() -> str:
    """Why the FMU cannot be run here, or an empty string."""
    if not FMU.is_file():
        return f"{FMU} is not there"
    try:
        ctypes.CDLL("libgfortran.so.5")
    except OSError:
        return f"{FMU} needs libgfortran5, which this machine has not"
    return ""


_WHY_NOT = _why_not_here()
needs_fmu = pytest.mark.skipif(bool(_WHY_NOT), reason=_WHY_NOT)


@needs_fmu
def test_over_rest_the_water_is_set_as_from_the_fmu(tmp_path: Path):
    """The same measurements to the bit, also while native control has the valves back."""
    from boptest_server import running_service
    from fmu_service import FmuService

    from thermoforce_mpc.plants.boptest.plant import BoptestPlant
    from thermoforce_mpc.plants.fmu.plant import FmuPlant

    def course(plant):
        found = [plant.reset(20 * DAY_S, 0.0)]
        found += [plant.advance(u, 900.0) for u in ((0.4, 0.4), (0.8, 0.0), None, (0.0, 0.0), (0.2, 0.9), (0.2, 0.9))]
        return found, plant.past(900.0)

    with (
        running_service(FmuService(APARTMENT.name, FMU, tmp_path)) as service,
        BoptestPlant(service.url, APARTMENT) as rest,
    ):
        measured, record = course(rest)
    with FmuPlant(FMU, APARTMENT) as local:
        expected, expected_record = course(local)
    for now, then in zip(measured, expected, strict=True):
        for name in ("T_zone_C", "u", "heat_W", "power_W"):
            np.testing.assert_array_equal(getattr(now, name), getattr(then, name))
    np.testing.assert_array_equal(record.u, expected_record.u)
    np.testing.assert_array_equal(record.heat_W, expected_record.heat_W)
    assert measured[-1].u[0] > 0.0
    assert measured[-1].u[1] > 0.5


@needs_fmu
def test_the_heat_pump_of_the_apartment_gives_what_is_asked_with_cooler_water_than_its_own_curve():
    from thermoforce_mpc.plants.fmu.plant import FmuPlant

    with FmuPlant(FMU, APARTMENT) as plant:
        plant.reset(20 * DAY_S, 0.0)
        asked = [plant.advance((0.4, 0.4), 900.0) for _ in range(8)]
        released = plant.advance(None, 900.0)
    assert [now.u.mean() for now in asked[-3:]] == pytest.approx([0.4] * 3, abs=0.06)
    assert asked[-1].heat_W == pytest.approx(asked[-1].u * 2500.0)
    own_curve_K = released.points[f"{WATER}_y"]
    assert asked[-1].points[f"{WATER}_y"] < own_curve_K - 5.0
    assert own_curve_K == pytest.approx(316.15 - 21.0 / 22.0 * released.T_out_C, abs=1.0)
