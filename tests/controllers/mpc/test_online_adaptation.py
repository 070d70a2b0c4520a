"""Online adaptation in the closed loop: the controller notices that its machine gives less than it was told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse
from simple_house import OutdoorResponse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.simulation.closed_loop import run_closed_loop


def weak_house() -> FaultyHouse:
    """A house whose heater gives four fifths of what the model was told."""
    return FaultyHouse(
        shows=lambda house, seen: replace(seen, u=seen.u / 0.8), gives=lambda house, u: None if u is None else 0.8 * u
    )


@pytest.mark.slow
def test_online_adaptation_finds_a_weaker_machine_and_plans_with_it():
    found = {}
    for enabled in (False, True):
        house = weak_house()
        config = MPCConfig(step_s=None, horizon_h=24.0, adaptation={"enabled": enabled, "gain_sd": 0.3})
        mpc = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
        period = replace(house.period("x"), scored_s=8 * 86400.0)
        result = run_closed_loop(house, mpc, period)
        assert result.fallback_levels()["solved"] == len(result.steps)
        actual = np.array([step.T_zone_C[0] for step in result.steps[1:]])
        predicted = np.array([step.plan.T_zone_C[0, 0] for step in result.steps[:-1]])
        errors = (actual - predicted)[-72:]
        (learned,) = result.state.adaptation
        found[enabled] = learned, float(np.sqrt(np.mean(errors**2)))
    gain = simple_model().only.operator.gains[0]
    assert found[False][0] is None
    learned = found[True][0]
    assert float(learned.model.operator.gains[0]) == pytest.approx(0.8 * gain, rel=0.12)
    assert found[True][1] < 0.8 * found[False][1]
    assert sum(step.outcome == "updated" for step in learned.steps) >= 3
