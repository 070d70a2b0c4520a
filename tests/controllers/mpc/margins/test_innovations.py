"""What plans miss one step ahead and what of it lasts; levels beyond the limit of a machine without a heat meter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import FIXED_W, PER_U_W, OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.margins import Innovations, share_beyond_limit
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import DAY_S, HOUR_S, Measurement, Observation, Period
from thermoforce_mpc.loop.closed_loop import run_closed_loop


class QuickHouse(SimpleHouse):
    """The air follows a level at once, which the model of the simple house does not know."""

    quick_K = 0.3

    def period(self, name: str) -> Period:
        return Period(name, start_s=10 * DAY_S, scored_s=4 * DAY_S, warmup_s=2 * DAY_S)

    def measure(self, u: float = np.nan) -> Measurement:
        power_W = FIXED_W * (u > 0) + PER_U_W * u if np.isfinite(u) else np.nan
        T_C = self.T + self.quick_K * (u if np.isfinite(u) else 0.0)
        return Measurement(self.now_s, T_C, 3.0, 0.0, u, power_W, 2.5 * power_W)


def controller() -> ThermoForceMPC:
    config = MPCConfig(step_s=None, horizon_h=24.0, actuation={"mode": "modulating", "lowest_level": 0.0})
    return ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())


@pytest.mark.slow
def test_levels_do_not_swing_where_a_first_step_gives_more_than_the_model_says():
    house = QuickHouse()
    result = run_closed_loop(house, controller(), house.period("x"))
    nights = [s for s in result.samples if s.start_s >= 12 * DAY_S and (s.start_s % DAY_S) / HOUR_S < 6]
    u = np.array([s.u_applied[0] for s in nights], dtype=np.float64).reshape(-1, 6)
    assert np.abs(np.diff(u, axis=1)).mean() < 0.1, "a level that is needed all night is held"


def passing_K(error_of_change: float, noise_K: float, n: int = 60, seed: int = 0) -> float:
    """What passes of a last error of 0.2 K after a change worth 0.4 K, where errors so far were a share of changes."""
    rng, state = np.random.default_rng(seed), Innovations.nothing(1)
    for _ in range(n):
        change_K = rng.normal(0.0, 0.3, 1)
        state = state.after(error_of_change * change_K + rng.normal(0.0, noise_K, 1), change_K, 900.0)
    return float(state.after(np.array([0.2]), np.array([0.4]), 900.0).passing_K[0])


def test_an_error_lasts_unless_errors_went_with_changes_of_level():
    assert passing_K(0.5, 0.02) == pytest.approx(0.14, abs=0.01)
    assert passing_K(1.0, 0.02) == 0.2, "no more passes than there is"
    assert passing_K(-0.5, 0.02) == 0.0, "a first step that gives less makes nothing swing"
    assert not any(passing_K(0.0, 0.1, seed=seed) for seed in range(20)), "errors of their own last"
    state = Innovations.nothing(1)
    assert state.after(np.array([np.nan]), np.array([0.4]), 900.0).count.tolist() == [0.0]
    assert state.after(np.array([0.2]), np.array([np.nan]), 900.0).count.tolist() == [0.0]


def test_a_change_of_a_fifth_of_a_kelvin_counts_half_of_a_large_one():
    """Starts, whose first step gives half more, among small changes, which give what the model says."""
    state = Innovations.nothing(1)
    for k in range(200):
        change_K = np.array([2.0 if k % 2 else 0.2])
        state = state.after(0.5 * change_K * (k % 2), change_K, 900.0)
    large = 4.0 / (4.0 + 0.2**2)
    assert state.first_step[0][0] == pytest.approx(0.5 * large / (large + 0.5), rel=0.05)


def beyond(u: float = 1.0, power_W: float = 5000.0, behind_K: float = 0.3, before: float = 0.0) -> float:
    return share_beyond_limit(before, u, power_W, 7000.0, behind_K, 900.0)


def test_a_level_beyond_the_limit_needs_both_power_and_heat_that_are_missing():
    assert beyond() == pytest.approx(0.5 * 2 / 7)
    assert beyond(before=beyond()) > beyond()
    assert beyond(behind_K=0.0) == 0.0, "less power alone may be a machine that got better"
    assert beyond(power_W=6900.0) == 0.0, "less heat alone may be an open window"
    assert beyond(u=0.5, power_W=2000.0) == 0.0, "at half level it is no limit"
    assert beyond(power_W=float("nan"), before=0.2) == 0.2
    assert 0.19 < beyond(power_W=6900.0, before=0.2) < 0.2, "taken back slowly where power is there again"


@pytest.mark.parametrize(("metered", "most"), [(False, 0.6), (True, 1.0)])
def test_plans_do_not_count_with_levels_that_give_nothing(metered, most):
    zone = simple_model().only
    if metered:
        law = replace(zone.power.load, coefficients=(0.0, 0.0, 9000.0, 0.0))
        heat_input = replace(zone.operator.heat_input, metered=law)
        zone = replace(zone, operator=replace(zone.operator, heat_input=heat_input))
    config = MPCConfig(step_s=None, horizon_h=24.0, actuation={"mode": "modulating", "lowest_level": 0.0})
    mpc = ThermoForceMPC(type(simple_model()).of_zone(zone), config, free_response=OutdoorResponse())
    house = SimpleHouse(T_start_C=16.0)
    house.reset(10 * DAY_S, 24 * HOUR_S)
    observation = Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S))
    first = mpc.plan(observation).state
    assert isinstance(first, MPCState)
    limited = replace(first, margins=replace(first.margins, unused=np.array([0.4])), good=None)
    plan = mpc.plan(observation, limited)
    assert float(plan.u.max()) == pytest.approx(most, abs=1e-4)
    assert plan.blocks[0].u == (1.0,), "where a plan wants all, all is asked for"


@pytest.mark.parametrize(("share", "unused"), [(1.0, 0.0), (0.7, 0.15)])
def test_a_machine_that_ends_below_its_level_is_seen_in_the_step_in_which_it_does(share, unused):
    options = {"step_s": None, "horizon_h": 24.0, "actuation": {"mode": "modulating", "lowest_level": 0.0}}
    mpc = ThermoForceMPC(simple_model(), MPCConfig(**options), free_response=OutdoorResponse())
    house = SimpleHouse(T_start_C=14.0)
    house.reset(10 * DAY_S, 2 * HOUR_S)
    plan = mpc.plan(Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S)))
    assert plan.u[0, 0] == pytest.approx(1.0, abs=1e-3)
    house.advance(1.0, HOUR_S)
    record = house.past(HOUR_S)
    power_W, T_zone_C = record.power_W.copy(), record.T_zone_C.copy()
    power_W[0, -1] *= share
    T_zone_C[0, -1] -= 0.3 if share < 1.0 else 0.0
    seen = Observation(replace(record, power_W=power_W, T_zone_C=T_zone_C), house.forecast(mpc.horizon_s, HOUR_S))
    after = mpc.plan(seen, plan.state).state
    assert isinstance(after, MPCState)
    assert after.margins.unused == pytest.approx([unused], abs=1e-6)
