"""Plans of buildings under a limit on their summed power: held by those who can, with room for those who cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import SimpleHouse, simple_model

from controllers import MPCConfig
from controllers.coordination import SharedPower
from controllers.coordination.planning import plan_shared
from controllers.many.portfolio import plan_many
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.card import Competence

CONFIG = MPCConfig(step_s=None, horizon_h=24.0, free_response={"name": "linear_weather"})
FUSE_kW = 6.0


def seen(T_start_C: float) -> Observation:
    house = SimpleHouse(T_start_C)
    house.reset(10 * 86400.0, 6 * 86400.0)
    return Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))


@pytest.fixture(scope="module")
def observations() -> dict[str, Observation]:
    return {f"house {i}": seen(19.0 + 0.4 * i) for i in range(4)}


def _fuses(observations) -> dict[str, float]:
    return dict.fromkeys(observations, FUSE_kW)


def _kW(plans) -> np.ndarray:
    return np.sum([one.plan.power_W.sum(axis=0) for one in plans], axis=0) / 1000.0


def test_plans_keep_the_limit_that_those_made_alone_exceed(observations):
    models = {name: simple_model() for name in observations}
    alone = plan_many(models, observations, config=CONFIG)
    limit_kW = np.full(24, 0.7 * _kW(alone.values()).max())
    found = plan_shared(models, observations, SharedPower(limit_kW), _fuses(observations), config=CONFIG)
    assert (_kW(found.plans.values()) <= limit_kW + 1e-6).all()
    assert {one.plan.status for one in found.plans.values()} == {PlanStatus.SOLVED}
    assert found.joint is not None
    assert found.joint.cost == pytest.approx(sum(s.cost for s in found.joint.solutions.values()))
    # A limit that nobody feels changes nothing.
    wide = plan_shared(models, observations, SharedPower(np.full(24, 100.0)), _fuses(observations), config=CONFIG)
    for name, one in alone.items():
        np.testing.assert_allclose(wide.plans[name].plan.u, one.plan.u, atol=2e-3)
        assert wide.plans[name].expires_s == one.expires_s


def test_what_is_wrong_with_one_costs_the_others_its_fuse_and_no_more(observations):
    models = {name: simple_model() for name in observations}
    card = replace(models["house 0"].only.card, competence=Competence(False, reasons=("it was warm",)))
    models["house 0"] = replace(models["house 0"], cards=(card,))
    del models["house 1"]
    free_kW = _kW(plan_many(models, {n: observations[n] for n in ("house 2", "house 3")}, config=CONFIG).values())
    limit_kW = np.full(24, 2 * FUSE_kW + 0.8 * free_kW.max())
    found = plan_shared(models, observations, SharedPower(limit_kW), _fuses(observations), config=CONFIG)
    assert found.plans["house 0"].plan.status is PlanStatus.GATE
    assert "no model of building 'house 1'" in found.plans["house 1"].reason
    ours = [found.plans[name] for name in ("house 2", "house 3")]
    assert {one.plan.status for one in ours} == {PlanStatus.SOLVED}
    assert (_kW(ours) <= limit_kW - 2 * FUSE_kW + 1e-6).all()


def test_a_limit_that_those_who_take_no_part_may_exceed_is_said(observations):
    models = {name: simple_model() for name in observations if name != "house 0"}
    shared = SharedPower(np.full(24, FUSE_kW - 1.0))
    found = plan_shared(models, observations, shared, _fuses(observations), config=CONFIG)
    assert found.why_over == "the 1 buildings that take no part may draw 6 kW, more than the limit of 5 kW"


def test_a_state_goes_on_from_a_shared_plan(observations):
    models = {name: simple_model() for name in observations}
    shared = SharedPower(np.full(24, np.inf), peak_price_per_kW=5.0)
    found = plan_shared(models, observations, shared, _fuses(observations), config=CONFIG)
    states = {name: one.state for name, one in found.plans.items()}
    again = plan_shared(models, observations, shared, _fuses(observations), states, config=CONFIG)
    assert {one.plan.status for one in again.plans.values()} == {PlanStatus.SOLVED}


def test_a_building_without_a_largest_power_is_refused(observations):
    models = {name: simple_model() for name in observations}
    with pytest.raises(DataError, match="building 'house 3'"):
        plan_shared(models, observations, SharedPower(np.full(24, 9.0)), {f"house {i}": 1.0 for i in range(3)})
    with pytest.raises(DataError, match="building 'not planned'"):
        plan_shared(models, observations, SharedPower(np.full(24, 9.0)), _fuses(observations) | {"not planned": -50.0})
