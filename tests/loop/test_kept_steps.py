"""Steps of a long run are kept in a file beyond the latest, and read back as they were."""

from __future__ import annotations

import pickle
import resource
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from simple_house import SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Period, PlanStatus
from thermoforce_mpc.errors import StorageError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.journal import Journal, JournalError, read_journal
from thermoforce_mpc.records.run_folder import steps_frame, trajectory_frame
from thermoforce_mpc.report.findings import gates_held, watch_spells
from thermoforce_mpc.report.html import forecast_errors, free_forecast_scores


def test_steps_come_back_in_order(tmp_path):
    kept = KeptSteps(tmp_path, in_memory=3)
    for i in range(10):
        kept.append({"i": i, "x": np.full(3, float(i))})
    assert len(kept) == 10
    assert [step["i"] for step in kept] == list(range(10))
    assert kept[2]["x"].tolist() == [2.0] * 3
    assert kept[-1]["i"] == 9
    assert kept[-10]["i"] == 0
    assert [step["i"] for step in kept[1:9:3]] == [1, 4, 7]
    with pytest.raises(IndexError):
        kept[10]
    assert list(tmp_path.iterdir()) == [], "the file has no name"
    assert [step["i"] for step in pickle.loads(pickle.dumps(kept))] == list(range(10))
    # Reading in the middle of writing.
    for i, step in enumerate(kept):
        assert step["i"] == i
        kept[0]


@pytest.mark.slow
def test_a_run_is_the_same_wherever_its_steps_are(tmp_path):
    options = {"step_s": 3600, "gate": {"enabled": False}, "free_response": {"name": "linear_weather"}}
    config = controller_config("thermoforce_mpc", options, load_testcase("bestest_hydronic_heat_pump"))
    period = Period("x", 10 * DAY_S, DAY_S, 2 * DAY_S)
    steps = KeptSteps(tmp_path, in_memory=2)
    here, away = (
        run_closed_loop(SimpleHouse(), ThermoForceMPC(simple_model(), config), period, steps=kept)
        for kept in (None, steps)
    )
    assert away.steps is steps
    assert here.fallback_levels() == away.fallback_levels()
    assert trajectory_frame(here.steps).equals(trajectory_frame(away.steps))
    said = ["time_s", "status", "u_planned", "T_free_next_C", "slack_sum_K", "why"]
    assert steps_frame(here.steps)[said].equals(steps_frame(away.steps)[said])
    assert forecast_errors(here) == forecast_errors(away)
    # A step that kept a part of the record would keep it whole, one for each step in memory.
    assert all(step.T_zone_C.base is None for step in here.steps)


def test_a_full_disk_is_named(tmp_path):
    kept = KeptSteps(tmp_path, in_memory=1)
    kept.append(b"x" * 5000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(StorageError, match="steps of this run"):
            kept.append(b"y")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("status", [PlanStatus.WATCH, PlanStatus.GATE])
def test_what_is_told_of_a_long_run_takes_its_steps_one_by_one(tmp_path, status):
    steps: KeptSteps[SimpleNamespace] = KeptSteps(tmp_path, in_memory=1)
    plan = SimpleNamespace(status=status, why="watch: colder", news="", u=np.zeros(12_500))
    for i in range(200):
        sample = SimpleNamespace(start_s=i * 3600.0, duration_s=3600.0)
        steps.append(SimpleNamespace(time_s=i * 3600.0, plan=plan, samples=(sample,)))
    result = SimpleNamespace(controller="mpc", steps=steps)
    tracemalloc.start()
    try:
        spells, gates = watch_spells(result), gates_held(result, {})
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2_000_000, "the steps are 20 MB"
    assert [(spell.start_s, spell.end_s) for spell in spells] == [(0.0, 720_000.0)] * (status is PlanStatus.WATCH)
    assert [gate.steps for gate in gates.values()] == [200] * (status is PlanStatus.GATE)


def test_forecasts_of_a_long_run_are_scored_step_by_step(tmp_path):
    steps: KeptSteps[SimpleNamespace] = KeptSteps(tmp_path, in_memory=1)
    for i in range(200):
        courses = {name: np.full((1, 4_000), float(i)) for name in ("T_zone_C", "T_free_low_C", "T_free_C", "u")}
        plan = SimpleNamespace(**courses, T_free_high_C=np.full((1, 4_000), i + 0.5), T_free_now_C=np.full(1, float(i)))
        boundary, T_C = SimpleNamespace(step_s=3600.0), np.full(1, float(i))
        steps.append(SimpleNamespace(time_s=i * 3600.0, plan=plan, T_zone_C=T_C, boundary=boundary))
    result = SimpleNamespace(steps=steps, names=SimpleNamespace(zones=("zone",)))
    tracemalloc.start()
    try:
        errors, free = forecast_errors(result), free_forecast_scores(result)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2_000_000, "the steps are 32 MB"
    assert errors[0] == {"zone": "zone", "hours": 1.0, "bias_K": -1.0, "rmse_K": 1.0, "n": 199}
    assert free[2] == {"zone": "zone", "hours": 24.0, "mae_K": 24.0, "coverage": 0.0, "n": 128}


def test_a_journal_that_was_read_leaves_its_records_in_the_file(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl")
    for i in range(200):
        journal.write("note", {"value": i, "text": "x" * 100_000})
    journal.close()
    tracemalloc.start()
    try:
        entries = read_journal(tmp_path / "journal.jsonl").entries
        kept = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert kept < 1_000_000, "the journal is 20 MB"
    assert [entry.content["value"] for entry in entries] == list(range(200))
    assert set(entries[0].content) == {"n", "value", "text"}
    (tmp_path / "journal.jsonl").unlink()
    with pytest.raises(JournalError, match=r"journal.jsonl, line 8: cannot be read any more"):
        entries[7].content  # noqa: B018
