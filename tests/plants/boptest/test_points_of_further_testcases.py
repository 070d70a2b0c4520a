"""Test case files against the points that the real test cases have, where their lists are at hand."""

from __future__ import annotations

import re

import pytest
from multizone_points import MULTIZONE
from places import SHARED

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.points import check_points
from thermoforce_mpc.plants.testcases import load_testcase

FOLDER = SHARED / "boptest_more"
NAMES = ("singlezone_commercial_hydronic", "twozone_apartment_hydronic")


def tables(name: str) -> dict[str, dict[str, Point]]:
    """Points by heading of the page: name, unit and, of inputs, limits."""
    page = FOLDER / f"{name}.md"
    if not page.is_file():
        pytest.skip(f"{page} is not there")
    found: dict[str, dict[str, Point]] = {}
    for heading, body in re.findall(r"^## (\w+)[^\n]*\n(.*?)(?=^## |\Z)", page.read_text(), re.M | re.S):
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in body.splitlines() if "|" in line]
        points = {}
        for row in rows[2:]:
            low, high = (float(row[2]), float(row[3])) if heading == "Inputs" else (None, None)
            points[row[0]] = Point(row[0], row[1], "", low, high)
            if heading == "Inputs":
                activate = row[0].removesuffix("_u") + "_activate"
                points[activate] = Point(activate, "", "", None, None)
        found[heading] = points
    return found


@pytest.mark.parametrize("name", NAMES)
def test_every_point_is_there_in_its_unit(name):
    points = tables(name)
    check_points(load_testcase(name), points["Inputs"], points["Measurements"], points["Forecast"])


def test_a_missing_point_is_named_by_its_key():
    points = tables("twozone_apartment_hydronic")
    del points["Measurements"]["nigZon_reaTRooAir_y"]
    with pytest.raises(ConfigError, match=r"zones\.Night\.temperature: .*nigZon_reaTRooAir_y"):
        check_points(
            load_testcase("twozone_apartment_hydronic"), points["Inputs"], points["Measurements"], points["Forecast"]
        )


@pytest.mark.parametrize("name", MULTIZONE)
def test_every_point_of_the_sources_is_there_in_its_unit(name):
    points = MULTIZONE[name]
    check_points(load_testcase(name), points.inputs, points.measurements, points.forecast)


def test_a_release_whose_boiler_does_not_follow_the_thermostat_is_refused_by_key():
    points = MULTIZONE["multizone_residential_hydronic"]
    older = {name.replace("oveTSetPumBoi", "oveTSetPum"): point for name, point in points.inputs.items()}
    with pytest.raises(ConfigError, match=r"machines\.boiler\.held\.oveTSetPumBoi: .*'oveTSetPumBoi_u'"):
        check_points(load_testcase("multizone_residential_hydronic"), older, points.measurements, points.forecast)


def test_a_value_that_would_be_clipped_and_a_wrong_unit_are_named():
    name = "multizone_residential_hydronic"
    points, testcase = MULTIZONE[name], load_testcase(name)
    narrow = dict(points.inputs) | {"oveTSetPumBoi_u": Point("oveTSetPumBoi_u", "K", "", 285.15, 300.15)}
    with pytest.raises(
        ConfigError, match=r"(?s)held\.oveTSetPumBoi: 303\.15 lies outside.*idle\.oveTSetPumBoi: 283\.15"
    ):
        check_points(testcase, narrow, points.measurements, points.forecast)
    office = MULTIZONE["multizone_office_simple_air"]
    wrong = dict(office.measurements)
    wrong["hvac_reaZonEas_V_flow_y"] = Point("hvac_reaZonEas_V_flow_y", "kg/s", "", None, None)
    with pytest.raises(ConfigError, match=r"actuators\.eas_box\.heat: .* is in kg/s .*, expected m3/s"):
        check_points(load_testcase("multizone_office_simple_air"), office.inputs, wrong, office.forecast)
