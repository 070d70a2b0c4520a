"""Kinds of commands: what may be set, in which steps, and in words."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from thermoforce_mpc.commands.kinds import AnyCommand

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
        ({"kind": "setpoint", "usual": 45}, "usual (45 °C) lies outside 5 to 30"),
        ({"kind": "setpoint", "unit": "K"}, "unit"),
        ({"kind": "sg_ready", "hold_min": 5}, "greater than or equal to 10"),
        ({"kind": "setpoint", "setpoint": 21}, "Extra inputs are not permitted"),
    ],
)
def test_what_cannot_be_is_refused(keys, message):
    with pytest.raises(ValidationError, match=re.escape(message)):
        READ.validate_python({"column": "x", **keys})
