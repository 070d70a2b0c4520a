"""YAML that is hostile or merely wrong ends in one named error with its line, at once."""

from __future__ import annotations

import os
import re

import pytest

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import MOST_BYTES, merge, parse_overrides, read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase

LAUGHS = "a0: &a0 [lol]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x: 1\na: " + "[" * 5000, r"nested deeper than 32 levels \(line 2\)"),
        ("{a: " * 5000, "nested deeper"),
        (LAUGHS, r"more than 50,000 values, aliases written out \(line \d+\)"),
        ("a: &a [1, *a]\n", r"'\*a' contains itself"),
        ("a: 1\n[1, 2]: 3\n", r"a key must be text: put it in quotes \(line 2\)"),
        ("{a: 1}: 3\n", "a key must be text"),
        ("a: 1\n2: 3\n", r"'2' is read as int, put it in quotes \(line 2\)"),
        ("on: 3\n", "'on' is read as bool"),
        ("a: " + "9" * 5000, r"a number of 5000 characters; at most 40 \(line 1\)"),
        ("a: !!timestamp later\n", "the tag .* is not read here"),
        ("a: !!int text\n", "the tag .* is not read here"),
        ("a: !whatever 1\n", "the tag"),
        ('a: "\\ud800"\n', "surrogate"),
        ("a: \x07\n", "special characters"),
        ("a: *nothing\n", "undefined alias"),
        ("<<: 3\n", "merging"),
        ("a: 1\n---\nb: 2\n", "another document"),
        ("a: 1\n" * 2 + "#" * MOST_BYTES, "more than 250,000 bytes"),
    ],
)
def test_hostile_yaml_is_refused(tmp_path, text, message):
    path = tmp_path / "given.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as caught:
        read_yaml(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_what_yaml_1_1_would_guess_stays_text(tmp_path):
    path = tmp_path / "given.yaml"
    path.write_text("day: 2026-99-99\nhour: 12:30\nsmall: 1e-3\nten: 010\nbase: &b {x: 1}\nwith: {<<: *b, y: 2}\n")
    assert read_yaml(path) == {
        "day": "2026-99-99",
        "hour": "12:30",
        "small": 0.001,
        "ten": 10,
        "base": {"x": 1},
        "with": {"x": 1, "y": 2},
    }


def test_a_folder_a_pipe_and_a_name_too_long_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    for name in (tmp_path, tmp_path / "pipe.yaml"):
        with pytest.raises(ConfigError, match="not a file"):
            read_yaml(name)
    with pytest.raises(ConfigError, match="not the name of a file"):
        load_testcase("x" * 5000 + ".yaml")


def test_errors_name_the_line_unless_an_option_replaced_it(tmp_path):
    path = tmp_path / "given.yaml"
    path.write_text("testcase: x\n\nplant:\n  kind: real\n  weather: 3\ndays: -1\nbaselines:\n  - native\n  - [1]\n")
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, parse_overrides(["plant.weather=[4]"]))
    found = dict(re.findall(r"^  (?:line (\d+): )?([\w.]+):", str(caught.value), re.M)[i][::-1] for i in range(4))
    assert found == {"plant.kind": "4", "plant.weather": "", "days": "6", "baselines.1": "9"}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("days", "true", "expected a number, not true or false"),
        ("seed", "yes", "expected a number, not true or false"),
        ("step_s", ".inf", "finite number"),
        ("seed", "1" * 20, "no building has"),
        ("identification.days", "off", "expected a number"),
        ("controller.options", "[1]", "expected keys and values"),
        ("seed", "[[" * 50, "not valid YAML"),
    ],
)
def test_a_scenario_takes_no_truth_value_for_a_number_and_nothing_endless(key, value, message):
    with pytest.raises(ConfigError, match=message) as caught:
        validate(Scenario, {"testcase": "x"} | parse_overrides([f"{key}={value}"]), "options")
    assert key in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("zones.Day.floor_area_m2", 1e308, "no building has 1e\\+308; expected .* m²"),
        ("zones.Day.thermostat_C", -300.0, "no building has -300"),
        ("zones.Day.thermostat_C", 294.15, "no building has 294.15; expected -100 to 200 °C"),
        ("zones.Day.temperature", "", "no point has this name"),
        ("zones.Day.temperature", "two\nlines", "no point has this name"),
        ("zones.Day.temperature", "../../etc/passwd", "no point has this name"),
        ("zones.Day.lower", "x" * 201, "no point has this name"),
        ("actuators.day_valve.heat", {"heat": float("inf")}, "finite number"),
        ("actuators.day_valve.heat", {"heat": True}, "not true or false"),
        ("actuators.day_valve.maximum", True, "not true or false"),
        ("actuators.day_valve.unit", "K", r"minimum is 0 K; .*\(20 °C is 293.15\)"),
    ],
)
def test_a_test_case_holds_what_a_building_can_have(key, value, message):
    from thermoforce_mpc.scenario.settings import find_config

    wrong = value
    for part in reversed(key.split(".")):
        wrong = {part: wrong}
    given = merge(read_yaml(find_config("testcases", "twozone_apartment_hydronic")), wrong)
    with pytest.raises(ConfigError, match=message) as caught:
        validate(TestCase, given, "flat.yaml")
    assert key.rpartition(".")[0] in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [{"min_on_s": 1e308}, {"min_on_s": float("inf")}, {"min_off_s": True}],
)
def test_options_of_controllers_are_held_to_the_same(options):
    from controllers.actuation.actuator import ActuationConfig

    with pytest.raises(ConfigError, match="min_o"):
        validate(ActuationConfig, options, "options")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("machines.meter.price", "true", "expected a number, not true or false"),
        ("machines.meter.price", ".inf", "finite number"),
        ("machines.meter.price", "[0.2]", "valid number"),
        ("machines.meter.price", "{column: p, factor: .nan}", "finite number"),
        ("zones.room.lower", "on", "expected a number, not true or false"),
        ("zones.room.lower", "{column: p, unit: Celsius}", "'°C', 'C', 'degC'"),
        ("zones.room.temperature", "5", "expected keys and values, of column, factor"),
        ("time", "Europe/Vienna", "expected keys and values, of ambiguous, column"),
        ("zones", "[room]", "expected keys and values"),
    ],
)
def test_a_value_that_may_be_a_number_or_a_column_is_refused_once_by_its_own_key(key, value, message):
    given = {"outdoor": "T", "zones": {"room": {"temperature": "t"}}, "machines": {"meter": {"power": "p"}}}
    with pytest.raises(ConfigError, match=message) as caught:
        validate(
            MeasurementMap, merge(given, {key.split(".")[0]: {}} | parse_overrides([f"{key}={value}"])), "map.yaml"
        )
    [line] = str(caught.value).splitlines()[1:]
    assert re.match(rf"  {re.escape(key)}(\.\w+)?: ", line)
