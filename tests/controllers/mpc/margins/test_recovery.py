"""What a zone lacks at the instant at which a bound begins is learned for the next one, and for nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import two_model, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.actuation.actuator import Actuation, ActuationConfig
from controllers.actuation.actuators import Actuators
from controllers.mpc.margins import LearnedMargin, MarginRules, Margins
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import DAY_S, HOUR_S, Measurement, Observation
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel

NIGHT, DAY = (15.0, 30.0), (21.0, 24.0)


def after(T_C: float, before=NIGHT, now=DAY, known_K=(0.0, 0.0), spare=(True, True)) -> list[float]:
    """What is learned of the lower and the upper bound by a reading at bounds `now`, after those `before`."""
    more = np.array(spare)[:, None]
    lower, upper = (np.array([pair]) for pair in zip(before, now, strict=True))
    state = replace(LearnedMargin.nothing(1).meeting(lower, upper), recovery_K=np.array(known_K)[:, None])
    return state.after_setback(np.array([T_C]), lower[:, 1], upper[:, 1], more).recovery_K[:, 0].tolist()


def test_what_is_missing_where_a_bound_begins_is_added():
    assert after(20.6) == pytest.approx([0.4, 0.0])
    assert after(20.6, known_K=(0.3, 0.0)) == pytest.approx([0.7, 0.0])
    assert after(10.0) == [1.0, 0.0], "at most 1 K"


def test_where_there_was_no_more_to_give_nothing_is_added():
    assert after(20.6, known_K=(0.3, 0.0), spare=(False, True)) == [0.3, 0.0]
    assert after(24.5, known_K=(0.3, 0.2), spare=(True, False)) == pytest.approx([0.0, 0.2])
    assert after(21.2, known_K=(0.4, 0.0), spare=(False, False)) == pytest.approx([0.3, 0.0]), "spare is given back"


def test_half_of_what_was_to_spare_is_given_back():
    assert after(21.2, known_K=(0.4, 0.0)) == pytest.approx([0.3, 0.0])
    assert after(22.5, known_K=(0.4, 0.0)) == [0.0, 0.0], "never below nothing"
    assert after(21.0, known_K=(0.4, 0.0)) == pytest.approx([0.4, 0.0])
    assert after(20.95, known_K=(0.3, 0.0)) == pytest.approx([0.35, 0.0]), "little that is missing is no spare"


def test_cooling_is_learned_as_heating_is():
    assert after(24.5) == pytest.approx([0.0, 0.5])
    assert after(23.8, known_K=(0.0, 0.5)) == pytest.approx([0.0, 0.4])


@pytest.mark.parametrize(
    ("T_C", "before", "now"),
    [
        (20.6, DAY, DAY),
        (14.6, DAY, NIGHT),
        (20.6, (20.7, 24.0), DAY),
        (20.6, (np.nan, np.nan), DAY),
        (20.6, NIGHT, (np.nan, np.nan)),
        (np.nan, NIGHT, DAY),
    ],
    ids=["in the day", "at its end", "a small step", "unknown before", "unknown now", "no reading"],
)
def test_elsewhere_nothing_is_learned(T_C, before, now):
    assert after(T_C, before, now, known_K=(0.4, 0.3)) == [0.4, 0.3]


def test_each_zone_learns_for_itself():
    lower, upper = np.array([[15.0, 21.0], [15.0, 15.0]]), np.array([[30.0, 24.0], [30.0, 30.0]])
    state = LearnedMargin.nothing(2).meeting(lower, upper)
    learned = state.after_setback(np.array([20.5, 14.0]), lower[:, 1], upper[:, 1], np.ones((2, 2), dtype=bool))
    assert learned.recovery_K.tolist() == [[0.5, 0.0], [0.0, 0.0]]


def problem(margins: Margins | None, start_h: float = 0.0, model: ThermalModel | None = None, at_C: float = 21.0):
    """One of the next 24 h; the band of the simple house is wide from 7 to 20 h."""
    model = model or simple_model()
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    house = SimpleHouse(at_C)
    house.reset(10 * DAY_S + start_h * HOUR_S, DAY_S)
    seen = Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S))
    return mpc.instance(mpc.predictor.context(seen), seen.history, margins)


@pytest.mark.parametrize(("start_h", "begins_in_h"), [(0.0, 20), (19.0, 1), (20.0, 24)])
def test_it_is_kept_where_a_bound_begins_and_not_in_the_rest_of_the_day(start_h, begins_in_h):
    plain = problem(None, start_h)
    kept = problem(Margins(learned=replace(LearnedMargin.nothing(1), recovery_K=np.array([[0.4], [0.3]]))), start_h)
    expected = np.zeros(24)
    expected[begins_in_h - 1] = 1.0
    np.testing.assert_allclose(kept.lower_C[0] - plain.lower_C[0], 0.4 * expected, atol=1e-9)
    np.testing.assert_allclose(plain.upper_C[0] - kept.upper_C[0], 0.3 * expected, atol=1e-9)


def test_the_uncertainty_of_the_effect_is_kept_of_what_a_zone_has_to_come():
    model = simple_model()
    card = replace(model.only.card, competence=Competence(True, effect_K=5.0, effect_sd_K=0.5))
    plain, kept = problem(None, at_C=10.0), problem(None, model=replace(model, cards=(card,)), at_C=10.0)
    house = SimpleHouse(10.0)
    house.reset(10 * DAY_S, DAY_S)
    expected = np.zeros(24)
    expected[19] = 0.1 * (21.0 - house.T)
    assert 0.1 < expected[19] < 0.9
    np.testing.assert_allclose(kept.lower_C[0] - plain.lower_C[0], expected, atol=1e-9)
    np.testing.assert_array_equal(kept.upper_C, plain.upper_C)


def cooled_model() -> ThermalModel:
    zone = simple_model().only
    return ThermalModel.of_zone(replace(zone, operator=replace(zone.operator, gains=-zone.operator.gains, sign=-1)))


def test_of_a_zone_that_is_cooled_it_is_kept_below_the_upper_bound():
    model = cooled_model()
    card = replace(model.only.card, competence=Competence(True, effect_K=-5.0, effect_sd_K=0.5))
    plain, kept = (problem(None, model=one, at_C=33.0) for one in (model, replace(model, cards=(card,))))
    house = SimpleHouse(33.0)
    house.reset(10 * DAY_S, DAY_S)
    expected = np.zeros(24)
    expected[19] = 0.1 * (house.T - house.forecast(24 * HOUR_S, HOUR_S).upper_C[0, 20])
    assert 0.1 < expected[19] < 0.9
    np.testing.assert_allclose(plain.upper_C[0] - kept.upper_C[0], expected, atol=1e-9)
    np.testing.assert_array_equal(kept.lower_C, plain.lower_C)


def test_a_state_from_before_it_was_learned_is_planned_with():
    mpc = ThermoForceMPC(two_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    seen, now = two_observation(), LearnedMargin.nothing(2)
    old = LearnedMargin(now.reserve_K, now.tightest_C, now.nearest_K)
    context = mpc.predictor.context(seen)
    found, expected = (mpc.instance(context, seen.history, Margins(learned=of)) for of in (old, now))
    np.testing.assert_array_equal(found.lower_C, expected.lower_C)


def recovery_K(state: object) -> list[float]:
    assert isinstance(state, MPCState)
    return state.margins.learned.recovery_K[:, 0].tolist()


def evening(level: float) -> tuple[dict[int, list[float]], float]:
    """What is learned at each hour from 18 to 21 h with the machine at `level`, and what is missing at 20 h, K."""
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    house, state, found, missing_K = SimpleHouse(T_start_C=20.0), None, {}, 0.0
    house.reset(10 * DAY_S + 18 * HOUR_S, 0.0)
    for hour in (18, 19, 20, 21):
        plan = mpc.plan(Observation(house.past(HOUR_S), house.forecast(mpc.horizon_s, HOUR_S)), state)
        found[hour], state = recovery_K(plan.state), plan.state
        missing_K = 21.0 - house.T if hour == 20 else missing_K
        house.advance(level, HOUR_S)
    return found, missing_K


def test_a_controller_learns_it_at_the_step_that_ends_where_the_bound_begins():
    found, missing_K = evening(0.8)
    assert found[18] == found[19] == [0.0, 0.0]
    assert missing_K > 0.5
    assert found[21] == found[20] == pytest.approx([missing_K, 0.0])


@pytest.mark.parametrize(("at_C", "beyond"), [(20.0, lambda T: T < 20.9), (27.0, lambda T: T > 24.1)])
def test_a_reading_is_judged_by_the_bound_of_its_instant_not_by_that_which_begins_next(at_C, beyond):
    """At 18 and 19 h neither of the bounds of 20 h holds, whichever of them an actuator protects."""
    model = simple_model() if at_C < 22.0 else cooled_model()
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    house, state = SimpleHouse(T_start_C=at_C), None
    house.reset(10 * DAY_S + 18 * HOUR_S, 0.0)
    for _ in range(2):
        ahead = house.forecast(mpc.horizon_s, HOUR_S)
        assert beyond(house.T)
        assert ahead.lower_C[0, 0] < house.T < ahead.upper_C[0, 0]
        state = mpc.plan(Observation(house.past(HOUR_S), ahead), state).state
        house.advance(0.8, HOUR_S)
    assert isinstance(state, MPCState)
    np.testing.assert_array_equal(state.margins.learned.reserve_K, 0.0)


def test_after_hours_at_full_level_it_learns_nothing():
    found, missing_K = evening(1.0)
    assert missing_K > 0.3
    assert found[21] == found[20] == [0.0, 0.0]


@pytest.mark.parametrize(("full_h", "earlier"), [(7, True), (12, False)])
def test_a_machine_that_was_off_in_the_setback_could_have_begun_earlier(full_h, earlier):
    model = simple_model()
    rules = MarginRules(MPCConfig(), model, Actuators(model.layout, [Actuation(ActuationConfig())]))
    house = SimpleHouse()
    house.reset(10 * DAY_S, 0.0)
    for hour in range(12 + full_h):
        house.advance(float(hour >= 12), HOUR_S)
    assert rules.could_begin_earlier(house.past(HOUR_S))[0, 0] == earlier


def test_loops_that_cool_learn_as_those_that_heat():
    """Levels below 0 cool; the machine of a signed level was not at its most in either direction, or in one."""
    zone = simple_model().only
    both = replace(zone.operator, heat_input=HeatInput(u_min=-0.6))
    model = ThermalModel.of_zone(replace(zone, operator=both))
    rules = MarginRules(
        MPCConfig(), model, Actuators(model.layout, [Actuation(ActuationConfig(mode="room_setpoints"))])
    )

    def could(level: float) -> list[bool]:
        house = SimpleHouse()
        house.reset(10 * DAY_S, 0.0)
        house.advance(0.0, 6 * HOUR_S)
        record = house.past(HOUR_S)
        return rules.could_begin_earlier(replace(record, u=np.full_like(record.u, level)))[:, 0].tolist()

    assert could(-0.3) == [True, True]
    assert could(-0.6) == [True, False]


@pytest.mark.slow
def test_a_machine_that_is_weaker_than_its_model_is_late_the_first_evening_only():
    """Its meters say nothing of it, and plans count with what it gave in the model."""

    def without_meters(house: FaultyHouse, seen: Measurement) -> Measurement:
        return replace(seen, u=np.nan if house.asked is None else house.asked, power_W=np.nan, heat_W=np.nan)

    house = FaultyHouse(gives=lambda house, u: u and 0.85 * u, shows=without_meters)
    config = MPCConfig(step_s=None, horizon_h=24.0, watch={"enabled": False})
    mpc = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
    result = run_closed_loop(house, mpc, replace(house.period("x"), scored_s=6 * DAY_S))
    at = {step.time_s: float(step.T_zone_C[0]) for step in result.steps}
    evenings = [21.0 - at[result.period.start_s + day * DAY_S + 20 * HOUR_S] for day in range(6)]
    assert evenings[0] > 0.1
    assert max(evenings[2:]) < 0.5 * evenings[0]
