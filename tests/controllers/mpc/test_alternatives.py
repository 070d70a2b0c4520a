"""Courses beside a plan: what the same model predicts, costs and brings under other levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import FIXED_W, GAIN_K, PER_U_W, POLE, SimpleHouse, simple_model
from two_houses import TwoHouses, two_model

from controllers import ThermoForceMPC
from controllers.mpc.alternatives import Alternatives, alternatives
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, Observation

N = 12


def controller(model, **more) -> ThermoForceMPC:
    options = {"step_s": 3600, "horizon_h": N, "gate": {"enabled": False}, "free_response": {"name": "linear_weather"}}
    return ThermoForceMPC(model, MPCConfig(**options, **more))


def observed(house) -> Observation:
    house.reset(10 * DAY_S, 2 * DAY_S)
    return Observation(house.past(3600), house.forecast(N * 3600, 3600))


def named(found: Alternatives) -> dict:
    return {course.name: course for course in found.courses}


@pytest.fixture(scope="module")
def single():
    mpc, seen = controller(simple_model()), observed(SimpleHouse())
    plan = mpc.plan(seen)
    return mpc, seen, plan, alternatives(mpc, seen, plan)


def test_none_is_much_cheaper_than_the_plan_of_those_that_keep_the_bounds(single):
    _, _, plan, found = single
    courses = named(found)
    assert found.courses[0].name == "plan"
    assert courses["plan"].T_zone_C == pytest.approx(plan.T_zone_C, abs=1e-9)
    comfortable = [course for course in found.courses if course.discomfort_Kh <= courses["plan"].discomfort_Kh + 0.05]
    # The loop holds the very bound, the plan a margin inside it.
    assert courses["plan"].parts["energy"] <= 1.05 * min(course.parts["energy"] for course in comfortable)
    assert courses["plan"].parts["energy"] < courses["thermostat rule"].parts["energy"]
    assert {"off", "full", "levels of the step before", "thermostat rule", "loops at the bounds"} < set(courses)


def test_the_parts_add_up_to_what_was_minimised_and_the_plan_has_the_least(single):
    _, _, _, found = single
    assert {"energy", "discomfort", "peak", "cap", "other"} == set(found.courses[0].parts)
    for course in found.courses:
        assert course.total == pytest.approx(sum(course.parts.values()))
    chosen, *others = found.courses
    assert chosen.total == pytest.approx(plan_cost(single), abs=1e-3)
    assert chosen.total <= min(course.total for course in others) + 1e-3
    assert found.reason.startswith("the least total; next is ")
    # What the comfort bounds alone do not say: margins inside them.
    loop = named(found)["loops at the bounds"]
    assert loop.parts["energy"] < chosen.parts["energy"]
    assert loop.parts["discomfort"] > chosen.parts["discomfort"]


def plan_cost(single) -> float:
    """What the plan was found to cost when it was made."""
    mpc, seen, plan, _ = single
    problem = mpc.instance(mpc.predictor.context(seen), seen.history)
    return mpc.evaluator.brings(problem, plan.u).cost


def test_a_course_that_totals_less_than_the_plan_is_told(single):
    mpc, seen, plan, _ = single
    worse = alternatives(mpc, seen, replace(plan, u=np.ones_like(plan.u)))
    assert worse.reason.startswith("not the least total: ")
    assert "energy costs" in worse.reason


def test_courses_are_the_models_own_answer(single):
    _, seen, _, found = single
    courses = named(found)
    off, full = courses["off"], courses["full"]
    assert (off.parts["energy"], off.energy_kWh) == (0.0, 0.0)
    assert full.energy_kWh == pytest.approx(N * (FIXED_W + PER_U_W) / 1000.0)
    assert full.parts["energy"] == pytest.approx(
        float(seen.boundary.price_per_kWh[0, :N].sum()) * (FIXED_W + PER_U_W) / 1000.0
    )
    k = np.arange(1, N + 1)
    assert full.T_zone_C[0] - off.T_zone_C[0] == pytest.approx(GAIN_K * (1 - POLE**k) / (1 - POLE), abs=0.02)
    below = np.maximum(seen.boundary.lower_C[0, 1:] - off.T_zone_C[0], 0).sum()
    above = np.maximum(off.T_zone_C[0] - seen.boundary.upper_C[0, 1:], 0).sum()
    assert off.discomfort_Kh == pytest.approx(below + above)


def test_off_is_what_happens_with_everything_off(single):
    house = SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    came = [house.advance(0.0, 3600.0).T_zone_C[0] for _ in range(N)]
    assert named(single[3])["off"].T_zone_C[0] == pytest.approx(came, abs=0.1)


def test_rule_and_loop_see_what_they_did(single):
    mpc, seen, _, found = single
    rule, loop = named(found)["thermostat rule"], named(found)["loops at the bounds"]
    before_C = np.concatenate([seen.T_zone_C, rule.T_zone_C[0, :-1]])
    pairs = zip(before_C, seen.boundary.time_s[:-1], strict=True)
    wanted = [mpc.rules[0].rule_at(float(T), seen.boundary, float(t)) for T, t in pairs]
    assert rule.u[0].tolist() == [level for level, _ in wanted]
    inside = loop.T_zone_C[0] >= seen.boundary.lower_C[0, 1:] - 1e-6
    assert (inside | (loop.u[0] == 1.0)).all(), "below the bound only at full level"
    assert 0.0 < loop.u[0].mean() < rule.u[0].max()


def test_without_a_plan_the_free_response_is_the_controllers_own(single):
    mpc, seen, plan, _ = single
    found = alternatives(mpc, seen, None)
    assert "plan" not in named(found)
    assert any("nothing was planned" in note for note in found.notes)
    assert named(found)["off"].T_zone_C == pytest.approx(plan.T_free_C + _left(mpc, seen), abs=0.2)


def _left(mpc, seen) -> np.ndarray:
    """What the levels of the past leave behind with everything off from now on."""
    context = mpc.predictor.context(seen)
    return context.predict(np.zeros((1, N))).forced_K


def test_a_model_other_than_that_of_the_plan_is_said_and_gives_differences_only(single):
    mpc, seen, plan, _ = single
    other = replace(plan, T_forced_K=plan.T_forced_K + 1.0)
    found = alternatives(mpc, seen, other)
    assert any("1.0 K from the one that planned" in note for note in found.notes)
    assert named(found)["plan"].T_zone_C == pytest.approx(plan.T_zone_C + 1.0)


def test_several_zones():
    mpc, seen = controller(two_model()), observed(TwoHouses())
    plan = mpc.plan(seen)
    found = alternatives(mpc, seen, plan)
    courses = named(found)
    assert courses["plan"].T_zone_C == pytest.approx(plan.T_zone_C, abs=1e-9)
    assert courses["full"].u.tolist() == np.ones((2, N)).tolist()
    for name, course in courses.items():
        assert course.u.shape == course.T_zone_C.shape == (2, N), name
    assert courses["off"].parts["energy"] == 0.0 < courses["plan"].parts["energy"] < courses["full"].parts["energy"]
    # The level of the second house is not measured.
    assert any("step before are not known" in note for note in found.notes)


def test_what_a_machine_has_is_asked_of_it_in_every_step(monkeypatch):
    mpc, seen = controller(replace(two_model(shared=True), shares=(0.6, 0.6))), observed(TwoHouses(shared=True))
    inner, falling = ThermoForceMPC.instance, np.linspace(1.0, 0.7, N)[None]
    monkeypatch.setattr(ThermoForceMPC, "instance", lambda *given: replace(inner(*given), capacity=falling))
    courses = named(alternatives(mpc, seen, None))
    assert 0.6 * courses["full"].u.sum(axis=0) == pytest.approx(falling[0])
    cold = replace(seen, history=replace(seen.history, T_zone_C=seen.history.T_zone_C - 8.0))
    courses = named(alternatives(mpc, cold, None))
    for name in ("thermostat rule", "loops at the bounds"):
        asked = 0.6 * courses[name].u.sum(axis=0)
        assert asked.max() > 0.7, "else this tries nothing"
        assert (asked <= falling[0] + 1e-9).all(), name


def test_courses_of_a_shared_machine_stay_within_its_capacity():
    model = two_model(shared=True)
    mpc, seen = controller(model), observed(TwoHouses(shared=True))
    context = mpc.predictor.context(seen)
    whole = mpc.instance(context, seen.history)
    for capacity, level in ((1.0, 1.0), (0.6, 0.6), (2.0, 1.0)):
        problem = replace(whole, capacity=np.full((1, N), capacity))
        courses = mpc.courses(mpc.planning_operator, problem, context.boundary, seen.T_zone_C)
        np.testing.assert_allclose(courses.limited(np.ones((2, N))), np.full((2, N), level))
