"""The reserve that is learned from readings beyond a bound, and what days with room to spare give back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from faults import FaultyHouse
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.controller import MPCState
from controllers.mpc.margins import OF_LOOPS, LearnedMargin, Margins, learned_K, of_plans
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel

ALLOWED_K = 0.0135
OF_PLANS = of_plans(ALLOWED_K)
MOST_K = OF_PLANS.most_K


def learned(beyond_K: float, spare: bool = True, before_K: float = 0.1) -> float:
    return float(learned_K(np.array(before_K), np.array(beyond_K), np.array(spare), 900.0, OF_PLANS))


def test_it_grows_where_readings_are_beyond_the_bound():
    assert learned(0.2) > 0.1
    assert learned(0.4) > learned(0.2), "by more where more is missed"
    assert learned(ALLOWED_K) == pytest.approx(0.1), "what a plan may expect is no miss"
    assert learned(-1.0) == learned(-0.1) == 0.1, "a step inside says nothing, a day does"


def after_days(
    inside_K: float | list[float], days: int = 1, planned_K: float = 0.3, spare: bool = True, least_K: float = 0.0
) -> float:
    """What is learned of the lower bound after days of quarter hours with readings so far inside, from 0."""
    readings = np.resize(np.array(inside_K, dtype=np.float64), 96 * days)
    state = LearnedMargin.nothing(1)
    for step, reading_K in enumerate(readings):
        distance_K, had = np.array([[reading_K], [np.nan]]), np.array([[spare], [False]])
        # A plan keeps what it keeps beforehand and what was learned.
        whole_K = np.maximum(planned_K + state.reserve_K, least_K)
        state = state.after_reading(distance_K, had, whole_K, whole_K - least_K, 900.0 * step)
    assert state.reserve_K[1, 0] == 0.0, "nothing is known of the other bound"
    return float(state.reserve_K[0, 0])


def test_half_of_what_a_day_had_to_spare_is_given_back():
    assert after_days([0.4, 0.2, 0.3], 2) == pytest.approx(-0.1)
    assert after_days([0.4, -0.01, 0.3], 2) == 0.0, "it was missed once"
    assert after_days(0.2, 2, spare=False) == 0.0, "the machine was fully used"
    assert after_days([float("nan"), 0.2], 2) == pytest.approx(-0.1)
    assert after_days(0.2, 1) == 0.0, "not before a day is over"


def test_no_more_is_given_back_than_is_kept():
    assert after_days(0.3, 30) == pytest.approx(-0.3, abs=1e-3)
    assert after_days(0.15, 30, planned_K=0.02) == pytest.approx(-0.02, abs=1e-6)
    assert after_days(0.3, 30, least_K=0.2) == pytest.approx(-0.1, abs=1e-6)


def test_a_zone_that_sun_keeps_away_from_its_bound_says_nothing_of_margins():
    assert after_days(2.0, 5) == 0.0


def test_a_miss_is_made_up_for_at_once_whatever_was_given_back():
    assert learned(0.2, before_K=-0.2) > -0.2
    assert learned(-1.0, before_K=-0.2) == -0.2


def coarse_model() -> ThermalModel:
    """A house whose sensor reads in steps of 0.5 K."""
    zone = simple_model().only
    return ThermalModel.of_zone(replace(zone, card=replace(zone.card, uncertainty={"sensor_resolution_K": 0.5})))


def before_a_plan(
    model: ThermalModel | None = None, **options: Any
) -> tuple[ThermoForceMPC, Observation, PredictionContext]:
    """A controller, what it observes, and what it predicts from that."""
    config = MPCConfig(step_s=None, horizon_h=24.0, **options)
    mpc = ThermoForceMPC(model or simple_model(), config, free_response=OutdoorResponse())
    house = SimpleHouse()
    house.reset(10 * DAY_S, 24 * HOUR_S)
    seen = Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S))
    return mpc, seen, mpc.predictor.context(seen)


def test_margins_in_all_are_never_less_than_nothing():
    mpc, seen, context = before_a_plan()
    given = replace(LearnedMargin.nothing(1), reserve_K=np.array([[-5.0], [0.0]]))
    problem = mpc.instance(context, seen.history, Margins(learned=given))
    np.testing.assert_array_equal(problem.lower_C, context.boundary.lower_C[:, 1:])


def test_half_a_step_of_the_sensor_is_kept_inside_the_bound_that_is_protected():
    given = Margins(learned=replace(LearnedMargin.nothing(1), reserve_K=np.array([[-5.0], [-5.0]])))
    for reserve, kept_K in ((True, 0.25), (False, 0.0)):
        mpc, seen, context = before_a_plan(coarse_model(), corrections=reserve)
        problem = mpc.instance(context, seen.history, given)
        np.testing.assert_allclose(problem.lower_C, context.boundary.lower_C[:, 1:] + kept_K)
        np.testing.assert_array_equal(problem.upper_C, context.boundary.upper_C[:, 1:])


def test_nothing_is_learned_where_there_was_no_more_to_give_or_no_reading():
    assert learned(0.2, spare=False) == 0.1
    assert learned(-0.2, spare=False) == 0.1
    assert learned(float("nan")) == 0.1


def test_it_stays_between_nothing_and_what_a_thermostat_keeps():
    assert learned(50.0, before_K=MOST_K) == MOST_K
    assert learned(-1.0, before_K=0.0) == 0.0
    K = 0.0
    for _ in range(96):
        K = learned(0.05 + ALLOWED_K, before_K=K)
    assert 0.1 < K <= MOST_K, "a day of 0.05 K too much"


def test_what_loops_miss_is_learned_faster_and_further():
    """Drops of 0.6 K in every sixth reading, as of a fan that pauses: after a day hardly any counts."""
    K = np.zeros(1)
    for step in range(96):
        beyond_K = (0.6 if step % 6 == 0 else 0.0) - K
        K = learned_K(K, beyond_K, np.ones(1, dtype=bool), 900.0, OF_LOOPS)
    assert 0.5 < K[0] < 0.6


def test_bounds_are_set_back_where_they_are_wider_than_at_their_tightest():
    """Also over a weekend in which they are never tight."""
    lower, upper = np.array([15.0, 15.0, 21.0, 20.8]), np.array([28.0, 24.0, 24.0, 24.2])
    weekday = LearnedMargin.nothing(1).meeting(lower[None], upper[None])
    assert weekday.set_back(0, lower, upper).tolist() == [[True, True, False, False], [True, False, False, False]]
    weekend = np.full((1, 4), 15.0), np.full((1, 4), 28.0)
    assert weekday.meeting(*weekend).set_back(0, weekend[0][0], weekend[1][0]).all()
    assert not LearnedMargin.nothing(1).meeting(*weekend).set_back(0, weekend[0][0], weekend[1][0]).any(), (
        "none was tighter"
    )


def test_bounds_that_are_not_known_are_not_met():
    unknown = np.array([[np.nan, 21.0]]), np.array([[np.nan, np.nan]])
    assert LearnedMargin.nothing(1).meeting(*unknown).tightest_C.tolist() == [[21.0], [np.inf]]


def test_a_reserve_for_loops_holds_where_bounds_are_set_back():
    lower, upper = np.array([15.0, 21.0]), np.array([28.0, 24.0])
    known = replace(LearnedMargin.nothing(1).meeting(lower[None], upper[None]), reserve_K=np.array([[0.4], [0.2]]))
    assert known.inside_K(0, lower, upper, by_loops=True).tolist() == [[0.4, 0.0], [0.2, 0.0]]
    assert known.inside_K(0, lower, upper, by_loops=False).tolist() == [[0.4, 0.4], [0.2, 0.2]]


def test_one_drop_that_loops_let_through_is_made_up_for_at_once():
    spare = np.ones(1, dtype=bool)
    quarter, hour = (learned_K(np.zeros(1), np.array([0.6]), spare, step_s, OF_LOOPS)[0] for step_s in (900.0, 3600.0))
    assert quarter == hour == pytest.approx(0.6, abs=0.002)


def second_plan(
    T_C: float, used: float, model: ThermalModel | None = None, near_K: float | None = None, **options: Any
) -> tuple[MPCState, Boundary, float]:
    """State of the plan after a first one, with the zone at `T_C` after a step at level `used`; what the first one
    expected there, °C.

    `near_K`: a day before the first one ends with the second, in which the zone was so near its lower bound.
    """
    config = MPCConfig(step_s=None, horizon_h=24.0, **options)
    mpc = ThermoForceMPC(model or simple_model(), config, free_response=OutdoorResponse())
    house = SimpleHouse()
    house.reset(10 * DAY_S, 24 * HOUR_S)
    first = mpc.plan(Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S)))
    assert isinstance(first.state, MPCState)
    state = first.state
    if near_K is not None:
        day = replace(LearnedMargin.nothing(1), nearest_K=np.array([[near_K], [np.inf]]), since_s=house.now_s - DAY_S)
        state = replace(state, margins=replace(state.margins, learned=day))
    house.advance(used, HOUR_S)
    history = house.past(HOUR_S)
    T = history.T_zone_C.copy()
    T[0, -1] = T_C
    boundary = house.forecast(mpc.horizon_s, HOUR_S)
    plan = mpc.plan(Observation(replace(history, T_zone_C=T), boundary), state)
    assert isinstance(plan.state, MPCState)
    return plan.state, boundary, float(first.T_zone_C[0, 0])


def test_a_plan_keeps_what_was_missed_inside_the_bound_that_it_protects():
    state, boundary, _ = second_plan(20.8, 0.3)
    expected = 0.25 * (boundary.lower_C[0, 0] - 20.8 - ALLOWED_K)
    assert state.margins.learned.reserve_K[:, 0].tolist() == pytest.approx([expected, 0.0])
    assert not second_plan(20.8, 1.0)[0].margins.learned.reserve_K.any(), "the machine had no more to give"
    assert not second_plan(24.5, 0.3)[0].margins.learned.reserve_K.any(), (
        "no actuator protects the upper bound of a heated house"
    )
    assert not second_plan(20.8, 0.3, corrections=False)[0].margins.learned.reserve_K.any()
    assert not second_plan(20.8, 0.3, backoff_level=0.5)[0].margins.learned.reserve_K.any()


@pytest.mark.parametrize(("above_K", "known_above_K"), [(0.1, 0.0), (-0.1, 0.0), (-0.4, -0.15), (0.4, 0.15)])
def test_within_a_step_of_the_sensor_the_zone_is_where_the_plan_expected_it(above_K, known_above_K):
    expected_C = second_plan(21.0, 0.3, coarse_model())[2]
    state, boundary, _ = second_plan(expected_C + above_K, 0.3, coarse_model())
    inside_K = expected_C + known_above_K - boundary.lower_C[0, 0]
    assert state.margins.learned.nearest_K[0, 0] == pytest.approx(inside_K)
    assert state.margins.offset_K[0] == pytest.approx(known_above_K * (1.0 - np.exp(-1.0 / 6.0)))


def test_half_a_step_of_the_sensor_is_never_given_back():
    """All that plans keep here, whatever a day had to spare."""
    expected_C = second_plan(21.0, 0.3, coarse_model())[2]
    state, _, _ = second_plan(expected_C, 0.3, coarse_model(), near_K=0.3)
    assert state.margins.learned.nearest_K[0, 0] == np.inf, "the day is over"
    assert state.margins.learned.reserve_K.tolist() == [[0.0], [0.0]]


def test_the_bounds_of_a_problem_move_inside_by_what_was_learned():
    mpc, seen, context = before_a_plan()
    plain, kept = (
        mpc.instance(context, seen.history, margins)
        for margins in (None, Margins(learned=replace(LearnedMargin.nothing(1), reserve_K=np.array([[0.2], [0.0]]))))
    )
    np.testing.assert_allclose(kept.lower_C - plain.lower_C, 0.2)
    np.testing.assert_array_equal(kept.upper_C, plain.upper_C)


def swings(house: FaultyHouse, hours: float) -> float:
    """A draught that comes and goes, K: every other hour, which no forecast sees."""
    return 0.25 if round(house.now_s / HOUR_S) % 2 else -0.25


@pytest.mark.slow
def test_a_swing_that_no_plan_sees_costs_less_comfort_once_it_was_seen():
    def discomfort_Kh(corrections: bool) -> float:
        config = MPCConfig(step_s=None, horizon_h=24.0, corrections=corrections)
        mpc = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
        house = FaultyHouse(moves=swings)
        period = replace(house.period("x"), scored_s=4 * DAY_S)
        return run_closed_loop(house, mpc, period).kpis["tdis_tot"]

    assert discomfort_Kh(True) < 0.7 * discomfort_Kh(False)
