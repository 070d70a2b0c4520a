"""Excitation as a controller: all that it knows is in its state, which goes through a file between any two steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from simple_house import SimpleHouse

from thermoforce_mpc.data import DAY_S, Layout, Observation, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.probe import ProbingConfig, ProbingController
from thermoforce_mpc.live.building import Kept, KeptState
from thermoforce_mpc.loop.probing import probe

CONFIG = ProbingConfig(trial_levels=(0.5,), trial_steps=4, warmup_days=1.0, candidates=4)
DAYS = 1.0


def probed_through_a_file(tmp_path, every):
    """As `probe`, but the state is read from a file again after every so many steps, as after a kill."""
    plant, n = SimpleHouse(), round(DAYS * 96)
    plant.reset(20 * DAY_S, DAY_S)
    history, state = plant.past(900.0), None
    begin = history.n_steps
    until = lambda record, planned: (n, "its days are over" if record.n_steps >= n else "")  # noqa: E731
    for step in range(n + 1):
        controller = ProbingController(Layout.single(), CONFIG, 3, until)
        plan = controller.plan(Observation(history, plant.forecast(controller.horizon_s, 900.0)), state)
        state = plan.state
        if plan.ends:
            break
        if step % every == 0:
            KeptState(tmp_path / "state.npz", "k").save(Kept("2025-01-01T00:00Z", "2025-01-02T00:00Z", None, state, ()))
            kept = KeptState(tmp_path / "state.npz", "k").load(pd.Timestamp("2025-01-02T00:00Z"))
            state = kept.after
        history = history.extended(plant.advance(plan.blocks[0].u, 900.0))
    assert plan.ends == "its days are over"
    assert step == n
    return history.slice(begin, history.n_steps), state


def test_a_probing_that_is_killed_at_any_step_is_the_same_probing(tmp_path):
    whole = probe(SimpleHouse(), 20 * DAY_S, DAYS, seed=3, config=CONFIG)
    record, state = probed_through_a_file(tmp_path, 7)
    np.testing.assert_array_equal(record.u, whole.u)
    np.testing.assert_array_equal(record.T_zone_C, whole.T_zone_C)
    np.testing.assert_array_equal(state.asked, whole.u)
    assert {0.0, 0.5, 1.0} <= set(whole.u[0])


def test_gaps_in_what_is_measured_do_not_end_a_probing():
    plant = SimpleHouse()
    plant.reset(20 * DAY_S, DAY_S)
    history = plant.past(900.0)
    controller = ProbingController(Layout.single(), CONFIG, 3, lambda record, planned: (96, ""))
    forecast = plant.forecast(controller.horizon_s, 900.0)
    state = controller.plan(Observation(history, forecast)).state
    for step in range(60):
        now = plant.advance(tuple(state.asked[:, -1].tolist()), 900.0)
        history = history.extended(replace(now, T_zone_C=[np.nan]) if step % 5 == 2 else now)
        ahead = replace(forecast, time_s=forecast.time_s + 900.0 * (step + 1), T_out_C=forecast.T_out_C * np.nan)
        plan = controller.plan(Observation(history, ahead), state)
        state = plan.state
        assert 0.0 <= plan.blocks[0].u[0] <= 1.0
    silent = replace(history, T_zone_C=np.full(history.T_zone_C.shape, math.nan))
    with pytest.raises(DataError, match="keeps no comfort without"):
        controller.plan(Observation(silent, ahead), state)
    assert isinstance(silent, Record)
