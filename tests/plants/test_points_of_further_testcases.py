"""Test case files against the points that the real test cases have, where their lists are at hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.boptest.points import check_points
from thermoforce_mpc.scenario.scenario import load_testcase

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "boptest_more"
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
