"""A plant whose forecasts end early or have holes: plans go on, marked, and say what stands in."""

from __future__ import annotations

import functools
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from faults import FaultyHouse
from simple_house import POLE, OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation, PlanStatus
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop

FROM_H, TO_H = 20, 26


def half_blind(changed, from_h: float = FROM_H) -> FaultyHouse:
    """A house with `changed(forecast)` to hour 26 of the run."""
    return FaultyHouse(says=lambda house, given: changed(given) if from_h <= house.hours < TO_H else given)


def without(*names: str, at=slice(None)):
    def changed(given: Boundary) -> Boundary:
        values = {name: getattr(given, name).copy() for name in names}
        for value in values.values():
            value[..., at] = np.nan
        return replace(given, **values)

    return changed


def run(house: SimpleHouse) -> RunResult:
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    return run_closed_loop(house, mpc, replace(house.period("x"), scored_s=1.5 * DAY_S))


@functools.cache
def healthy_run() -> RunResult:
    return run(SimpleHouse())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (without("T_out_C", "solar_W_m2"), "forecast: T_out_C at 25 of 25 instants by the last forecast (1 h old)"),
        (without("T_out_C", at=slice(3, 6)), "forecast: T_out_C at 3 of 25 instants by interpolation"),
        (without("price_per_kWh", "heating_price_per_kWh"), "price_per_kWh at 25 of 25 instants by the last forecast"),
        (without("lower_C", "upper_C"), "lower_C at 25 of 25 instants by the last forecast"),
        (lambda given: given.head(3), "T_out_C at 21 of 25 instants by "),
        (lambda given: given.head(0), "T_out_C at 24 of 25 instants by "),
    ],
    ids=["weather", "hole", "prices", "bounds", "3 h", "now only"],
)
def test_plans_go_on_with_what_was_known_before(changed, says):
    healthy, result = healthy_run(), run(half_blind(changed))
    status = [step.plan.status for step in result.steps]
    assert status[FROM_H:TO_H] == [PlanStatus.BRIDGED] * (TO_H - FROM_H)
    assert set(status[:FROM_H] + status[TO_H:]) == {PlanStatus.SOLVED}
    assert says in result.steps[FROM_H].plan.why
    assert result.kpis["tdis_tot"] < healthy.kpis["tdis_tot"] + 0.1
    assert result.kpis["cost_tot"] == pytest.approx(healthy.kpis["cost_tot"], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["price_per_kWh", "lower_C", "T_out_C"])
def test_what_was_never_known_is_not_invented(name):
    names = (name, "upper_C") if name == "lower_C" else (name, "heating_price_per_kWh")[: 1 + name.startswith("price")]
    result = run(half_blind(without(*names), from_h=-1.0))
    status = [step.plan.status for step in result.steps]
    # The weather of the record is known, prices and bounds are not: a rule acts, on safe set-points without bounds.
    expected = PlanStatus.BRIDGED if name == "T_out_C" else PlanStatus.THERMOSTAT
    assert set(status[:TO_H]) == {expected}
    assert set(status[TO_H:]) == {PlanStatus.SOLVED}
    if name == "lower_C":
        assert "against 20.00 °C (no bounds)" in result.steps[0].plan.why
        assert min(step.T_zone_C[0] for step in result.steps[:TO_H]) > 19.0


def test_the_plans_of_a_run_without_holes_are_not_touched():
    assert {step.plan.status for step in run(half_blind(lambda given: given)).steps} == {PlanStatus.SOLVED}


def test_the_margin_is_wider_exactly_where_the_weather_is_guessed():
    """Plans of one instant: with all of the weather, and with that of its first ten hours."""
    from_h, house = 10, SimpleHouse()
    house.reset(10 * DAY_S, 4 * DAY_S)
    past, ahead = house.past(HOUR_S), house.forecast(DAY_S, HOUR_S)
    # Days that are warmer and colder by 2 K in turns, so that the day before is so far off.
    past = replace(past, T_out_C=past.T_out_C + np.where(past.time_s // DAY_S % 2, 1.0, -1.0))
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    plan = mpc.plan(Observation(past, ahead))
    cut = mpc.plan(Observation(past, without("T_out_C", at=slice(from_h, None))(ahead)))
    assert "T_out_C at 15 of 25 instants by the day before (60 % of the plan)" in cut.why
    assert "weather that nobody gave: it may move a zone by" in cut.why
    assert "nobody gave" not in plan.why
    band, wider = (one.T_free_high_C[0] - one.T_free_low_C[0] for one in (plan, cut))
    np.testing.assert_array_equal(wider[:from_h], band[:from_h])
    moved_K = 2.0 * (1.0 - POLE ** np.arange(1, 25 - from_h))  # what 2 K outdoors do to the house
    z = NormalDist().inv_cdf(0.9)
    np.testing.assert_allclose(wider[from_h:] / 2, np.hypot(band[from_h:] / 2, z * moved_K), rtol=1e-6)
    # So is the margin inside the upper bound; heat makes up for the lower one as soon as more is known.
    kept, more = (ahead.upper_C[0, 1:] - one.upper_C[0] for one in (plan, cut))
    np.testing.assert_array_equal(more[:from_h], kept[:from_h])
    assert (more[from_h:] > kept[from_h:] + 0.001).all()
    np.testing.assert_array_equal(cut.lower_C, plan.lower_C)
