"""Offset-free prediction: a machine that is weaker than its law does not leave the zone below its bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import GAIN_K, POLE, OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import HOUR_S, Array, Boundary, Observation, Record
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

HELD = {"mode": "modulating", "lowest_level": 0.0}


def settled_K(*, corrections: bool) -> float:
    """Mean distance of the zone from its lower bound in the second night's last hours, K."""
    strong = linear_operator(np.array([POLE]), np.array([1.4 * GAIN_K]), step_s=HOUR_S)
    model = ThermalModel.of_zone(replace(simple_model().only, operator=strong))
    config = MPCConfig(step_s=None, horizon_h=24.0, corrections=corrections, backoff_level=0.5)
    # The exact forecast from where the zone is: what the machine missed in the last step is not foreseen.
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    house = SimpleHouse()
    result = run_closed_loop(house, mpc, house.period("x"))
    nights = [s for s in result.samples if s.lower_C[0] > 20 and (s.start_s % 86400) / HOUR_S < 6]
    return float(np.mean([s.T_zone_C[0] - s.lower_C[0] for s in nights[-6:]]))


@pytest.mark.slow
def test_a_machine_weaker_than_its_law_still_reaches_the_bound(monkeypatch):
    monkeypatch.setattr(MPCConfig, "offset_h", 3.0)
    assert abs(settled_K(corrections=True)) < 0.6 * abs(settled_K(corrections=False))


def test_the_offset_is_the_mean_of_recent_errors_and_limited():
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None), free_response=OutdoorResponse())
    house = SimpleHouse()
    start = house.reset(10 * 86400.0, 24 * HOUR_S)
    observation = Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S))
    plan = mpc.plan(observation)
    state = plan.state
    assert isinstance(state, MPCState)
    assert state.good is not None
    assert state.margins.offset_K.tolist() == [0.0], "nothing was planned before"

    def offset_K(before: MPCState) -> Array:
        return mpc.plan(observation, before).state.margins.offset_K

    cold = replace(state.good, time_s=start.time_s - HOUR_S, T_zone_C=np.full_like(state.good.T_zone_C, 20.0))
    off = replace(state, good=cold)
    error = observation.T_zone_C - 20.0
    assert offset_K(off) == pytest.approx((1 - np.exp(-1 / 6)) * error)
    far = replace(off, good=replace(off.good, T_zone_C=off.good.T_zone_C - 30.0))
    assert offset_K(far).tolist() == [0.3]
    old = replace(
        off,
        margins=replace(off.margins, offset_K=np.array([0.1])),
        good=replace(off.good, time_s=start.time_s - 3 * HOUR_S),
    )
    assert offset_K(old).tolist() == [0.1], "a plan of three hours ago says nothing of this step"


@pytest.mark.parametrize(("gain", "held"), [(1.0, False), (20.0, True)])
def test_in_a_fast_zone_the_end_of_a_step_meets_the_bound_that_held_during_it(gain, held):
    zone = simple_model().only
    model = ThermalModel.of_zone(replace(zone, operator=replace(zone.operator, gains=gain * zone.operator.gains)))
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None), free_response=OutdoorResponse())
    house = SimpleHouse()
    house.reset(10 * 86400.0, 24 * HOUR_S)
    boundary: Boundary = house.forecast(mpc.horizon_s, HOUR_S)
    history: Record = house.past(HOUR_S)
    context = mpc.predictor.context(Observation(history, boundary))
    problem = mpc.instance(context, history)
    drops = np.flatnonzero((boundary.lower_C[0, :-1] == 21.0) & (boundary.lower_C[0, 1:] == 15.0))
    assert drops.size
    assert (problem.lower_C[0, drops] >= 21.0).all() == held
