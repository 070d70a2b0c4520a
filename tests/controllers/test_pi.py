"""The PI controller: its law by hand, no wind-up, anticipation, and that it holds a house."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from simple_house import SimpleHouse

from controllers.pi import PIConfig, PIController
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation, Period, PlanStatus, Record
from thermoforce_mpc.simulation.closed_loop import run_closed_loop


def observation(T: float, time_s: float, lower_C: float | list[float] = 21.0) -> Observation:
    n = 2 if isinstance(lower_C, float) else len(lower_C)
    line, times = np.ones(n), time_s + 900.0 * np.arange(n)
    lower = lower_C * line if isinstance(lower_C, float) else np.array(lower_C)
    history = Record([time_s], [T], [0.0], [0.0], [], [], [])
    return Observation(history, Boundary(times, 0 * line, 0 * line, line, lower, 24 * line, line, line))


def share(controller: PIController, T: float, time_s: float, **kind) -> float:
    blocks = controller.plan(observation(T, time_s, **kind)).blocks
    return sum((block.u or 0.0) * block.duration_s for block in blocks) / sum(block.duration_s for block in blocks)


def test_the_law_by_hand():
    pi = PIController(PIConfig(kp=0.5, ti_s=3600.0, offset_K=0.0, lead_h=0.0, actuation="modulating", off_below=0.0))
    assert share(pi, 20.6, 0.0) == pytest.approx(0.2)  # 0.5 · 0.4 K, nothing integrated yet
    assert share(pi, 20.6, 900.0) == pytest.approx(0.2 + 0.5 * 0.4 * 900 / 3600)
    assert share(pi, 20.8, 1800.0) == pytest.approx(0.1 + 0.05 + 0.5 * 0.2 * 900 / 3600)


def test_a_long_cold_spell_does_not_wind_up():
    pi = PIController(PIConfig(offset_K=0.0, lead_h=0.0))
    for k in range(200):
        assert share(pi, 15.0, 900.0 * k) == 1.0
    assert share(pi, 21.2, 900.0 * 200) == 0.0


def test_a_rising_bound_is_met_before_it_comes():
    config = PIConfig(kp=1.0, offset_K=0.0, lead_h=0.5)
    rising = [15.0, 15.0, 21.0, 21.0]
    assert share(PIController(config), 20.0, 0.0, lower_C=rising) == 1.0
    assert share(PIController(config), 20.0, 0.0, lower_C=[15.0, 15.0, 15.0, 21.0]) == 0.0


def test_duty_switches_in_whole_minutes_and_off_below_its_threshold():
    pi = PIController(PIConfig(kp=0.5, offset_K=0.0, lead_h=0.0, off_below=0.15))
    blocks = pi.plan(observation(20.2, 0.0)).blocks
    assert [(block.u, block.duration_s) for block in blocks] == [(1.0, 360.0), (0.0, 540.0)]
    assert share(PIController(PIConfig(kp=0.5, offset_K=0.0, lead_h=0.0, off_below=0.15)), 20.8, 0.0) == 0.0


def test_a_modulating_machine_runs_at_least_at_its_lowest_level():
    config = PIConfig(kp=0.5, offset_K=0.0, lead_h=0.0, actuation="modulating", lowest_level=0.7)
    assert share(PIController(config), 20.2, 0.0) == 0.7


def test_cooling_follows_the_upper_bound():
    pi = PIController(PIConfig(mode="cooling", offset_K=0.0, lead_h=0.0))
    assert share(pi, 25.0, 0.0) == 1.0
    assert share(pi, 23.5, 900.0) == 0.0


def test_a_silent_sensor_hands_over_to_native_control():
    plan = PIController().plan(observation(float("nan"), 0.0))
    assert plan.blocks[0].u is None
    assert plan.status is PlanStatus.RULE


def test_levels_out_of_order_are_refused():
    with pytest.raises(ValidationError, match=r"lowest_level 0.8 is above level 0.5"):
        PIConfig(level=0.5, lowest_level=0.8)


def test_it_holds_a_house_near_its_set_point():
    period = Period("winter", 10 * DAY_S, 2 * DAY_S, DAY_S)
    result = run_closed_loop(SimpleHouse(), PIController(PIConfig(lead_h=0.0)), period)
    night = [s for s in result.samples if DAY_S + 2 * HOUR_S < s.start_s - period.start_s < DAY_S + 7 * HOUR_S]
    assert len(night) > 15
    assert {s.lower_C for s in night} == {21.0}
    assert np.mean([s.T_zone_C for s in night]) == pytest.approx(21.3, abs=0.2)
