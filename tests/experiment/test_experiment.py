"""A scenario is resolved once: what it names is looked up, read and checked one time, and the result is a value."""

from __future__ import annotations

import shutil
from collections import Counter

import pytest
from click.testing import CliRunner
from simple_house import SimpleHouse

from controllers import registry
from thermoforce_mpc.cli import cli
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.identifying import IdentificationTask, SavedModel
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.plants import testcases
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.scenario import settings
from thermoforce_mpc.scenario import testcase as testcase_module
from thermoforce_mpc.scenario.scenario import Scenario

TESTCASE = "bestest_hydronic_heat_pump"


@pytest.fixture
def done(monkeypatch) -> Counter[tuple[str, object]]:
    """How often each thing was done."""
    times: Counter[tuple[str, object]] = Counter()

    def counted(owner, name, what, of):
        whole = getattr(owner, name)

        def count(*given):
            times[what, of(*given)] += 1
            return whole(*given)

        monkeypatch.setattr(owner, name, count)

    counted(registry, "find_entry", "looked up", lambda name: name)
    counted(registry, "validate", "validated", lambda model, data, source: source)
    counted(settings, "read_yaml", "read", str)
    counted(testcases, "read_yaml", "read", str)
    counted(testcase_module, "parse_yaml", "read", lambda content, path: str(path))
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
    return times


def test_a_run_looks_each_entry_up_validates_each_options_and_reads_each_file_once(done, tmp_path):
    shutil.copyfile(named_configs("testcases")[TESTCASE], case := tmp_path / "case.yaml")
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(f"testcase: {case}\ncontroller: {{name: pi}}\nbaselines: [thermostat, native, pi]\n")
    words = ["run", "--config", scenario, "--days", "0.1", "--quiet", "--out", tmp_path / "run"]
    ran = CliRunner().invoke(cli, [str(word) for word in words])
    assert ran.exit_code == 0, ran.output
    assert done == {
        **{("looked up", name): 1 for name in ("pi", "thermostat", "native")},
        **{("validated", f"options of controller '{name}'"): 1 for name in ("pi", "thermostat", "native")},
        ("read", str(case)): 1,
        ("read", str(scenario)): 1,
    }


def test_experiments_of_one_content_are_one_value():
    scenario = Scenario(testcase=TESTCASE, controller={"name": "pi", "options": {"kp": 0.5}})
    one, same = Experiment.of(scenario), Experiment.of(scenario.model_copy())
    other = Experiment.of(scenario.model_copy(update={"days": 3.0}))
    assert {one: "kept"}[same] == "kept"
    assert len({one, same, other}) == 2
    with pytest.raises(AttributeError):
        one.days = 2.0


def test_a_contestant_knows_where_its_model_comes_from(tmp_path):
    probed = Experiment.of(Scenario(testcase=TESTCASE, baselines=("native", "rc_mpc")))
    assert [type(one.model_from) for one in probed.contestants] == [IdentificationTask, type(None), IdentificationTask]
    saved = Experiment.of(Scenario(testcase=TESTCASE, step_s=3600, identification={"model": str(tmp_path)}))
    assert saved.own.model_from == SavedModel(str(tmp_path), 3600.0)
