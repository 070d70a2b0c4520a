"""Steps of a long run are kept in a file beyond the latest, and read back as they were."""

from __future__ import annotations

import pickle
import resource

import numpy as np
import pytest
from simple_house import SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import StorageError
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.simulation.closed_loop import run_closed_loop
from thermoforce_mpc.simulation.folder.run_folder import steps_frame, trajectory_frame
from thermoforce_mpc.simulation.kept_steps import KeptSteps
from thermoforce_mpc.simulation.report.forecast_check import forecast_errors


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
