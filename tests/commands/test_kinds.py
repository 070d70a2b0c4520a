"""Kinds of commands: what may be set, in which steps, and in words."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from pydantic import TypeAdapter, ValidationError

from thermoforce_mpc.commands.kinds import AnyCommand
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.scenario.settings import validate

READ = TypeAdapter(AnyCommand)
LOWER, UPPER, USUAL = np.full(2, 20.0), np.full(2, 22.0), np.array([21.0, 24.0])


def command(kind, **keys):
    return READ.validate_python({"kind": kind, "column": "x", **keys})


@pytest.mark.parametrize(
    ("one", "limits", "values", "words"),
    [
        (command("setpoint"), (18.0, 24.0), [18.0, 18.5], "18.5 °C"),
        (command("setpoint", beyond_K=0, maximum=21.25, resolution=0.25), (20.0, 21.25), [20.0, 20.25], "20.25 °C"),
        (command("curve_offset"), (-3.0, 3.0), [-3.0, -2.0], "-2 K"),
        (command("flow_temperature"), (16.0 + 4.0, 26.0), [20.0, 21.0], "21 °C flow"),
        (command("sg_ready"), (1.0, 3.0), [1.0, 2.0], "SG-Ready 2 (normal)"),
        (command("enable"), (0.0, 1.0), [0.0, 1.0], "enabled"),
    ],
)
def test_limits_steps_and_words(one, limits, values, words):
    low, high = one.limits(LOWER, UPPER, USUAL)
    assert (low[0], high[0]) == limits
    assert one.values(low[0], high[0])[:2].tolist() == values
    assert one.in_words(values[1]) == words


@pytest.mark.parametrize(("low", "high"), [(22.3, 22.3), (20.2, 20.2), (19.8, 19.9), (23.0, 21.0)])
def test_between_steps_the_nearest_inside_the_limits_is_set(low, high):
    """Comfort bounds beyond `maximum` or `minimum` leave no multiple of the resolution between."""
    one = command("setpoint", minimum=20.2, maximum=22.3)
    least, most = one.within(np.array([low]), np.array([high]))
    (value,) = one.values(float(least[0]), float(most[0]))
    assert one.allows(value)
    assert not one.allows(22.5)


@pytest.mark.parametrize(("low", "high", "nearest"), [(20.1, 20.2, 20.0), (20.3, 20.4, 20.5), (20.3, 20.1, 20.0)])
def test_where_two_steps_are_allowed_the_one_nearest_to_the_middle_of_the_limits_is_set(low, high, nearest):
    assert command("setpoint").values(low, high).tolist() == [nearest]


def test_a_device_in_fahrenheit_takes_whole_degrees_of_its_own():
    """Inside are °C; limits and steps of the map are the device's."""
    one = command("setpoint", unit="°F", maximum=72, change_per_h=2)
    low, high = one.limits(LOWER, UPPER, USUAL)
    values = one.values(low[0], high[0])
    assert [one.in_words(value) for value in values] == [f"{degree} °F" for degree in range(65, 73)]
    np.testing.assert_allclose(one.as_told(values), np.arange(65.0, 73.0), atol=1e-6)
    assert all(one.allows(value) for value in values)
    assert not one.allows(one.from_told(73.0))
    assert one.step == pytest.approx(1.0 / 1.8)
    assert one.most_change(7200.0) == pytest.approx(4.0 / 1.8)
    assert one.nearest(21.3, 1.0) == pytest.approx(one.from_told(71.0))
    assert (command("setpoint", unit="°F").minimum, command("setpoint", unit="°F").resolution) == (41, 1)
    assert command("flow_temperature", unit="°F").in_words(50.0) == "122 °F flow"


def test_a_change_is_as_slow_as_the_map_says_but_a_step_at_least():
    slow = command("flow_temperature", change_per_h=2.0)
    assert (slow.most_change(7200.0), slow.most_change(60.0)) == (4.0, 1.0)


