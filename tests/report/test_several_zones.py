"""What a run of several zones shows on its way and in its report: every zone, actuator and machine by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report_runs import OFF_K, planned, report_of
from rich.console import Console
from two_houses import TWO

from thermoforce_mpc.data import DAY_S, PlanStatus
from thermoforce_mpc.records.run_folder import steps_frame
from thermoforce_mpc.report import display as display_module
from thermoforce_mpc.report.display import LoopDisplay, RunDisplay
from thermoforce_mpc.report.html import forecast_errors, free_forecast_scores


@pytest.fixture(scope="module")
def result():
    return planned()


def test_the_report_tells_the_figures_of_every_zone(result, tmp_path):
    page = report_of(result, {"baseline": result}, tmp_path)
    assert "· hall" in page, "discomfort of each zone beside the total"
    assert "floor: hold full level" not in page, "advice belongs to a gate that held"


def test_the_step_log_says_what_acted_at_each_actuator(result):
    step = result.steps[0]
    partly = replace(step.plan, acting=(PlanStatus.SOLVED, PlanStatus.THERMOSTAT))
    frame = steps_frame([step, replace(step, plan=partly)])
    assert frame["status[radiator]"].tolist() == ["solved", "solved"]
    assert frame["status[floor]"].tolist() == ["solved", "thermostat"]


def test_every_level_of_the_fallback_is_told_with_its_reason_in_report_and_progress(result, tmp_path):
    levels = [
        PlanStatus.BRIDGED, PlanStatus.ACCEPTABLE, PlanStatus.SHIFTED, PlanStatus.THERMOSTAT, PlanStatus.NATIVE,
    ]  # fmt: skip
    fallen = [
        replace(step, plan=replace(step.plan, status=status, why=f"because of {status}"))
        for step, status in zip(result.steps, levels, strict=False)
    ]
    broken = replace(result, steps=(*fallen, *result.steps[len(fallen) :]))
    page = report_of(broken, {}, tmp_path)
    events = page.split('id="ladder"')[1].split('id="computing"')[0]
    for status in levels:
        assert f"because of {status}" in events
        assert f"{status}: <b>1</b>" in events
    assert "as ever" not in events
    console = Console(width=300, record=True, force_terminal=False)
    with LoopDisplay(console, "planner", result.period, lambda: {}, "EUR", quiet=False) as display:
        for step in broken.steps:
            display.step(step)
    assert console.export_text().splitlines()[-1].endswith("bridged 1  fallbacks 4")


def test_prediction_errors_are_told_zone_by_zone(result):
    rows = forecast_errors(result)
    hours = sorted({row["hours"] for row in rows})
    assert hours[:2] == [1.0, 6.0]
    assert [(row["zone"], row["hours"]) for row in rows] == [(z, h) for z in TWO.zones for h in hours]
    for row, off in zip((rows[0], rows[len(hours)]), OFF_K, strict=True):
        changes = np.diff([step.T_zone_C[TWO.zones.index(row["zone"])] for step in result.steps])
        assert row["bias_K"] == pytest.approx(off - changes.mean())
    before = [replace(step, time_s=step.time_s - 2 * DAY_S) for step in result.steps]
    scores = free_forecast_scores(replace(result, steps=[*before, *result.steps]))
    scores = [row for row in scores if row["hours"] == 1.0]
    assert [row["zone"] for row in scores] == list(TWO.zones)
    assert [row["coverage"] for row in scores] == [1.0, 1.0]


def test_predictions_that_no_reading_answers_are_not_scored(result):
    """The sensor of the second zone is silent from the 24th step on, that of the first throughout."""
    nan = float("nan")
    silent = [
        replace(step, T_zone_C=np.array([nan, step.T_zone_C[1] if k < 24 else nan]))
        for k, step in enumerate(result.steps)
    ]
    (row,) = (row for row in forecast_errors(replace(result, steps=silent)) if row["hours"] == 1.0)
    assert (row["zone"], row["n"]) == (TWO.zones[1], 23)
    assert np.isfinite(row["rmse_K"])


def test_progress_shows_every_zone_and_marks_those_outside_their_bounds(result, monkeypatch):
    console = Console(width=200, record=True, force_terminal=False)
    monkeypatch.setattr(display_module, "SAID_AFTER_S", 0.0)
    monkeypatch.setattr(display_module, "MOST_APART_S", 0.0)
    with LoopDisplay(console, "planner", result.period, lambda: {}, "EUR", quiet=False) as display:
        for step in result.steps:
            display.step(step)
    line = next(text for text in console.export_text().splitlines() if "day  1.00/" in text)
    last = result.samples[len(result.samples) // 2 - 1]  # at the end of the first of two days
    marks = [
        "" if low <= T <= high else "!" for T, low, high in zip(last.T_zone_C, last.lower_C, last.upper_C, strict=True)
    ]
    assert f"T bath {last.T_zone_C[0]:.2f}{marks[0]}, hall {last.T_zone_C[1]:.2f}{marks[1]} °C  u 0.50  nan" in line
    assert "!" in marks, "the second house begins cold"


def test_the_final_table_keeps_its_figures_in_a_narrow_terminal(result, capsys):
    display = RunDisplay()
    display.console = Console(width=50)
    kpis = dict.fromkeys(("cost_tot", "tdis_tot", "ener_tot", "emis_tot", "pele_tot"), 0.2446) | {"time_rat": 2e-4}
    display.kpi_table({"thermoforce_mpc": kpis, "native": kpis}, "title", "EUR", {"thermoforce_mpc": "not competent"})
    told = capsys.readouterr().out
    assert "…" not in told
    assert told.count("0.245*") == 8
    assert told.count("0.24*") == 2  # discomfort, K·h


def test_the_final_table_has_the_discomfort_of_every_zone(result, capsys):
    RunDisplay().kpi_table({"planner": result.kpis}, "title", "EUR")
    told = capsys.readouterr().out
    assert "Discomfort by zone" in told
    assert f"{result.kpis['tdis_tot[hall]']:.2f}" in told
