"""Shipped point maps against the point lists that BOPTEST documents."""

from __future__ import annotations

import numpy as np
import pytest
from documented_points import DOCUMENTED

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.plants.points import check_points
from thermoforce_mpc.plants.testcases import load_testcase

OTHERS = ["bestest_hydronic", "bestest_air"]
LEVELS = ["bestest_hydronic"]


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
    assert effort["bestest_hydronic"].inputs(1.0)["oveTSetSup_u"] == 343.15
    assert effort["bestest_hydronic"].inputs(0.1)["ovePum_u"] == 1.0
    assert effort["bestest_hydronic"].inputs(0.0) == {
        "oveTSetSup_u": 293.15, "oveTSetSup_activate": 1.0, "ovePum_u": 0.0, "ovePum_activate": 1.0,
    }, "without the pump there is no heat in a cold room either"  # fmt: skip
    air = effort["bestest_air"]
    warm, idle, cold = (air.inputs(u, (21.0, 24.0)) for u in (0.3, 0.0, -0.3))
    assert (warm["con_oveTSetHea_u"], warm["con_oveTSetCoo_u"]) == (294.15, 308.15), (
        "the cooling loop is out of the way"
    )
    assert (idle["con_oveTSetHea_u"], idle["con_oveTSetCoo_u"]) == (294.15, 297.15), "both loops keep the band"
    assert (cold["con_oveTSetHea_u"], cold["con_oveTSetCoo_u"]) == (278.15, 297.15), (
        "the heating loop is out of the way"
    )
    assert (warm["fcu_oveTSup_u"], cold["fcu_oveTSup_u"]) == (313.15, 285.15)
    assert (warm["fcu_oveTSup_activate"], idle["fcu_oveTSup_activate"]) == (1.0, 0.0)
    assert air.inputs(1.0, None)["con_oveTSetHea_u"] == 308.15, "a full level drives the loop to its limit"
    assert [load_testcase(name).mode for name in OTHERS] == ["heating", "both"]


@pytest.mark.parametrize("name", OTHERS)
def test_native_control_lets_go_of_everything_that_was_held(name):
    actuator = load_testcase(name).actuator
    none = (None,) if name == "bestest_air" else ()
    released = actuator.inputs(None, *none)
    assert {key for key in actuator.inputs(0.5, *none) if key.endswith("_activate")} == set(released)
    assert set(released.values()) == {0.0}


@pytest.mark.parametrize("name", LEVELS)
def test_u_comes_back_from_the_recorded_value(name):
    actuator = load_testcase(name).actuator
    u = np.linspace(0.0, 1.0, 5)
    values = np.array([actuator.value(one) for one in u])
    np.testing.assert_allclose(actuator.level(values), u, atol=1e-12)
    beyond = actuator.level(np.array([actuator.minimum - 1.0, actuator.maximum + 1.0]))
    assert sorted(beyond) == [0.0, 1.0], "what native control did outside the span is cut"