def test_sg_ready_is_blocked_for_two_hours_at_most():
    assert (command("sg_ready").longest_s(1.0), command("sg_ready").longest_s(2.0)) == (7200.0, np.inf)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"kind": "set_point"}, "expected setpoint, curve_offset, flow_temperature, sg_ready or enable"),
        ({"kind": "setpoint", "minimum": 22, "maximum": 20}, "minimum (22) must be below maximum (20)"),
        ({"kind": "setpoint", "resolution": 0}, "greater than 0"),
        ({"kind": "sg_ready", "states": [2, 5]}, "states of SG-Ready are 1 blocked"),
        ({"kind": "sg_ready", "states": [1]}, "blocked alone cannot be held"),
        ({"kind": "setpoint", "minimum": 20.2, "maximum": 20.4}, "no multiple of resolution (0.5) from minimum (20.2)"),
        ({"kind": "setpoint", "minimum": 3}, "minimum (3 °C) lies outside 5 to 30"),
        ({"kind": "setpoint", "unit": "°F", "minimum": 18}, "minimum (18 °F) lies outside 41 to 86"),
        ({"kind": "setpoint", "usual": 45, "maximum": None}, "usual (45 °C) lies outside 5 to 30"),
        ({"kind": "setpoint", "usual": 29}, "usual (29) lies above maximum (28)"),
        ({"kind": "curve_offset", "usual": -4}, "usual (-4) lies below minimum (-3)"),
        ({"kind": "curve_offset", "minimum": 0.9, "maximum": 1.5}, "only one multiple of resolution (1)"),
        ({"kind": "curve_offset", "minimum": 4}, "minimum (4) must be below maximum (3)"),
        ({"kind": "enable", "usual": 5}, "usual (5) is neither 1, on, nor 0, off"),
        ({"kind": "sg_ready", "usual": 5}, "usual (5) is no state of SG-Ready"),
        ({"kind": "sg_ready", "states": [2]}, "of one alone there is nothing to plan"),
        ({"kind": "setpoint", "unit": "K"}, "unit"),
        ({"kind": "sg_ready", "hold_min": 5}, "greater than or equal to 10"),
        ({"kind": "setpoint", "setpoint": 21}, "Extra inputs are not permitted"),
    ],
)
def test_what_cannot_be_is_refused(keys, message):
    with pytest.raises(ValidationError, match=re.escape(message)):
        READ.validate_python({"column": "x", **keys})


LIVING = {"temperature": "T", "lower": 21, "upper": 24}
TANK = {"temperature": "tank", "comfort": "else 50-58"}
SETPOINT = {"kind": "setpoint", "column": "x"}


def rules(command, *, of="actuators", zone=LIVING, **keys):
    """A map of a room and a machine, of which one has the command."""
    items = {"actuators": {"valve": {"level": "u"}}, "machines": {"boiler": {"power": "P"}}}
    for item in items[of].values():
        item["command"] = command
    return {"outdoor": "out", "time": {"zone": "Europe/Berlin"}, "zones": {"living": zone}, **items, **keys}


BY_SCHEDULE = {"zone": {"temperature": "T"}, "comfort": "weekdays 6:00-22:00 21-24, else 17-26"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (rules(SETPOINT | {"maximum": 20}), "actuators.valve.command.maximum: 20 °C lies below the lower bound of liv"),
        (
            rules(SETPOINT | {"unit": "°F", "maximum": 69}),
            "maximum: 69 °F lies below the lower bound of living, 69.8",
        ),
        (
            rules(SETPOINT | {"minimum": 25}, of="machines"),
            "machines.boiler.command.minimum: 25 °C lies above the up",
        ),
        (
            rules(SETPOINT | {"maximum": 20}, **BY_SCHEDULE),
            "maximum: 20 °C lies below the lower bound of living, 21",
        ),
        (
            rules(None, hot_water=TANK | {"command": {"kind": "tank_target", "column": "t", "maximum": 45}}),
            "hot_water.command.maximum: 45 °C lies below the lower bound of the tank, 50 °C",
        ),
    ],
)
def test_limits_that_leave_no_way_to_keep_the_bounds_are_refused(given, message):
    with pytest.raises(ConfigError, match=re.escape("map.yaml") + "(?s:.*)" + re.escape(message)):
        validate(MeasurementMap, given, "map.yaml")


def test_limits_at_the_bounds_are_taken():
    validate(MeasurementMap, rules(SETPOINT | {"minimum": 18, "maximum": 21}), "map.yaml")
    validate(MeasurementMap, rules({"kind": "curve_offset", "column": "x"}, of="machines"), "map.yaml")


def test_limits_that_no_bound_of_a_table_leaves_a_way_are_refused():
    at = pd.date_range("2026-01-01", periods=48, freq="h")
    table = pd.DataFrame({"T": 21.0, "u": 0.4, "P": 900.0, "out": 3.0, "x": 20.0, "least": 21.0, "most": 24.0}, at)
    table.loc[at[:24], "least"] = 18.0
    given = rules(SETPOINT | {"maximum": 20}, zone={"temperature": "T", "lower": "least", "upper": "most"})
    read_measurements(table, given)  # at night it can be kept
    table["least"] = 21.0
    with pytest.raises(
        DataError, match=r"actuators\.valve\.command\.maximum: 20 °C lies below the lower bound of living"
    ):
        read_measurements(table, given)
