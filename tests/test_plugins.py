"""Other distributions add plants, free responses, controllers and test cases; a bad one fails alone and by name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT, SUPPORT

from controllers.checks import ControllerConfigError
from controllers.registry import REGISTRY, Entry, build_controller
from thermoforce_mpc.comparison.cells import Variant, expand
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.free_response.registry import REGISTRY as FREE_RESPONSES
from thermoforce_mpc.plants.registry import choose_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.registry import Registry, builder
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario


def distribution(where: Path, name: str, module: str, group: str = "controllers", **announced: str) -> None:
    """What an installer leaves of a distribution with one module, that announces things of a group."""
    info = where / f"{name.replace('-', '_')}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    lines = [f"{key} = {value}" for key, value in announced.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[thermoforce_mpc.{group}]", *lines]))
    (where / f"{name.replace('-', '_')}.py").write_text(module)


@pytest.fixture
def registry() -> Registry[Entry]:
    """The registry of controllers as a new process would have it."""
    return Registry("controller", "controllers", REGISTRY.own, ControllerConfigError, REGISTRY.wrong, REGISTRY.made)


GOOD = """
from controllers.registry import REGISTRY
COPY = REGISTRY.find("thermostat")
"""


def test_a_plugin_is_found_by_name_and_imported_when_it_is_named(tmp_path, monkeypatch, registry):
    distribution(tmp_path, "good-house", GOOD, copy="good_house:COPY")
    monkeypatch.syspath_prepend(tmp_path)
    assert registry.names[-1] == "copy"
    assert "copy" in registry
    assert "good_house" not in sys.modules
    assert registry.find("copy") is REGISTRY.find("thermostat")
    (listed,) = (one for one in registry.listing() if one.name == "copy")
    assert listed.origin == "good-house 1.2 (good_house:COPY)"
    assert not listed.problem


@pytest.mark.parametrize(
    ("module", "what", "words"),
    [
        ("import nothing_of_this_name", "X", r"cannot be imported \(ModuleNotFoundError: .*nothing_of_this_name"),
        ("raise SystemExit(3)", "X", r"cannot be imported \(SystemExit"),
        ("def broken(:", "X", r"cannot be imported \(SyntaxError"),
        ("Y = 1", "X", r"cannot be imported \(AttributeError"),
        (
            "class X:\n    def __init__(self, house): ...",
            "X",
            "cannot be used: its parameters house have no default; with",
        ),
        ("def X(gain: 'NoSuchType' = 1): ...", "X", "cannot be used: its options cannot be checked: .*NoSuchType"),
        ("X = 1", "X", "cannot be used: it is a int, not a function or class"),
    ],
)
def test_one_that_fails_is_named_with_its_distribution_and_fails_alone(
    tmp_path, monkeypatch, registry, module, what, words
):
    monkeypatch.delitem(sys.modules, "bad_house", raising=False)
    distribution(tmp_path, "bad-house", module, mine=f"bad_house:{what}")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ControllerConfigError, match=rf"controller 'mine' of bad-house 1\.2 \(bad_house:X\) {words}"):
        registry.find("mine")
    listed = {one.name: one for one in registry.listing()}
    assert listed["mine"].found is None
    assert "bad-house 1.2" in listed["mine"].problem
    assert all(listed[name].found is REGISTRY.find(name) for name in REGISTRY.own)


@pytest.mark.parametrize("file", ["own_rules.py", "own_rules/__init__.py", "own_rules/weights/policy.json"])
def test_a_run_is_made_anew_after_a_change_in_a_plugins_files(tmp_path, monkeypatch, file):
    distribution(tmp_path, "own-rules", GOOD, mine="own_rules:COPY")
    if file != "own_rules.py":
        (tmp_path / "own_rules" / "weights").mkdir(parents=True)
        (tmp_path / "own_rules.py").rename(tmp_path / "own_rules" / "__init__.py")
    monkeypatch.syspath_prepend(tmp_path)

    def key() -> str:
        base = Scenario(testcase="bestest_hydronic_heat_pump", days=1)
        (cell,) = expand(base, {"any": Variant(controller="thermostat")}, ["44"], ["constant"])
        return cell.key

    before = key()
    (tmp_path / "__pycache__").mkdir()
    assert key() == before
    (tmp_path / file).write_text(f"{GOOD}\n# changed")
    assert key() != before
    assert "own_rules" not in sys.modules


def test_names_that_clash(tmp_path, monkeypatch, registry):
    distribution(tmp_path, "first-house", GOOD, copy="first_house:COPY", thermostat="first_house:COPY")
    distribution(tmp_path, "second-house", GOOD, copy="second_house:COPY")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        ControllerConfigError, match=r"'copy' is announced by first-house 1\.2 .* and second-house 1\.2 .*uninstall one"
    ):
        registry.find("copy")
    assert registry.find("thermostat") is REGISTRY.find("thermostat"), "ours is never replaced"
    problems = {(one.name, one.origin): one.problem for one in registry.listing() if one.problem}
    assert "rename" in problems["thermostat", "first-house 1.2 (first_house:COPY)"]
    assert len(problems) == 2


SIMPLE = """
from thermoforce_mpc.data import Block, Plan, PlanStatus
class Hold:
    "Holds a level"
    name, step_s, horizon_s = "hold", 900.0, 900.0
    def __init__(self, testcase: "OnlyForTypeChecking", level=0.5, why: str = ""):
        self.testcase, self.level, self.why = testcase, level, why
    def plan(self, observation, state=None): ...

