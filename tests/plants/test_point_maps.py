"""Shipped point maps against the point lists that BOPTEST documents."""

from __future__ import annotations

import numpy as np
import pytest
from documented_points import DOCUMENTED

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.boptest.points import check_points
from thermoforce_mpc.scenario.scenario import load_testcase
from thermoforce_mpc.scenario.settings import named_configs

OTHERS = ["bestest_hydronic", "bestest_air", "bestest_air_cooling", "bestest_air_cooling_setpoint"]


def test_the_maps_ship():
    assert set(OTHERS) < set(named_configs("testcases"))


@pytest.mark.parametrize("name", OTHERS)
def test_every_point_is_documented_in_its_unit_and_within_the_limits_of_all_releases(name):
    testcase = load_testcase(name)
    for release in DOCUMENTED[testcase.name]:
        check_points(testcase, release.inputs, release.measurements, release.forecast)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("key", ["zone_temperature", "outdoor_temperature", "solar"])
def test_a_map_with_a_wrong_name_does_not_fit(name, key):
    testcase = load_testcase(name)
    measurements = testcase.measurements.model_copy(update={key: "reaTRooo_y"})
    release = DOCUMENTED[testcase.name][0]
    with pytest.raises(ConfigError, match=rf"measurements\.{key}: the service has no point 'reaTRooo_y'"):
        check_points(
            testcase.model_copy(update={"measurements": measurements}),
            release.inputs,
            release.measurements,
            release.forecast,
        )


def test_more_u_is_more_heat_or_more_cold():
    effort = {name: load_testcase(name).actuator for name in OTHERS}
    assert effort["bestest_hydronic"].inputs(1.0)["oveTSetSup_u"] == 353.15
    assert effort["bestest_hydronic"].inputs(0.0) == {
        "oveTSetSup_u": 293.15, "oveTSetSup_activate": 1.0, "ovePum_u": 1.0, "ovePum_activate": 1.0,
    }  # fmt: skip
    assert effort["bestest_air"].inputs(0.3)["fcu_oveTSup_u"] == 313.15
    assert effort["bestest_air_cooling"].inputs(0.3)["fcu_oveTSup_u"] == 285.15
    cold = effort["bestest_air_cooling_setpoint"]
    assert [cold.inputs(u)["con_oveTSetCoo_u"] for u in (0.0, 1.0)] == pytest.approx([303.15, 296.15])
    assert cold.inputs(1.0)["con_oveTSetHea_u"] == 288.15
    for name in OTHERS:
        assert load_testcase(name).mode == ("cooling" if "cooling" in name else "heating")


@pytest.mark.parametrize("name", OTHERS)
def test_native_control_lets_go_of_everything_that_was_held(name):
    actuator = load_testcase(name).actuator
    released = actuator.inputs(None)
    assert {key for key in actuator.inputs(0.5) if key.endswith("_activate")} == set(released)
    assert set(released.values()) == {0.0}


@pytest.mark.parametrize("name", OTHERS)
def test_u_comes_back_from_the_recorded_value(name):
    actuator = load_testcase(name).actuator
    u = np.linspace(0.0, 1.0, 5)
    values = np.array([actuator.value(one) for one in u])
    np.testing.assert_allclose(actuator.level(values), u, atol=1e-12)
    beyond = actuator.level(np.array([actuator.minimum - 1.0, actuator.maximum + 1.0]))
    assert sorted(beyond) == [0.0, 1.0], "what native control did outside the span is cut"
