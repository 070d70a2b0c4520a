"""The report of a run made again from its folder: the same page, or as much of it as the run came to."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from report_page import data_of
from simple_house import SimpleHouse, simple_model

from boptest_client import TransportConfig
from thermoforce_mpc.cli import cli
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.records.journal import read_journal


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run of the MPC and a baseline on the simple house."""
    root = tmp_path_factory.mktemp("runs")
    simple_model().save(root / "model")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
        words = ["--model", root / "model", "--baselines", "thermostat", "--days", "1", "--out", root / "whole"]
        words += ["--set", "controller.options.gate.enabled=false", "--set", "step_s=3600"]
        words += ["--set", "controller.options.free_response.name=persistence"]
        words += ["--set", "controller.options.objective.power_cap_kW=4.5"]
        done = call("run", "--testcase", "bestest_hydronic_heat_pump", *words)
        assert done.exit_code == 0, done.output
        assert "above the cap of 4.5 kW: 0 of 24 steps of 60 min, highest 4.30 kW" in done.output
    return root / "whole"


def cut(whole, folder, lines):
    """The run as it was when its journal had so many lines, and half of the next one."""
    folder.mkdir()
    kept = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(kept[:lines]) + kept[lines][:40])
    return folder


def last_line(folder, kind, n):
    """Line of the record number `n` of a kind, from 0."""
    found = [entry.line for entry in read_journal(folder / "journal.jsonl").entries if entry.kind == kind]
    return found[n]


@pytest.mark.slow
def test_the_report_of_a_whole_run_is_the_same_again(whole, tmp_path):
    done = call("report", whole, "--out", tmp_path / "again.html")
    assert done.exit_code == 0, done.output
    again, page = (tmp_path / "again.html").read_text(), (whole / "report.html").read_text()
    assert "cut off" not in again
    figures = json.loads((whole / "kpis.json").read_text())["power_cap"]
    assert {name: (found["above"], found["steps"]) for name, found in figures.items()} == {
        "thermoforce_mpc": (0, 24), "thermostat": (0, 24)
    }  # fmt: skip
    assert page.count("above the cap of 4.5 kW: 0 of 24 steps of 60 min") == 2
    assert again.count("above the cap of 4.5 kW: 0 of 24 steps of 60 min") == 2
    found, expected = data_of(again), data_of(page)
    assert found["own"] == expected["own"]
    assert found["baselines"] == expected["baselines"]
    for key in ("time_s", "status", "acting", "why", "texts", "iterations", "plan_ms", "parts_ms"):
        assert found["steps"][key] == expected["steps"][key], key
    assert found["answers"] == expected["answers"]
    assert found["plans"]["n"] == expected["plans"]["n"]
    assert len(again) == pytest.approx(len(page), rel=0.01)


def test_of_a_run_that_was_cut_off_it_shows_what_there_is_and_says_so(whole, tmp_path):
    folder = cut(whole, tmp_path / "cut", last_line(whole, "done", 11))
    done = call("report", folder)
    assert done.exit_code == 0, done.output
    assert "thermoforce_mpc was cut off after 0.5 of 1 days, at day 10 12:00" in done.output
    assert "thermostat had not begun" in done.output
    page = (folder / "report.html").read_text()
    assert "was cut off after 0.5 of 1 days" in page
    assert "tf-mpc resume" in page
    assert "model of the run is not shown" in page  # its folder is gone
    assert len(data_of(page)["steps"]["status"]) == 12
    assert not data_of(page)["baselines"]


def test_a_baseline_that_was_cut_off_stands_beside_the_whole_run(whole, tmp_path):
    folder = cut(whole, tmp_path / "cut", last_line(whole, "done", 30))
    done = call("report", folder)
    assert "thermostat was cut off" in done.output
    assert "thermoforce_mpc was cut off" not in done.output
    kpis = json.loads((whole / "kpis.json").read_text())["kpis"]
    assert f"{kpis['cost_tot']:.4g}" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("lines", "message"), [(0, "holds no run"), (4, "no step has ended yet"), (None, "no such folder")]
)
def test_without_a_step_there_is_nothing_to_show(whole, tmp_path, lines, message):
    folder = tmp_path / "cut"
    if lines is not None:
        cut(whole, folder, lines)
    done = call("report", folder)
    assert message in str(done.exception)
    assert not (folder / "report.html").exists()


def test_a_service_that_refuses_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("thermoforce_mpc.plants.registry.patience", lambda spec: TransportConfig(connect_timeout_s=0.1))
    words = ["--testcase", "bestest_hydronic_heat_pump", "--url", "http://127.0.0.1:9", "--controller", "thermostat"]
    done = call("run", *words, "--out", tmp_path / "run")
    assert "cannot be reached" in str(done.exception)
    assert not (tmp_path / "run").exists()
