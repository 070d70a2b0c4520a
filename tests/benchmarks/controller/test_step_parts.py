"""The parts of a step add up to the step, and those of a real loop are all there."""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from benchmarks.controller.steps import WHOLE, part_rows, parts_of, run_timed
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.plants.embedded import EmbeddedPlant


def _step(plan_seconds: float, **parts: float) -> SimpleNamespace:
    plan = SimpleNamespace(seconds=parts)
    return SimpleNamespace(plan=plan, plan_seconds=plan_seconds, forecast_seconds=0.002, plant_seconds=0.5)


def test_parts_add_up_to_the_step_without_the_plant():
    steps = [_step(0.02, forecast=0.005, estimate=0.001, solve=0.008, check=0.001), _step(0.01)]
    parts = parts_of(steps, [0.002, 0.001], [0.001, 0.0], [0.528, 0.513])
    assert parts["controller, rest"] == pytest.approx([0.005, 0.01])
    assert parts["loop, rest"] == pytest.approx([0.005, 0.001])
    assert parts[WHOLE] == pytest.approx([0.03, 0.014])
    shares = {row["part of a step"]: row["share_percent"] for row in part_rows("ipopt", parts)}
    assert shares["plant"] > 100.0
    assert sum(share for name, share in shares.items() if name not in ("plant", WHOLE)) == pytest.approx(100.0)


class Waits(Thermostat):
    """It waits while others use the processor."""

    def plan(self, observation, state=None):
        time.sleep(0.03)
        return super().plan(observation, state)


def test_a_loop_is_timed_with_its_journal_by_processor():
    with EmbeddedPlant(synthetic_weather()) as plant:
        period = replace(plant.period("peak_heat_day"), scored_s=2 * HOUR_S, warmup_s=HOUR_S)
        result, parts = run_timed(plant, Waits(), period)
    assert statistics.median(parts["controller, rest"]) < 0.02
    assert {len(values) for values in parts.values()} == {len(result.steps) - 1}
    assert min(parts["journal"]) > 0.0
    assert min(parts["loop, rest"]) >= 0.0