"""


def test_a_class_is_enough_its_parameters_are_the_options(tmp_path, monkeypatch, registry):
    distribution(tmp_path, "hold-house", SIMPLE, hold="hold_house:Hold")
    monkeypatch.syspath_prepend(tmp_path)
    entry = registry.find("hold")
    assert (entry.summary, entry.needs_model) == ("Holds a level", False)
    monkeypatch.setattr("controllers.registry.REGISTRY", registry)
    testcase = load_testcase("bestest_hydronic_heat_pump")
    built = build_controller("hold", {"level": 0.25}, testcase)
    assert (built.testcase, built.level, built.why) == (testcase, 0.25, "")
    for wrong, words in (({"level": "much"}, "level"), ({"levle": 1.0}, "did you mean 'level'"), ({"why": 3}, "why")):
        with pytest.raises(ConfigError, match=words):
            build_controller("hold", wrong, testcase)


def test_a_free_response_has_defaults_for_all_its_options(tmp_path, monkeypatch):
    distribution(tmp_path, "odd-forecast", "def X(step, spread_K=1.0): ...", "free_responses", odd="odd_forecast:X")
    monkeypatch.syspath_prepend(tmp_path)
    fresh = Registry("free response", "free_responses", {}, ConfigError, FREE_RESPONSES.wrong)
    with pytest.raises(ConfigError, match=r"'odd' of odd-forecast 1\.2 .* cannot be used: its parameters step have no"):
        fresh.find("odd")
    assert all(not FREE_RESPONSES.wrong(build) for build in FREE_RESPONSES.own.values())


def test_unknown_names_are_told_what_is_known(registry):
    with pytest.raises(ControllerConfigError, match="unknown controller 'thermostatt', did you mean 'thermostat'"):
        registry.find("thermostatt")
    assert builder(3) == "it is a int, not a function or class"
    with pytest.raises(ConfigError, match=r"unknown testcase 'hous', did you mean 'house'"):
        load_testcase("hous")


@pytest.mark.parametrize(
    ("spec", "testcase", "words"),
    [
        ({}, "singlezone_commercial_hydronic", "give the address of a BOPTEST service"),
        ({"weather": "year.epw"}, "house:2rooms", r"plant\.weather: plant 'rooms'.*leave it out"),
        ({"forecast_uncertainty": "low"}, "house:2rooms", r"plant\.forecast_uncertainty: plant 'rooms'"),
        ({"options": {"leak": 1}}, "house:2rooms", r"plant\.options of plant 'rooms'.*\n.*leak: unknown key"),
    ],
)
def test_a_plant_is_checked_before_it_is_built(spec, testcase, words):
    with pytest.raises(ConfigError, match=words):
        choose_plant(PlantSpec(**spec), load_testcase(testcase), 1)


@pytest.fixture(scope="module")
def example(tmp_path_factory) -> Path:
    """examples/plugin, installed as its page says, into a folder of its own."""
    target = tmp_path_factory.mktemp("site")
    quiet = [
        "--quiet",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--no-compile",
        "--disable-pip-version-check",
    ]
    command = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(target), str(ROOT / "examples/plugin")]
    subprocess.run(command, check=True, timeout=120)
    return target


SCRIPT = """
import json, sys
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.experiment.experiment import Experiment
checked = Experiment.of(load_scenario(None, {"testcase": "north_house", "controller": {
    "options": {"free_response": {"name": "yesterday", "options": {"spread_K": 2.0}}}}}))
