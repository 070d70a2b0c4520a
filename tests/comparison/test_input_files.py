"""Files that a run reads are found where it runs: themselves, or copies of what the user has."""

from __future__ import annotations

from pathlib import Path

import pytest

from thermoforce_mpc.comparison.cells import Variant, expand
from thermoforce_mpc.comparison.input_files import (
    input_files,
    moved,
    paths_of,
)
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario


@pytest.fixture
def scenario(tmp_path, monkeypatch) -> Scenario:
    monkeypatch.chdir(tmp_path)
    Path("Brussels.mos").write_bytes(b"weather")
    for name in ("model.json", "below/arrays.safetensors"):
        Path("model", name).parent.mkdir(parents=True, exist_ok=True)
        Path("model", name).write_text(name, encoding="utf-8")
    Path("mine.yaml").write_text("name: mine", encoding="utf-8")
    return Scenario(
        testcase="mine.yaml",
        plant={"weather": "Brussels.mos"},
        identification={"model": "model"},
        controller={"name": "rc_mpc", "options": {"free_response": {"options": {"backbone": "model"}}, "horizon_h": 3}},
    )


def test_all_files_are_sent_and_found_under_their_names(scenario, tmp_path, monkeypatch):
    assert sorted(set(paths_of(scenario))) == ["Brussels.mos", "mine.yaml", "model"]
    sent = input_files(paths_of(scenario)).read()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    Path("mine.yaml").write_text("name: another", encoding="utf-8")
    with sent.at_hand() as where:
        there = moved(scenario, where)
        assert Path(there.plant.weather).read_bytes() == b"weather"
        assert Path(there.plant.weather).name == "Brussels.mos"
        assert Path(there.testcase).read_text(encoding="utf-8") == "name: mine", "not the worker's own of that name"
        assert (Path(there.identification.model) / "below" / "arrays.safetensors").is_file()
        assert there.controller.options["free_response"]["options"]["backbone"] == there.identification.model
        assert there.controller.options["horizon_h"] == 3
    assert not Path(there.plant.weather).exists()


def test_the_probing_of_a_run_is_sent_without_the_rest_of_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run/probing").mkdir(parents=True)
    Path("run/probing/rc_mpc.jsonl").write_text("probed", encoding="utf-8")
    Path("run/report.html").write_text("report", encoding="utf-8")
    scenario = Scenario(testcase="bestest_hydronic_heat_pump", identification={"probed": "run"})
    task = identification_task(scenario, chosen_of(scenario, load_testcase(scenario.testcase)))
    sent = input_files(paths_of(task)).read()
    Path("run/probing/rc_mpc.jsonl").unlink()
    with sent.at_hand() as where:
        copy = Path(moved(task, where).probed_files)
        assert [path.name for path in copy.iterdir()] == ["rc_mpc.jsonl"]
        assert copy.name == "probing"


def test_what_is_chosen_by_name_is_no_file(tmp_path, monkeypatch):
    options = {
        "free_response": {"name": "residual", "options": {"backbone": "shipped"}},
        "actuation": {"mode": "duty"},
        "actuations": {"actuator": {"mode": "modulating"}},
    }
    base = Scenario(testcase="bestest_hydronic_heat_pump", days=1, controller={"name": "rc_mpc", "options": options})
    variants = {name: Variant(controller=name) for name in ("rc_mpc", "native", "pi")}
    monkeypatch.chdir(tmp_path)
    before = [cell.key for cell in expand(base, variants, ["44"], ["constant"])]
    names = ("residual", "shipped", "one", "several", "duty", "modulating", "auto", "native", "heating", "piqp", "rule")
    for name in (*names, base.testcase):
        Path(name).mkdir()
        Path(name, "file").write_text(name, encoding="utf-8")
    assert [cell.key for cell in expand(base, variants, ["44"], ["constant"])] == before
    assert paths_of(base) == []
    assert moved(base, {name: f"copy of {name}" for name in (*names, base.testcase)}) == base


def test_the_same_file_is_used_where_it_is(scenario):
    with input_files(paths_of(scenario)).read().at_hand() as where:
        assert moved(scenario, where) == scenario


def test_a_missing_file_is_named_and_no_file_is_no_need():
    with pytest.raises(ConfigError, match=r"nowhere\.mos: cannot be read"):
        input_files(["nowhere.mos"])
    assert input_files(paths_of(Scenario(testcase="bestest_hydronic_heat_pump"))) is None
