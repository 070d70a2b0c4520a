"""What a run of several zones shows on its way and in its report: every zone, actuator and machine by name."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from two_houses import TWO, TwoHouses

from thermoforce_mpc.data import HOUR_S, Block, Layout, Plan, PlanStatus
from thermoforce_mpc.simulation.closed_loop import run_closed_loop
from thermoforce_mpc.simulation.display import LoopDisplay, RunDisplay
from thermoforce_mpc.simulation.report import write_report
from thermoforce_mpc.simulation.report.forecast_check import forecast_errors, free_forecast_scores
from thermoforce_mpc.simulation.run_folder import steps_frame

N = 6
LAYOUT = Layout(TWO, (1, 1), (1, 0), (0, 1), (0.0, 0.0), (0.0, 0.0), (60.0, 40.0))
OFF_K = np.array([0.5, -0.25])


class Planner:
    """Plans that miss the first zone by +0.5 K and the second by −0.25 K: it believes that nothing changes."""

    name, step_s, horizon_s = "planner", HOUR_S, N * HOUR_S

    def plan(self, observation, state=None):
        T = observation.T_zone_C[:, None] + OFF_K[:, None] + np.zeros(N)
        return Plan(
            (Block((0.5, 0.25), HOUR_S),), PlanStatus.SOLVED, "as ever", u=np.tile([[0.5], [0.25]], N),
            T_free_now_C=observation.T_zone_C, T_free_C=T - 1.0, T_forced_K=np.ones_like(T), T_free_low_C=T - 2.0,
            T_free_high_C=T + 5.0, slack_K=0 * T, power_W=0 * T, names=TWO,
        )  # fmt: skip


@pytest.fixture(scope="module")
def result():
    plant = TwoHouses()
    return run_closed_loop(plant, Planner(), plant.period("x"))


def report_of(result, baselines, folder) -> str:
    manifest = {
        "plant": {"kind": "simple"},
        "command": ["tf-mpc"],
        "environment": {},
        "identification": {
            "actuators": {
                "radiator": {"competence": None},
                "floor": {"competence": {"advice": ["hold full level"]}},
            }
        },
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    kpis = {
        "controller": result.controller, "testcase": "two", "period": "x", "start_day": 10.0, "scored_days": 2.0,
        "price": "constant", "plant": "two houses", "weather": "cosine",
    }  # fmt: skip
    return write_report(
        folder, kpis=kpis, result=result, baselines=baselines, currency="EUR", layout=LAYOUT
    ).read_text()


def test_the_report_has_a_row_per_zone_and_a_panel_per_actuator_and_machine(result, tmp_path):
    page = report_of(result, {"baseline": result}, tmp_path)
    for name in (*TWO.zones, *TWO.actuators, *TWO.machines):
        assert page.count(f">{name}</text>") >= 1, name
    assert "predicted a step before" in page
    assert "T, °C (bath, hall)" in page
    assert "· hall" in page, "discomfort of each zone beside the total"
    first = result.steps[0]
    assert f"{first.T_zone_C[0]:.2f}, {first.T_zone_C[1]:.2f}" in page
    assert "0.50, 0.25" in page


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
    events = page.split("Plan status and fallbacks")[1].split("Reasons of the plans")[0]
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
    rows = forecast_errors(result, horizons_h=(1.0, 6.0))
    assert [(row["zone"], row["hours"]) for row in rows] == [(z, h) for z in TWO.zones for h in (1.0, 6.0)]
    for row, off in zip((rows[0], rows[2]), OFF_K, strict=True):
        changes = np.diff([step.T_zone_C[TWO.zones.index(row["zone"])] for step in result.steps])
        assert row["bias_K"] == pytest.approx(off - changes.mean())
    scores = free_forecast_scores(result, horizons_h=(1.0,), settle_h=4.0)
    assert [row["zone"] for row in scores] == list(TWO.zones)
    assert [row["coverage"] for row in scores] == [1.0, 1.0]


def test_progress_shows_every_zone_and_marks_those_outside_their_bounds(result):
    console = Console(width=200, record=True, force_terminal=False)
    with LoopDisplay(console, "planner", result.period, lambda: {}, "EUR", quiet=False) as display:
        for step in result.steps:
            display.step(step)
    line = console.export_text().splitlines()[-1]
    last = result.samples[-1]
    marks = [
        "" if low <= T <= high else "!" for T, low, high in zip(last.T_zone_C, last.lower_C, last.upper_C, strict=True)
    ]
    assert f"T bath {last.T_zone_C[0]:.2f}{marks[0]}, hall {last.T_zone_C[1]:.2f}{marks[1]} °C  u 0.50  nan" in line
    assert "!" in marks, "the second house begins cold"


def test_the_final_table_has_the_discomfort_of_every_zone(result, capsys):
    RunDisplay().kpi_table({"planner": result.kpis}, "title", "EUR")
    told = capsys.readouterr().out
    assert "Discomfort by zone" in told
    assert f"{result.kpis['tdis_tot[hall]']:.2f}" in told