import numpy as np
import thermoforce_mpc as tf
from thermoforce_mpc.connections.registry import build_connection
import simulated_building as sim
from live_gateway import served
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
house = sim.SimulatedBuilding()
house.measurements().to_csv("house.csv", index=False)
house.forecast().to_csv("tomorrow.csv")
with served(house) as url:
    gateway = build_connection("gateway", {"url": url})
    control(LiveBuilding(gateway, MeasurementMap.model_validate(sim.RULES), 3600.0), sim.mpc(), clock=house, steps=3)
done = tf.run("north_house", controller="night_setback", baselines=["native"], period="cold_week", days=0.5,
              progress=False)
from contextlib import closing
from thermoforce_mpc.model.free_response.registry import build_free_response
with closing(checked.plant.build()) as plant:
    plant.reset(86400.0 * 30, 86400.0 * 3)
    past, ahead = plant.past(3600.0), plant.forecast(86400.0, 3600.0)
    forecast = build_free_response("yesterday", spread_K=2.0).forecast(past.T_zone_C[0], past, ahead)
json.dump({"kpis": done.kpis, "levels": sorted(set(done.to_dataframe()["u_applied"])), "kind": done.plant.kind,
           "median": list(forecast.median_C), "measured": list(past.T_zone_C[0][-24:]),
           "set": [one[1]["actuator"] for one in house.written],
           "width": float(np.ptp(forecast.quantiles_C[:, 0]))}, sys.stdout)
"""


@pytest.mark.slow
def test_the_example_package_runs(example, tmp_path):
    paths = (ROOT, example, SUPPORT / "buildings", SUPPORT / "services")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found["kpis"]) == {"night_setback", "native"}
    assert found["kind"] == "generated"
    assert found["levels"] == [0.0, 1.0]
    assert found["kpis"]["night_setback"]["ener_tot"] != found["kpis"]["native"]["ener_tot"]
    assert found["median"] == found["measured"]
    assert found["width"] == 4.0
    assert found["set"][-1] is None
    assert any(level is not None for level in found["set"])


LISTS = """
from click.testing import CliRunner
from thermoforce_mpc.cli import cli
for words in (["controllers"], ["plants"], ["free-responses"], ["connections"], ["testcases"],
              ["controllers", "night_setback"], ["connections", "gateway"]):
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    print(done.output)
print(CliRunner().invoke(cli, ["controllers", "worse"]).exception)
"""


@pytest.mark.slow
def test_the_command_line_lists_plugins_with_their_origin(example, tmp_path):
    broken = tmp_path / "broken"
    broken.mkdir()
    distribution(broken, "bad-house", "import nothing_of_this_name", worse="bad_house:X")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, example, broken)))}
    done = subprocess.run([sys.executable, "-c", LISTS], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for name, what in (
        ("night_setback", "NightSetback"), ("north_house", "plant"), ("yesterday", "Yesterday"), ("gateway", "Gateway"),
    ):  # fmt: skip
        assert name in done.stdout
        assert f"from tf-mpc-example 0.1 (tf_mpc_example:{what})" in done.stdout
    assert "controller.options.night_C  (default 19.0)" in done.stdout
    assert "connection.url  (default 'http://127.0.0.1:8123/levels')" in done.stdout
    assert done.stdout.count("controller 'worse' of bad-house 1.2 (bad_house:X) cannot be imported") == 2
