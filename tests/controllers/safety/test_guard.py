"""The comfort guard: a model or forecast that is wrong does not take the zone far outside the comfort band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import shifted
from simple_house import SimpleHouse, bounds_C, simple_model

from controllers import ThermoForceMPC
from controllers.monitoring.zone_sensors import Zones
from controllers.mpc.config import MPCConfig
from controllers.safety.overrides import ComfortGuard, GuardConfig, Override, Situation
from thermoforce_mpc.data import Array, Layout, Observation, PlanStatus, Record
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop

# The forecast is to be believed although the weather model says otherwise.
WRONG = {"free_response": {"substitutes": False}}


def run(off_K: float, **guard: object) -> RunResult:
    config = MPCConfig(step_s=None, horizon_h=24.0, guard=GuardConfig(**guard), watch={"enabled": False}, **WRONG)
    mpc = ThermoForceMPC(simple_model(), config, free_response=shifted(off_K))
    house = SimpleHouse()
    return run_closed_loop(house, mpc, house.period("x"))


def outside_K(result: RunResult) -> Array:
    """How far each sample is outside the comfort band, K."""
    T = np.array([sample.T_zone_C[0] for sample in result.samples])
    lower, upper = bounds_C(np.array([sample.start_s + sample.duration_s for sample in result.samples]))
    return np.maximum(lower - T, T - upper)


@pytest.mark.slow
@pytest.mark.parametrize("off_K", [12.0, -12.0], ids=["forecast too warm", "forecast too cold"])
def test_a_wrong_forecast_is_overruled_at_the_margin(off_K):
    guarded, alone = run(off_K), run(off_K, enabled=False)
    assert alone.fallback_levels()["solved"] == len(alone.steps), "nothing looks wrong from inside"
    assert alone.fallback_levels()["guard"] == 0
    assert outside_K(alone).max() > 2.5
    assert guarded.kpis["tdis_tot"] < 0.7 * alone.kpis["tdis_tot"]
    overruled = [step for step in guarded.steps if step.plan.status is PlanStatus.GUARD]
    assert guarded.fallback_levels()["guard"] == len(overruled) > 0
    for step in overruled:
        applied = np.mean([sample.u_applied[0] for sample in step.samples])
        assert applied == pytest.approx(1.0 if off_K > 0 else 0.0)
        assert step.plan.why.startswith("guard: ")
        assert ("below" if off_K > 0 else "above") in step.plan.why


def test_a_right_forecast_is_never_overruled():
    assert run(0.0).fallback_levels()["guard"] == 0


def test_minimum_off_time_holds_and_the_overruled_plan_is_not_followed_later(monkeypatch):
    monkeypatch.setattr(GuardConfig, "margin_K", 0.5)
    house = SimpleHouse(T_start_C=17.0)
    house.reset(10 * 86400.0, 0.0)
    config = MPCConfig(step_s=None, horizon_h=24.0, **WRONG)
    mpc = ThermoForceMPC(simple_model(), config, free_response=shifted(12.0))
    seen = Observation(Record.beginning(house.measure()), house.forecast(86400.0, 3600.0))
    plan = mpc.plan(seen)
    assert plan.status is PlanStatus.GUARD
    assert plan.u[0, 0] < 0.5, "the plan itself stays readable"
    assert sum(block.duration_s for block in plan.blocks) == 3600.0
    assert plan.state.good is None


@pytest.mark.parametrize(("T_C", "acts"), [(26.0, True), (24.9, False)])
def test_cooling_is_guarded_the_other_way_round(T_C, acts):
    house = SimpleHouse(T_start_C=T_C)
    house.reset(10 * 86400.0, 0.0)
    seen = Observation(Record.beginning(house.measure()), house.forecast(86400.0, 3600.0))

    def guarded(planned: float) -> dict[int, Override]:
        guard = ComfortGuard(GuardConfig(), Layout.single("cooling"), [0.8])
        return guard.overrides(Situation(seen, Zones(()), (), {0: planned}))

    assert guarded(0.8) == {}, "fully used already"
    if not acts:
        assert guarded(0.0) == {}, "within 1 K of the band"
        return
    assert guarded(0.0)[0].level == 0.8
    assert "2.00 K above" in guarded(0.0)[0].why


def test_no_plan_from_before_the_guard_is_followed_after_it():
    house = SimpleHouse(T_start_C=21.5)
    house.reset(10 * 86400.0, 86400.0)
    config = MPCConfig(step_s=None, horizon_h=24.0, sensor={"enabled": False}, watch={"enabled": False}, **WRONG)
    warm = shifted(6.0)
    mpc = ThermoForceMPC(simple_model(), config, free_response=warm)
    seen = Observation(house.past(3600.0), house.forecast(86400.0, 3600.0))
    first = mpc.plan(seen)
    assert first.state.good is not None
    house.advance(0.0, 3600.0)
    history = house.past(3600.0)
    T_C = history.T_zone_C.copy()
    T_C[0, -1] = 17.0
    later = Observation(replace(history, T_zone_C=T_C), house.forecast(86400.0, 3600.0))
    guarded = mpc.plan(later, first.state)
    assert guarded.status is PlanStatus.GUARD
    assert guarded.state.good is None
