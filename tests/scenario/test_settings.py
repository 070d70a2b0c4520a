from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from controllers import MPCConfig
from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import (
    find_config,
    merge,
    nested,
    parse_overrides,
    read_yaml,
    validate,
)
from thermoforce_mpc.scenario.testcase import TestCase


def write(folder: Path, text: str) -> Path:
    path = folder / "given.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\na: 2\n", r"given\.yaml: not valid YAML: .*key 'a' appears twice.*line 2"),
        ("a: 1\nb: {area: 40,5}\n", r"not valid YAML: ',5': a decimal comma\? write a point, as in 0.5 \(line 2\)"),
        ("a: [1\n", r"given\.yaml: not valid YAML"),
        ("- 1\n", r"given\.yaml: expected keys and values at the top, found list"),
        ("a: !!python/object:os.system {}\n", r"given\.yaml: not valid YAML"),
    ],
)
def test_broken_yaml_is_refused_with_file_and_reason(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        read_yaml(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("testcase: x\nperiods: 3\n", r"periods: unknown key, did you mean 'period'\?; known here: .*price"),
        ("testcase: x\nplant: {kid: boptest}\n", r"plant\.kid: unknown key, did you mean 'kind'"),
        (
            "testcase: x\nplant: {kind: real}\n",
            r"plant\.kind: unknown plant 'real'; known: embedded, boptest, fmu",
        ),
        ("testcase: x\nplant: {kind: boptest, prices_file: p.csv}\n", r"prices_file apply only to kind 'embedded'"),
        (
            "testcase: x\nplant: {kind: boptest, weather: w.mos}\n",
            r"weather and prices_file apply only to kind 'embedded'",
        ),
        ("testcase: x\ndays: .nan\n", r"days: .*\(got nan\)"),
        ("testcase: x\nprice: free\n", r"price: Input should be 'constant', 'dynamic' or 'highly_dynamic'"),
        ("period: 44\n", r"testcase: missing"),
    ],
)
def test_a_wrong_scenario_names_file_key_and_what_is_allowed(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_scenario(path, {})
    assert str(path) in str(caught.value)


def test_a_number_is_a_start_day(tmp_path):
    assert load_scenario(write(tmp_path, "testcase: x\nperiod: 44\n"), {}).period == "44"


@pytest.mark.parametrize(
    ("testcase", "period"),
    [
        ("energyplus:cooling_phoenix", "peak_cool_day"),
        ("energyplus:heating_chicago", "peak_heat_day"),
        ("no_such_case", "peak_heat_day"),
    ],
)
def test_without_a_period_the_season_of_the_building_decides(tmp_path, testcase, period):
    found = load_scenario(None, {"testcase": testcase})
    assert (found.period, found.model_fields_set) == (period, {"testcase"})
    assert load_scenario(write(tmp_path, f"testcase: {testcase}\nperiod: 200\n"), {}).period == "200"


def test_overrides_win_key_by_key(tmp_path):
    path = write(tmp_path, "testcase: x\ncontroller: {name: rc_mpc, options: {horizon_h: 12, solver: ipopt}}\n")
    scenario = load_scenario(path, parse_overrides(["controller.options.horizon_h=36", "seed=4"]))
    assert scenario.controller.options == {"horizon_h": 36, "solver": "ipopt"}
    assert scenario.controller.name == "rc_mpc"
    assert scenario.seed == 4


@pytest.mark.parametrize("word", ["a", "=1", "a..b=1", "a=[", "a=.nan"])
def test_malformed_overrides_are_refused(word):
    with pytest.raises(ConfigError, match="--set"):
        parse_overrides([word])


def test_a_path_in_the_home_folder_is_found_there_as_in_a_shell(tmp_path, monkeypatch):
    """Else levels are written into a folder ~ of the working folder, and a gateway waits for them at home."""
    monkeypatch.setenv("HOME", "/home/ann")
    text = "a: {levels: ~/levels.json, files: {'~/logs/*.csv': [~/a.csv]}, none: ~, other: a~/b, user: ~x}\n"
    assert dict(read_yaml(write(tmp_path, text))) == {
        "a": {
            "levels": "/home/ann/levels.json",
            "files": {"/home/ann/logs/*.csv": ["/home/ann/a.csv"]},
            "none": None,
            "other": "a~/b",
            "user": "~x",
        }
    }
    assert parse_overrides(["connection.levels=~/l.json"]) == {"connection": {"levels": "/home/ann/l.json"}}


def test_merge_leaves_its_arguments_alone():
    base = {"a": {"b": 1}}
    assert merge(base, {"a": {"c": 2}}) == {"a": {"b": 1, "c": 2}}
    assert base == {"a": {"b": 1}}


def test_unknown_names_get_a_suggestion():
    with pytest.raises(ConfigError, match=r"unknown testcase 'bestest_hydronic_heat_pumps', did you mean"):
        find_config("testcases", "bestest_hydronic_heat_pumps")


@pytest.mark.parametrize("name", sorted(named_configs("testcases")))
def test_shipped_test_cases_are_valid(name):
    assert name.startswith(load_testcase(name).name)


@pytest.mark.parametrize("path", named_configs("scenarios").values(), ids=lambda path: path.stem)
def test_shipped_scenarios_are_valid(path):
    from thermoforce_mpc.experiment.experiment import Experiment

    Experiment.of(validate(Scenario, read_yaml(path), str(path)))


def test_a_test_case_with_reversed_actuator_limits_is_refused():
    data = read_yaml(find_config("testcases", "bestest_hydronic_heat_pump"))
    data["actuator"] = data["actuator"] | {"minimum": 1, "maximum": 0}
    with pytest.raises(ConfigError, match=r"actuator: minimum \(1\.0\) must be below maximum"):
        validate(TestCase, data, "x.yaml")


def test_the_actuator_maps_levels_to_the_wire_and_back():
    actuator = load_testcase("bestest_hydronic_heat_pump").actuator
    scaled = actuator.model_copy(update={"minimum": 283.15, "maximum": 303.15})
    assert scaled.value(0.5) == pytest.approx(293.15)
    assert scaled.level(scaled.value(0.37)) == pytest.approx(0.37)


@pytest.mark.parametrize(("controller", "between"), [(None, False), ("thermoforce_paper", True)])
def test_the_machine_is_probed_the_way_the_controller_will_run_it(controller, between):
    from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings

    scenario = Scenario(testcase="bestest_hydronic_heat_pump", baselines=("thermoforce_paper", "rc_mpc"))
    chosen = chosen_of(scenario, load_testcase(scenario.testcase), controller)
    levels = identification_settings(scenario, chosen)[0].levels
    assert any(0 < level < 1 for level in levels) is between


def test_the_level_of_forecast_errors_is_an_option_of_a_run():
    named = {"testcase": "bestest_hydronic_heat_pump"}
    assert scenario_from(named).plant.forecast_uncertainty == "none"
    assert scenario_from({**named, "uncertainty": "medium"}).plant.forecast_uncertainty == "medium"
    with pytest.raises(ConfigError, match="forecast_uncertainty"):
        scenario_from({**named, "uncertainty": "huge"})


def test_a_constant_is_no_option_but_files_that_name_it_with_its_value_are_read():
    assert MPCConfig.model_validate({"watch": {"return_h": 12.0}, "ipopt": {"tolerance": 1e-8}}) == MPCConfig()
    with pytest.raises(ConfigError, match=r"watch: return_h is no option any more: it stays 12.0; leave the key out"):
        validate(MPCConfig, {"watch": {"return_h": 6.0}}, "given.yaml")
    with pytest.raises(ConfigError, match=r"ipopt is no option any more"):
        validate(MPCConfig, {"ipopt": {"tolerance": 1e-3}}, "given.yaml")


OLD = [
    ("backoff_level_other", None, 0.3, "backoff_level 0.5 plans without back-off"),
    ("backoff_violation_K", 0.0135, None, "backoff_level 0.5 plans without back-off"),
    ("offset_h", 6.0, None, "corrections: false does without"),
    ("reserve", True, False, "corrections: false does without"),
    ("move_blocking", {"free_h": 12.0}, {"free_h": 6.0}, "it stays what it is"),
    ("objective.exchange", False, True, "at_the_meter: true takes its place"),
    ("objective.keep_limits", False, True, "at_the_meter: true takes its place"),
    ("objective.terminal_value", 0.0, 1.0, "a term of your own can give it one"),
    ("watch.hour_effects", True, False, "blocked_hours: false turns it off too"),
    ("guard.margin_K", 1.0, 2.0, "it stays 1.0"),
    ("deadline.solve_s", 60.0, 10.0, "it stays 60.0"),
    ("sensor.lowest_C", -30.0, 0.0, "it stays -30.0"),
    ("fallback.safe_C", [20.0, 25.0], [18.0, 26.0], "it stays"),
]


@pytest.mark.parametrize(("key", "same", "other", "instead"), OLD, ids=[key for key, *_ in OLD])
def test_what_became_of_an_option_is_said_where_a_file_still_turns_it(key, same, other, instead):
    assert MPCConfig.model_validate(nested(key, same)) == MPCConfig()
    last = key.rpartition(".")[2]
    with pytest.raises(ConfigError, match=f"{last} is no option any more: .*{re.escape(instead)}"):
        validate(MPCConfig, nested(key, other), "given.yaml")


def test_the_controller_has_at_most_forty_options():
    def options(model):
        for name, field in model.model_fields.items():
            inner = field.default if isinstance(field.default, BaseModel) else None
            yield from options(type(inner)) if inner is not None else [name]

    assert len(list(options(MPCConfig))) <= 40
