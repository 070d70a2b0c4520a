"""The overview of commands, help by topic, and what is meant by names that there are not."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.commands import COMMANDS, GROUPS, SYNONYMS
from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.scenario.comfort import window_name
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate

TESTCASE = {"testcase": "bestest_hydronic_heat_pump"}


def said(*words: str) -> str:
    return CliRunner().invoke(cli, list(words)).output


def test_the_overview_fits_a_screen_with_every_command_in_one_group():
    shown = said("--help").splitlines()
    assert len(shown) <= 60
    assert max(map(len, shown)) <= 80
    names = [name for group in GROUPS.values() for name in group]
    assert len(names) == len(set(names))
    for name in names:
        assert sum(line.startswith(f"  {name} ") for line in shown) == 1, name


def test_every_group_has_at_most_a_dozen_commands():
    assert all(len(group) <= 12 for group in GROUPS.values())


@pytest.mark.parametrize(
    ("word", "meant"), [("runn", "run"), ("simulate", "run"), ("COMPARE", "compare"), ("idntify", "identify")]
)
def test_an_unknown_command_gets_the_one_that_is_meant(word, meant):
    assert f"No such command '{word}', did you mean '{meant}'?" in said(word)
    assert f"did you mean '{meant}'?" in said("help", word)


def test_help_shows_commands_subcommands_and_topics():
    assert said("help", "run") == said("run", "--help")
    assert "Usage: cli data check" in said("help", "data", "check")
    assert "130  interrupted" in said("help", "exit-codes")
    assert "_TF_MPC_COMPLETE=bash_source" in said("help", "completion")
    assert said("help") == said("--help")
    assert "has no commands of its own" in said("help", "run", "more")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("plan", "--model", "m", "--data", "a.csv", "--map", "b", "--forecast", "c", "--out", "./a.csv"), "--data"),
        (("plan", "--model", "m", "--data", "*.csv", "--map", "b", "--forecast", "c", "--commands", "a.csv"), "--data"),
        (
            ("saving", "--data", "b", "--data", "a.csv", "--map", "b", "--changed", "2026-02-01", "--out", "a.csv"),
            "--data",
        ),
        (("saving", "--data", "b", "--map", "l.svg", "--changed", "2026-02-01", "--plot", "a.svg"), "--map"),
        (("data", "check", "a.csv", "--map", "b", "--json", "a.csv"), "the command"),
        (("data", "probe-plan", "b", "--map", "a.csv", "--out", "a.csv"), "--map"),
    ],
)
def test_a_file_that_is_read_is_not_written_over(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "a.svg", "b"):
        (tmp_path / name).write_text("measured")
    (tmp_path / "l.svg").symlink_to("a.svg")
    done = CliRunner().invoke(cli, list(words))
    assert isinstance(done.exception, InputError), done.output
    assert f": {message} reads this file; give another name" in str(done.exception)
    assert {path.read_text() for path in tmp_path.iterdir()} == {"measured"}


@pytest.mark.parametrize("levels", ["house.csv", "./house.csv", "tomorrow.csv", "link.csv"])
def test_levels_are_not_written_over_what_is_read(tmp_path, monkeypatch, levels):
    monkeypatch.chdir(tmp_path)
    for name in ("house.csv", "tomorrow.csv"):
        (tmp_path / name).touch()
    (tmp_path / "link.csv").symlink_to("house.csv")
    assert build_connection("files", {"measurements": "h*.csv"})
    with pytest.raises(ConfigError, match=r"levels: .* reads; name another"):
        build_connection("files", {"measurements": "h*.csv", "levels": levels})


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("run", "--config", "home"),
        ("compare", "--testcase", "home"),
        ("compare", "--testcase", "bestest_air", "--variants", "home"),
        ("fleet", "home"),
        ("commission", "home"),
        ("control", "--model", "m", "--map", "home/map.yaml", "--connection", "home"),
        ("data", "check", "house.csv", "--map", "home"),
    ],
)
def test_a_folder_for_a_yaml_file_is_said_with_what_is_in_it(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["init", "home", "--for", "files"]).exit_code == 0
    done = CliRunner().invoke(cli, list(words))
    assert isinstance(done.exception, ConfigError), done.output
    assert "home: is a folder; name the file in it: connection.yaml, map.yaml" in str(done.exception)


def test_all_synonyms_are_of_commands_that_there_are():
    assert set(SYNONYMS.values()) <= set(COMMANDS)
    assert not set(SYNONYMS) & set(COMMANDS)


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("controller.options.comfort_weight", "objective.comfort_weight_per_m2"),
        ("controller.options.comfort_wieght", "objective.comfort_weight_per_m2"),
        ("comfort_wieght", "controller.options.objective.comfort_weight_per_m2"),
        ("controller.options.horizon", "horizon_h"),
        ("weather", "plant.weather"),
    ],
)
def test_an_unknown_key_gets_the_nearest_also_from_another_place(key, meant):
    from controllers.registry import controller_config
    from thermoforce_mpc.plants.testcases import load_testcase

    def configured():
        scenario = scenario_from({**TESTCASE, "assignments": [f"{key}=3"]})
        controller_config("thermoforce_mpc", scenario.controller.options, load_testcase(scenario.testcase))

    with pytest.raises(ConfigError, match=f"did you mean '{meant}'"):
        configured()


def test_what_people_change_most_has_options():
    given = {"horizon_h": 24.0, "comfort_weight": 0.05, "solver": "qp", "forecaster": "linear_weather"}
    options = scenario_from({**TESTCASE, **given}).controller.options
    assert options == {
        "horizon_h": 24.0,
        "solver": "qp",
        "objective": {"comfort_weight_per_m2": 0.05},
        "free_response": {"name": "linear_weather"},
    }
    for forecaster in ("chronos-2", "tirex-2", "amazon/chronos-bolt-tiny"):
        backbone = scenario_from({**TESTCASE, "forecaster": forecaster}).controller.options
        assert backbone == {"free_response": {"options": {"backbone": forecaster}}}
    with pytest.raises(ConfigError, match="did you mean 'timesfm'"):
        scenario_from({**TESTCASE, "forecaster": "timesfn"})
    with pytest.raises(ConfigError, match="did you mean 'chronos'"):
        scenario_from({**TESTCASE, "forecaster": "cronos"})
    assert "expected hours or days" in said("run", "--testcase", TESTCASE["testcase"], "--horizon", "3x")


def test_forecasters_are_listed_with_licence_and_what_they_need():
    listed = said("free-responses")
    rows = {line.split()[0]: line for line in listed.splitlines() if line}
    assert "0.49 M" in rows["shipped"]
    assert "0.76 M" in rows["shipped_weather"]
    assert rows["shipped"].endswith("yes")
    assert "Apache-2.0" in rows["chronos-2"]
    assert "past and future" in rows["chronos-2"]
    assert "non-commercial" in rows["timesfm-3"]
    assert {"residual", "chronos", "linear_weather", "rc", "persistence"} < set(rows)
    one = said("free-responses", "chronos-bolt-base")
    assert "hub: amazon/chronos-bolt-base" in one
    assert "it can be used here" in one


@pytest.mark.parametrize(("day", "window"), [("2026-01-01", "0"), ("2026-12-31", "364"), ("2024-03-01", "59")])
def test_a_window_may_be_given_by_date(day, window):
    assert scenario_from({**TESTCASE, "start": day}).period == window
    assert validate(Scenario, {**TESTCASE, "period": day}, "test").period == window
    assert window_name(day) == window


def test_days_that_no_year_of_365_days_has_are_refused():
    with pytest.raises(ConfigError, match="2024-02-29 is no day of a year of 365 days"):
        scenario_from({**TESTCASE, "start": "2024-02-29"})
    compared = ["compare", "--testcase", TESTCASE["testcase"], "--windows", "2026-02-30"]
    assert "--windows: 2026-02-30" in str(CliRunner().invoke(cli, compared).exception)
    assert "give one of them" in said(
        "run", "--testcase", TESTCASE["testcase"], "--period", "44", "--start", "2026-01-17"
    )


def test_mpc_is_short_for_the_controller_of_this_package():
    assert scenario_from({**TESTCASE, "controller": "mpc"}).controller.name == "thermoforce_mpc"
