"""Power caps and prices of peaks hold on blocks: what is metered, not only what is planned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import FIXED_W, PER_U_W, OutdoorResponse, SimpleHouse, simple_model
from two_houses import TwoHouses, two_model, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.actuation.actuator import ActuationState
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation, PlanStatus
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.machine.other_load import OtherLoad

FULL_W = FIXED_W + PER_U_W
BLOCKS = {"mode": "duty", "block_s": 900.0, "min_on_s": 1800.0, "min_off_s": 1800.0}


def mpc(model=None, **objective) -> ThermoForceMPC:
    config = MPCConfig(step_s=None, horizon_h=24.0, objective=objective, actuation=BLOCKS)
    return ThermoForceMPC(model or simple_model(), config, free_response=OutdoorResponse())


def alone() -> Observation:
    """Two days of one house under native control, and the forecast."""
    house = SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    return Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))


def metered_W(result) -> np.ndarray:
    """Mean power of all machines over each step."""
    return np.array([sum(s.power_W.sum() * s.duration_s for s in step.samples) / HOUR_S for step in result.steps])


@pytest.mark.slow
def test_metered_power_is_below_the_cap_and_the_house_stays_warm():
    house = SimpleHouse()
    result = run_closed_loop(house, mpc(power_cap_kW=2.8, power_cap_price_per_kWh=100.0), house.period("x"))
    assert metered_W(result).max() == pytest.approx(0.5 * FULL_W), "two of four blocks"
    assert result.kpis["tdis_tot"] < 0.1


@pytest.mark.slow
def test_blocks_keep_to_the_peak_that_was_planned():
    house = SimpleHouse()
    result = run_closed_loop(house, mpc(peak_price_per_kW=1.0), house.period("x"))
    assert metered_W(result).max() == pytest.approx(0.75 * FULL_W), "three of four blocks; four without a price"
    assert result.kpis["tdis_tot"] < 0.05


@pytest.mark.slow
def test_machines_together_are_below_the_cap():
    houses = TwoHouses(lower_K=1.0)
    capped = mpc(two_model(), power_cap_kW=6.0, power_cap_price_per_kWh=100.0)
    metered = metered_W(run_closed_loop(houses, capped, SimpleHouse().period("x")))
    assert 4000.0 < metered.max() <= 6000.0, "each alone takes 4.3 kW"


def limits_W(model, seen, cap_kW: float) -> np.ndarray:
    """The cap as a plan has it (N,)."""
    capped = mpc(model, power_cap_kW=cap_kW)
    return capped.instance(capped.predictor.context(seen), seen.history).power_cap.limit_W


def test_a_plan_counts_with_the_blocks_that_a_step_can_hold_under_the_cap():
    one, two, kW = alone(), two_observation(), FULL_W / 1000.0
    np.testing.assert_allclose(limits_W(simple_model(), one, 0.65 * kW), 0.5 * FULL_W)
    np.testing.assert_allclose(limits_W(simple_model(), one, 0.2 * kW), 0.0, err_msg="half a minimum time takes more")
    np.testing.assert_allclose(limits_W(simple_model(), one, 1.2 * kW), 1.2 * FULL_W)
    np.testing.assert_allclose(limits_W(two_model(), two, 0.65 * kW), (0.65 - 0.125) * FULL_W, err_msg="half a block")


def test_what_else_is_on_the_meter_leaves_less_of_a_cap_and_of_a_peak():
    seen, model = alone(), simple_model()
    other = OtherLoad((500.0,) * 24, 0.0, 5.0, (-20.0, 30.0), 0.0)
    beside = replace(model, power=(replace(model.power[0], foreign=other),))
    kW = FULL_W / 1000.0
    np.testing.assert_allclose(limits_W(beside, seen, 1.2 * kW + 0.5), limits_W(model, seen, 1.2 * kW))
    peaks = mpc(beside, peak_price_per_kW=1.0)
    instance = peaks.instance(peaks.predictor.context(seen), seen.history, peak_W=2000.0)
    assert instance.peak_so_far_W == pytest.approx(1500.0)


def test_another_load_that_has_ended_is_said_and_counted_with_no_more():
    other = OtherLoad((500.0,) * 24, 0.0, 5.0, (-20.0, 30.0), 0.0)
    model = simple_model()
    (power,), (card,) = model.power, model.cards
    beside = replace(model, power=(replace(power, foreign=other),), cards=(replace(card, foreign_heat=other),))
    house = alone()

    def off(ended_h: int) -> Observation:
        """The machine was off for two days; its meters held the load until so many hours ago."""
        held_W = np.where(np.arange(house.history.n_steps, 0, -1) > ended_h, 500.0, 0.0)[None]
        levels = np.zeros_like(house.history.u)
        return replace(house, history=replace(house.history, u=levels, power_W=held_W, heat_W=held_W.copy()))

    peaks = mpc(beside, peak_price_per_kW=1.0)
    both = ["power of machine", "heat of actuator"]
    for ended_h, others, others_W in ((4, [], 500.0), (5, both, 0.0), (6, [], 0.0)):
        seen = off(ended_h)
        news = peaks.plan(seen).news.split("; ")
        told = [text.partition(": the meter lacks the other load of 500 W") for text in news]
        assert [where for where, found, _ in told if found] == others
        instance = peaks.instance(peaks.predictor.context(seen), seen.history, peak_W=2000.0)
        assert instance.peak_so_far_W == pytest.approx(2000.0 - others_W)
        # The machine is on in the last step, which tells nothing.
        u, heat_W = seen.history.u.copy(), seen.history.heat_W.copy()
        u[0, -1], heat_W[0, -1] = 1.0, 3000.0
        own = beside.own_heat(replace(seen.history, u=u, heat_W=heat_W))
        assert own.heat_W[0, -1] == (2500.0 if ended_h < 6 else 3000.0)


def test_what_takes_the_place_of_a_plan_is_not_held_to_the_cap():
    seen = two_observation(houses=TwoHouses(lower_K=1.0))
    condemned = Competence(False, reasons=("it errs",), effect_K=7.0, effect_sd_K=5.0)
    free, capped = (
        mpc(two_model((None, condemned)), **objective).plan(seen)
        for objective in ({}, {"power_cap_kW": 0.1, "power_cap_price_per_kWh": 1e4})
    )
    for plan in (free, capped):
        assert plan.acting == (PlanStatus.SOLVED, PlanStatus.GATE)
        assert {block.u[1] for block in plan.blocks} == {None}
    assert max(block.u[0] for block in free.blocks) == 1.0
    assert max(block.u[0] for block in capped.blocks) == 0.0


def test_why_says_what_takes_a_step_above_the_cap():
    first = mpc().plan(alone())
    begun = replace(first.state, actuation=(ActuationState(on=True, held_s=900.0),))
    seen = alone()
    plan = mpc(power_cap_kW=0.5, power_cap_price_per_kWh=1e4).plan(seen, replace(begun, last_s=seen.time_s - HOUR_S))
    assert [block.u for block in plan.blocks] == [(1.0,), (0.0,)]
    assert plan.why.startswith("this step takes 1.07 kW where 0.50 kW are planned at most: minimum on time of actuator")
