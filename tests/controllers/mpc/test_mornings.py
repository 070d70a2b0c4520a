"""Each morning a day is compared with what was believed of it and with the on/off rule's by the same model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from controllers.mpc.courses import DayBelieved, MorningState
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation, PlanStatus

N = 24
MORNING_S = 10 * DAY_S + 6 * HOUR_S
# 14.5 and 6.7 K·h above the bounds; about what the rule has (12.9 and 1.6 K·h).
WASTEFUL, WISE = np.ones(24), np.full(24, 0.45)


def controller(**watch: bool) -> ThermoForceMPC:
    config = MPCConfig(step_s=None, horizon_h=float(N), watch=watch)
    return ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())


def after(mpc: ThermoForceMPC, levels: Array, state: MorningState, believed: tuple[float, float]) -> MorningState:
    """The state after a day under `levels` of which cost and K·h were `believed`."""
    house = SimpleHouse(20.5)
    house.reset(MORNING_S, 0.0)
    state = replace(state, believed=DayBelieved(house.forecast(DAY_S, HOUR_S), *believed))
    for level in levels:
        house.step(float(level), HOUR_S)
    record = house.past(HOUR_S)
    return mpc.mornings.validate(state, record, mpc.predictor.forced_history(record))


def test_two_days_running_that_were_dearer_and_colder_than_the_rules_stand_back_for_a_day():
    mpc, now = controller(), MORNING_S + DAY_S
    first = after(mpc, WASTEFUL, MorningState(), (12.0, 0.0))
    assert "the last day cost" in first.news
    assert "where 12 and 0.0 were believed" in first.news
    assert "the on/off rule would have had" in first.news
    assert first.stands_back(now) == ""
    second = after(mpc, WASTEFUL, first, (12.0, 0.0))
    assert "control stands back for 24 h" in second.stands_back(now)
    assert second.stands_back(now + DAY_S) == ""
    third = after(mpc, WASTEFUL, second, (12.0, 0.0))
    assert "control stands back for 48 h" in third.news, "one more is enough after a return, for twice as long"
    assert after(mpc, WISE, first, (12.0, 0.0)).failed == 0


@pytest.mark.parametrize(
    ("levels", "believed"),
    [
        (WISE, (12.0, 0.0)),
        (np.zeros(24), (0.0, 0.0)),
        (np.r_[np.ones(14), np.zeros(10)], (12.0, 0.0)),
        (WASTEFUL, (14.5, 6.6)),
    ],
    ids=["no worse", "cheaper and colder", "dearer and more comfortable", "as believed"],
)
def test_nothing_is_said_of_other_days(levels, believed):
    assert after(controller(), levels, MorningState(), believed).news == ""


def test_a_day_is_not_judged_without_all_of_its_readings():
    mpc, house = controller(), SimpleHouse()
    house.reset(MORNING_S, 0.0)
    state = MorningState(DayBelieved(house.forecast(DAY_S, HOUR_S), 0.0, 0.0))
    for _ in range(24):
        house.step(1.0, HOUR_S)
    record = house.past(HOUR_S)
    forced_K = mpc.predictor.forced_history(record)
    gap = replace(record, u=np.where(np.arange(24) == 3, np.nan, record.u))
    for found in (mpc.mornings.validate(state, gap, forced_K), mpc.mornings.validate(state, record, None)):
        assert found.news == ""
        assert found.believed is None


def test_plans_stand_back_say_why_and_return():
    mpc, house = controller(), SimpleHouse()
    house.reset(MORNING_S, 2 * DAY_S)

    def seen() -> Observation:
        return Observation(house.past(HOUR_S), house.forecast(DAY_S, HOUR_S))

    plan = mpc.plan(seen())
    assert plan.state.mornings.believed.time_s == MORNING_S
    assert plan.state.mornings.believed.K_h == pytest.approx(0.0, abs=0.1)
    why = "the last day cost too much"
    state = replace(plan.state, mornings=MorningState(until_s=MORNING_S + DAY_S, why=why))
    held = mpc.plan(seen(), state)
    assert held.status is PlanStatus.WATCH
    assert held.blocks[0].u == (None,)
    assert held.why == f"watch: {why}: native control"
    assert held.state.mornings.believed is None
    over = replace(plan.state, mornings=MorningState(until_s=MORNING_S, why=why))
    assert mpc.plan(seen(), over).status is PlanStatus.SOLVED
    off = controller(mornings=False).plan(seen())
    assert off.state.mornings.believed is None
