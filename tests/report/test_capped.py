"""How far metered power stayed below a cap, counted over control steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import FIXED_W, PER_U_W, SimpleHouse

from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.report.findings import Capped, capped_figures
from thermoforce_mpc.scenario.scenario import Scenario

FULL_KW = (FIXED_W + PER_U_W) / 1000.0
CAPPED = Scenario(
    testcase="bestest_hydronic_heat_pump",
    controller={"options": {"objective": {"power_cap_kW": 3.0}}},
)


@pytest.fixture(scope="module")
def house() -> RunResult:
    plant = SimpleHouse()
    return run_closed_loop(plant, Thermostat(), plant.period("x"))


def metered(result: RunResult, first_kW: list[float]) -> RunResult:
    """The run with other power in its first blocks."""
    steps = []
    for k, step in enumerate(result.steps):
        kW = first_kW[k] if k < len(first_kW) else 0.0
        steps.append(replace(step, samples=tuple(replace(s, power_W=np.array([1000.0 * kW])) for s in step.samples)))
    return replace(result, steps=steps)


def test_steps_above_the_cap_are_counted_by_their_mean(house):
    step_s = house.steps[0].samples[0].duration_s
    found = capped_figures(CAPPED, metered(house, [2.9, 3.1, float("nan"), 3.0]), {"full": metered(house, [FULL_KW])})
    n = len(house.steps)
    assert found["thermostat"] == {
        "cap_kW": 3.0, "step_s": step_s, "above": 1, "steps": n - 1, "highest_kW": pytest.approx(3.1)
    }  # fmt: skip
    assert (found["full"]["above"], found["full"]["steps"]) == (1, n)


def test_blocks_of_a_step_are_taken_together(house):
    step = house.steps[0]
    (sample,) = step.samples
    third_s = sample.duration_s / 3.0
    blocks = [
        replace(sample, start_s=sample.start_s + i * third_s, duration_s=third_s, power_W=np.array([watts]))
        for i, watts in enumerate((0.0, FULL_KW * 1000.0, FULL_KW * 1000.0))
    ]
    result = replace(metered(house, []), steps=[replace(step, samples=tuple(blocks))])
    assert capped_figures(CAPPED, result, {})["thermostat"]["highest_kW"] == pytest.approx(2.0 / 3.0 * FULL_KW)


def test_nothing_is_counted_without_a_cap(house):
    assert capped_figures(Scenario(testcase="bestest_hydronic_heat_pump"), house, {}) == {}


def test_a_quarter_of_an_hour_is_named_so():
    assert (
        Capped(3.0, 900.0, 0, 192, 2.9).in_words() == "above the cap of 3 kW: 0 of 192 quarter hours, highest 2.90 kW"
    )
    assert "1 of 48 steps of 60 min" in Capped(3.0, 3600.0, 1, 48, 4.0).in_words()
