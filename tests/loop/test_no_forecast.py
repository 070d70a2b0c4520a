"""A plant that gives no forecast for a while: the run goes on with what it knows, says so, and has an end to it."""

from __future__ import annotations

import json
import logging
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from faults import FaultyHouse
from simple_house import SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc import report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S, Period, PlanStatus
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.experiment import experiment as experiment_module
from thermoforce_mpc.experiment.explaining import decision_at
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.records.told_steps import told_run

START_S = 10 * DAY_S


def silent(from_h: float, to_h: float, otherwise=lambda house, given: given) -> FaultyHouse:
    """A house that gives no forecast between two hours of the run."""

    def says(house, given):
        if from_h <= house.hours < to_h:
            raise NoForecast("the weather service is down")
        return otherwise(house, given)

    return FaultyHouse(says=says)


def controller() -> ThermoForceMPC:
    options = {"step_s": 3600, "horizon_h": 12, "gate": {"enabled": False}, "free_response": {"name": "linear_weather"}}
    return ThermoForceMPC(simple_model(), MPCConfig(**options))


def ran(plant, hours: float = 16, **options):
    return run_closed_loop(plant, controller(), Period("test", START_S, hours * HOUR_S, 2 * DAY_S), **options)


@pytest.mark.slow
def test_the_last_forecast_stands_in_and_is_marked(caplog):
    with caplog.at_level(logging.WARNING):
        found = ran(silent(4, 9))
    alone = found.steps[4:9]
    assert {step.plan.status for step in alone} == {PlanStatus.BRIDGED}
    assert all("the plant gives no forecast, the last one is" in " ".join(step.notes) for step in alone)
    assert all("last forecast" in step.plan.why for step in alone)
    assert {step.plan.status for step in (*found.steps[:4], *found.steps[9:])} == {PlanStatus.SOLVED}
    assert [("stands in" in text, "again, after 5 h" in text) for text in caplog.messages] == [
        (True, False),
        (False, True),
    ], "said once at either end"
    # Bounds and prices of the steps are those of the last forecast.
    usual = ran(SimpleHouse())
    for mine, theirs in zip(found.samples, usual.samples, strict=False):
        assert np.array_equal(mine.lower_C, theirs.lower_C)
        assert np.array_equal(mine.price_per_kWh, theirs.price_per_kWh)
    assert found.kpis["tdis_tot"] <= usual.kpis["tdis_tot"] + 0.1


def test_it_has_an_end():
    with pytest.raises(NoForecast, match=r"no forecast for 4 h.*forecast_outage_h allows \(3 h\)"):
        ran(silent(4, 99), outage_h=3.0)
    assert len(ran(silent(4, 99), outage_h=12.0).steps) == 16


def test_a_plant_that_never_gave_a_forecast_ends_the_run_at_once():
    with pytest.raises(NoForecast, match="the weather service is down"):
        ran(silent(0, 99))


@pytest.mark.slow
def test_a_run_killed_without_a_forecast_goes_on_to_the_same_bytes_and_is_explained(tmp_path, monkeypatch):
    simple_model().save(tmp_path / "model")
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: silent(4, 30))
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
    words = ["--model", tmp_path / "model", "--baselines", "", "--days", "0.5", "--out", tmp_path / "run"]
    settings = ["--set", "controller.options.gate.enabled=false", "--set", "step_s=3600", "--set", "days=0.5"]
    words = ["run", "--testcase", "bestest_hydronic_heat_pump", *words, *settings]
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    assert done.output.count("the weather service is down") == 1
    lines = (tmp_path / "run" / "journal.jsonl").read_bytes().split(b"\n")
    ended = [i for i, line in enumerate(lines) if b'"kind":"done"' in line][7]
    folder = tmp_path / "killed"
    shutil.copytree(tmp_path / "run" / "model", folder / "model")
    (folder / "journal.jsonl").write_bytes(b"\n".join(lines[: ended + 1]) + b"\n")
    assert "gives no forecast" in CliRunner().invoke(cli, ["explain", str(folder)]).output
    again = CliRunner().invoke(cli, ["resume", str(folder)])
    assert again.exit_code == 0, again.output
    assert (folder / "trajectory.csv").read_bytes() == (tmp_path / "run" / "trajectory.csv").read_bytes()
    decision = decision_at(folder, "10 09:00")
    assert decision.step.given is None
    assert np.isfinite(decision.boundary.T_out_C).all(), "filled as it was for the plan"
    steps = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert not any("is down" in line["message"] for line in steps if "step" not in line), "not said again"


def gappy(house, given):
    """Forecasts that are too short, or without the price of heating."""
    if 2 <= house.hours < 4:
        return given.head(given.n_steps - 5)
    if 7 <= house.hours < 9:
        return replace(given, heating_price_per_kWh=np.where(given.time_s % DAY_S < 6 * HOUR_S, np.nan, 0.1)[None])
    return given


@pytest.mark.slow
def test_a_journal_tells_the_forecasts_that_the_run_had(tmp_path, monkeypatch):
    simple_model().save(tmp_path / "model")
    had = {}

    def kept(*args, **options):
        had["run"] = run_closed_loop(*args, **options)
        return had["run"]

    monkeypatch.setattr(ChosenPlant, "build", lambda *_: silent(4, 7, gappy))
    monkeypatch.setattr(experiment_module, "run_closed_loop", kept)
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
    words = ["run", "--testcase", "bestest_hydronic_heat_pump", "--model", tmp_path / "model", "--baselines", ""]
    words += ["--out", tmp_path / "run", "--days", "0.5"]
    words += ["--set", "controller.options.gate.enabled=false", "--set", "step_s=3600"]
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    (told,) = told_run(tmp_path / "run").results.values()
    for k, (mine, theirs) in enumerate(zip(told.steps, had["run"].steps, strict=True)):
        explained = decision_at(tmp_path / "run", f"{theirs.time_s:.0f}s").boundary
        for name in CONDITIONS:
            for found in (mine.boundary, explained):
                np.testing.assert_array_equal(getattr(found, name), getattr(theirs.boundary, name), f"{name} of {k}")
