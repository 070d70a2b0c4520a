"""One controller per zone: as the joint one where the zones have nothing to do with each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simple_house import SimpleHouse, simple_model
from two_houses import TWO, TwoHouses, two_model, two_observation

from benchmarks.zones.apart import OnePerZone
from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.data import PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop

# The free response is that of no change: these houses have no linear weather model, and no forecaster is loaded.
CONFIG = MPCConfig(step_s=None, horizon_h=24.0, free_response={"name": "persistence"})


def test_zones_that_do_not_touch_are_planned_alike_together_and_apart():
    seen = two_observation(houses=TwoHouses(lower_K=1.0))
    apart = OnePerZone(two_model(), CONFIG).plan(seen)
    joint = ThermoForceMPC(two_model(), CONFIG).plan(seen)
    assert apart.acting == (PlanStatus.SOLVED,) * 2
    for a in range(2):
        mean = [sum(block.u[a] * block.duration_s for block in plan.blocks) for plan in (apart, joint)]
        assert mean[0] == pytest.approx(mean[1], abs=1.0)


@pytest.mark.slow
def test_a_closed_loop_takes_its_blocks():
    result = run_closed_loop(TwoHouses(lower_K=1.0), OnePerZone(two_model(), CONFIG), SimpleHouse().period("x"))
    assert not any(step.refused for step in result.steps)
    assert all(len(block.u) == len(TWO.actuators) for step in result.steps for block in step.plan.blocks)
    assert len({block.u for step in result.steps for block in step.plan.blocks}) > 2


def test_each_zone_needs_one_actuator():
    model = two_model()
    shared = replace(model.operator, pairs=((model.operator.pairs[0][0],) * 2, (None, None)), home=(0, 0))
    with pytest.raises(DataError, match="each zone needs one actuator"):
        OnePerZone(replace(model, operator=shared), CONFIG)
    assert OnePerZone(simple_model(), CONFIG).step_s > 0
