"""Controllers and KPIs of the user's own, from a file or as objects."""

from __future__ import annotations

import copy
import json
import math

import pytest
from click.testing import CliRunner
from simple_house import SimpleHouse

from controllers.registry import build_controller, find_entry, lent
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import Block, Plan, PlanStatus
from thermoforce_mpc.errors import ConfigError, ControllerRaised
from thermoforce_mpc.experiment.run import run
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.records.run_folder import own_kpis

TESTCASE = "bestest_hydronic_heat_pump"
RULES = '''
from dataclasses import dataclass
from thermoforce_mpc.data import Block, Plan, PlanStatus

class Night:
    """Off at night."""
    step_s = horizon_s = 3600.0
    def __init__(self, from_h: float = 22.0, breaks_at: int = 0):
        self.from_h, self.breaks_at = from_h, breaks_at
    def plan(self, observation, state=None):
        n = (state or 0) + 1
        if n == self.breaks_at:
            raise ValueError("no idea")
        hour = observation.time_s % 86400 / 3600
        return Plan((Block(float(hour < self.from_h), self.step_s),), PlanStatus.RULE, "rule", state=n)

class Odd:
    step_s = horizon_s = 3600.0
    def plan(self, observation, state=None):
        return {"u": 1.0}

class Empty:
    """No controller."""

def bare(needs):
    """A parameter without a default."""
'''
KPIS = '''
def hours_on(trajectory):
    """Hours at more than half level, h"""
    return float(trajectory.duration_s[trajectory.u_applied > 0.5].sum() / 3600)

def broken(trajectory):
    return trajectory.nothing.sum()
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with rules and KPIs; runs there are on the simple house."""
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_rules.py").write_text(RULES)
    (tmp_path / "my_kpis.py").write_text(KPIS)
    return tmp_path


def tf_run(*words: str):
    return CliRunner().invoke(cli, ["run", "--testcase", TESTCASE, "--days", "1", "--out", "out", *words])


def test_a_class_in_a_file_is_a_controller_with_options_and_kpis(folder):
    done = tf_run(
        "--controller", "my_rules.py:Night", "--baselines", "native", "--set", "controller.options.from_h=6",
        "--set", "kpis=[my_kpis.py:hours_on]",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "my_rules.py:Night: " in done.output
    kpis = json.loads((folder / "out" / "kpis.json").read_text())
    assert kpis["controller"] == "my_rules.py:Night"
    assert kpis["kpis"]["hours_on, h"] == 6.0
    assert "hours_on" in (folder / "out" / "report.html").read_text()
    again = CliRunner().invoke(cli, ["report", "out"])
    assert again.exit_code == 0, again.output
    assert "hours_on" in (folder / "out" / "report.html").read_text(), "from kpis.json, without running the file"


def test_a_run_is_named_by_the_class(folder):
    words = ["run", "--testcase", TESTCASE, "--days", "1", "--controller", "my_rules.py:Night", "--baselines", ""]
    assert CliRunner().invoke(cli, words).exit_code == 0
    assert [path.name for path in (folder / "runs").iterdir()] == [
        f"{TESTCASE}-peak_heat_day-constant-my_rules.py_Night-001"
    ]


def test_a_controller_that_raises_is_told_with_its_line_and_loses_nothing(folder):
    done = tf_run("--controller", "my_rules.py:Night", "--baselines", "", "--set", "controller.options.breaks_at=5")
    assert isinstance(done.exception, ControllerRaised)
    text = str(done.exception)
    assert "my_rules.py:Night in step 4, day 10.167 raised ValueError: no idea" in text
    assert 'raise ValueError("no idea")' in text
    assert "closed_loop.py" not in text
    assert "no idea" in (folder / "out" / "INCOMPLETE.txt").read_text()
    assert (folder / "out" / "incomplete_trajectory_my_rules.py_Night.csv").is_file()
    assert isinstance(tf_run("--out", "odd", "--controller", "my_rules.py:Odd").exception, ControllerRaised)


def test_what_did_not_act_is_told_with_the_first_reason(folder):
    (folder / "my_rules.py").write_text(RULES.replace("float(hour < self.from_h)", "1.5 if hour else 1.0"))
    done = tf_run("--controller", "my_rules.py:Night", "--baselines", "")
    assert "23 of 24 plans did not act: refused level of 1.5: expected a number from 0 to 1" in done.output, done.output
    assert "Fallbacks" not in done.output


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("my_rules.py:Nigth", "has no 'Nigth'; it has Night, Odd, Empty, bare"),
        ("rules.py:Night", "no such file in "),
        ("my_rules.py:Empty", "it has no plan and no step_s and no horizon_s"),
        ("my_rules.py:bare", "its parameters needs have no default"),
        ("my_rules.py:", "expected path/to/file.py:name"),
    ],
)
def test_what_is_no_controller_is_refused_before_the_run(folder, name, said):
    with pytest.raises(ConfigError, match=said):
        build_controller(name, {}, load_testcase(TESTCASE))


def test_a_file_that_raises_is_told_with_its_line(folder):
    (folder / "my_rules.py").write_text("x = 1\nraise RuntimeError('later')\n")
    with pytest.raises(ConfigError, match=r"my_rules\.py, line 2 raised RuntimeError: later"):
        find_entry("my_rules.py:Night")


def test_a_changed_file_is_read_again(folder):
    testcase = load_testcase(TESTCASE)
    assert build_controller("my_rules.py:Night", {}, testcase).step_s == 3600.0
    (folder / "my_rules.py").write_text(RULES.replace("3600.0", "1800.0") + "\n# longer\n")
    assert build_controller("my_rules.py:Night", {}, testcase).step_s == 1800.0


LOUD = """
from thermoforce_mpc.data import Block, Plan, PlanStatus
class Loud:
    step_s = horizon_s = 3600.0
    def plan(self, observation, state=None):
        why = "\\x1b]0;title\\x07\\x1b[2Jcleared" + "x" * 5000
        return Plan((Block(0.5, self.step_s),), PlanStatus.RULE, why, news="\\x1b[2Jnews")
"""


def test_texts_of_a_journal_never_reach_the_terminal_as_control_characters(folder):
    (folder / "my_rules.py").write_text(LOUD)
    done = tf_run("--controller", "my_rules.py:Loud", "--baselines", "")
    assert done.exit_code == 0, done.output
    assert "[2Jnews" in done.output
    assert "\x1b" not in done.output
    for words in (["explain", "out", "--at", "10 03:00"], ["watch", "out", "--once"]):
        shown = CliRunner().invoke(cli, words)
        assert shown.exit_code == 0, shown.output
        assert "[2Jcleared" in shown.output
        assert "\x1b" not in shown.output
        assert "more characters left out" in shown.output


CONTROLLER, KPI = "controller: {name: 'my_rules.py:Night'}", "kpis: ['my_rules.py:bare']"
TERMS = "controller: {options: {terms: 'my_rules.py:bare'}}"
HOUSES = f"buildings: [{{testcase: {TESTCASE}}}]\nwindows: [44]\n"
OF_FILES = {
    "run --config file.yaml --out out --days 0.25": ["baselines: ['my_rules.py:Night']", CONTROLLER, KPI, TERMS],
    "identify --config file.yaml --out model": [CONTROLLER],
    "compare --config file.yaml --controllers native": [KPI],
    "compare --variants file.yaml": [
        "variants: {night: {controller: 'my_rules.py:Night'}}",
        "variants: {ramp: {controller: thermoforce_mpc, options: {terms: 'my_rules.py:bare'}}}",
    ],
    "sweep --config file.yaml": [KPI],
    "fleet file.yaml --count": [
        f"{HOUSES}variants: {{thermostat: {{controller: 'my_rules.py:Night'}}}}",
        f"{HOUSES}scenario: {{kpis: ['my_rules.py:bare']}}",
    ],
}


@pytest.mark.parametrize(("words", "text"), [(words, text) for words, texts in OF_FILES.items() for text in texts])
def test_python_that_only_a_file_names_is_shown_and_asked_for(folder, monkeypatch, words, text):
    """By every command that reads such a file; the user has given nothing here so far."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    (folder / "my_rules.py").write_text(f"import socket\nopen('was_here', 'w').close()\n{RULES}")
    of_scenarios = "scenario: {testcase: %s}\n" if "variants" in words else "" if "fleet" in words else "testcase: %s\n"
    (folder / "file.yaml").write_text(f"{of_scenarios.replace('%s', TESTCASE)}{text}\n")
    asked = CliRunner().invoke(cli, words.split())
    assert isinstance(asked.exception, ConfigError), asked.output
    assert "my_rules.py (28 lines of Python, define Empty, Night, Odd, bare, import dataclasses, socket, " in str(
        asked.exception
    )
    assert "--code my_rules.py" in str(asked.exception)
    looked = CliRunner().invoke(cli, ["validate", "file.yaml"])
    assert looked.exit_code == 0, str(looked.exception)
    assert "import dataclasses, socket" in looked.output
    assert not (folder / "was_here").exists()
    if words.startswith("fleet"):  # the others would run for long
        given = CliRunner().invoke(cli, [*words.split(), "--code", "my_rules.py"])
        assert given.exit_code == 0, str(given.exception)
        assert (folder / "was_here").exists()


def test_python_that_the_command_line_or_an_earlier_one_names_is_not_asked_for(folder, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    (folder / "file.yaml").write_text(f"testcase: {TESTCASE}\n{CONTROLLER}\nbaselines: []\n")
    words = ["run", "--config", "file.yaml", "--days", "0.25", "--no-equal-comfort"]
    assert CliRunner().invoke(cli, [*words, "--out", "1", "--controller", "my_rules.py:Night"]).exit_code == 0
    assert CliRunner().invoke(cli, [*words, "--out", "2"]).exit_code == 0, "given before"
    (folder / "my_rules.py").write_text(RULES + "\n# changed\n")
    assert "not given it here before" in str(CliRunner().invoke(cli, [*words, "--out", "3"]).exception)
    assert CliRunner().invoke(cli, [*words, "--out", "4", "--code", "my_rules.py"]).exit_code == 0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("class Nigth: pass", "has no 'Night'; it has Nigth"),
        ("def Night(:", "is not Python"),
        ("x = 1\x00", "is not Python"),
        ("(" * 5000, "is not Python"),
        (None, "no such file in "),
    ],
)
def test_validate_says_what_is_wrong_with_python_that_it_does_not_run(folder, content, said):
    (folder / "my_rules.py").unlink()
    if content is not None:
        (folder / "my_rules.py").write_text(content)
    (folder / "file.yaml").write_text(f"testcase: {TESTCASE}\n{CONTROLLER}\n")
    assert said in str(CliRunner().invoke(cli, ["validate", "file.yaml"]).exception)


def test_validate_fetches_no_forecaster(folder):
    """Without a network it would be an error."""
    hub = "controller: {options: {free_response: {options: {backbone: nobody/chronos-none}}}}"
    (folder / "file.yaml").write_text(f"testcase: {TESTCASE}\n{hub}\n")
    looked = CliRunner().invoke(cli, ["validate", "file.yaml"])
    assert looked.exit_code == 0, str(looked.exception)
    assert "nobody/chronos-none: not looked at" in looked.output


class Half:
    """Half level."""

    name = "half"
    step_s = horizon_s = 3600.0

    def __init__(self, level: float = 0.5):
        self.level = level

    def plan(self, observation, state=None):
        return Plan((Block(self.level, self.step_s),), PlanStatus.RULE, "as always")


def mean_level(trajectory):
    """Mean level"""
    return trajectory.u_applied.mean()


@pytest.mark.parametrize("controller", [Half(0.25), Half])
def test_python_takes_objects_and_classes(folder, controller):
    done = run(TESTCASE, controller=controller, kpis=[mean_level], days=1, baselines=["native"], progress=False)
    expected = 0.25 if isinstance(controller, Half) else 0.5
    assert done.kpis["half"]["mean_level, –"] == expected
    assert math.isnan(done.kpis["native"]["mean_level, –"])
    with pytest.raises(ConfigError, match="unknown controller 'half'"):
        find_entry("half")


def test_a_controller_by_the_name_of_its_file_is_one_and_can_be_copied(folder):
    controller = build_controller("my_rules.py:Night", {"from_h": 6.0}, load_testcase(TESTCASE))
    assert isinstance(controller, Controller), "since Python 3.12 protocols do not ask __getattr__"
    controller.later = 1
    for one in (controller, copy.copy(controller)):
        assert (one.name, one.from_h, one.later) == ("my_rules.py:Night", 6.0, 1)
    with pytest.raises(AttributeError, match="'Night' object has no attribute 'until_h'"):
        controller.until_h  # noqa: B018 - what is asked for is not there


def test_a_name_that_is_taken_is_refused():
    taken = Half()
    taken.name = "native"
    with pytest.raises(ConfigError, match="'native' is there already"), lent(taken):
        pass


def test_a_kpi_that_fails_costs_nobody_the_run(folder):
    kpi, broken = own_kpis(["my_kpis.py:hours_on", "my_kpis.py:broken"])
    assert kpi.key == "hours_on, h"
    with pytest.warns(DoubtfulInput, match=r"kpis: broken, –, line 7: AttributeError"):
        done = run(TESTCASE, controller="thermostat", kpis=[broken.function], days=1, baselines=[], progress=False)
    assert math.isnan(done.kpis["thermostat"]["broken, –"])
    with pytest.raises(ConfigError, match="given twice"):
        own_kpis(["my_kpis.py:hours_on", "my_kpis.py:hours_on"])
    with pytest.raises(ConfigError, match="has no 'hours'; it has hours_on, broken"):
        own_kpis(["my_kpis.py:hours"])
