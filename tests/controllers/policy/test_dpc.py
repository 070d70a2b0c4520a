"""A policy trained through the operator in the place of the solver: what it learns, and what keeps it in bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from later import Later, torch
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from controllers.policy.config import DPCConfig
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.settings import validate

pytestmark = pytest.mark.slow


dpc = Later("controllers.policy.dpc")


def built(model: ThermalModel | None = None, **policy: int) -> Any:
    config = DPCConfig(step_s=None, horizon_h=24.0, policy={"instances": 128, "epochs": 50} | policy)
    return dpc.DPC(model or simple_model(), config, free_response=OutdoorResponse())


@pytest.fixture(scope="module")
def trained() -> Any:
    return built()


def excess(policy: Any) -> np.ndarray:
    """What its answers to unseen instances cost above the optimum, as shares of full level's cost."""
    solver, found = policy.solver, []
    best = QPSolver(solver.model.operator, solver.model.shape, QPConfig())
    for problem in policy.drawn(20, np.random.default_rng(7)):
        optimum, answer = best.solve(problem), solver.solve(problem)
        p = best.model.numbers(problem)
        off, full = (best.model.evaluate(p, np.full((1, problem.n_steps), level)) for level in (0.0, 1.0))
        cost = min(off.cost, full.cost) if not answer.ok else answer.cost
        found.append((cost - optimum.cost) / (abs(full.energy_cost).sum() + 1e-9))
    return np.array(found)


def test_unseen_instances_cost_little_more_than_their_optimum(trained):
    learned, random = excess(trained), excess(built(instances=64, epochs=1))
    assert learned.min() > -1e-5
    assert np.median(learned) < 0.1
    assert np.median(learned) < 0.5 * np.median(random)


def test_the_same_seed_gives_the_same_policy(trained):
    (problem,) = trained.drawn(1, np.random.default_rng(3))
    again, other = built(instances=64, epochs=1, seed=4), built(instances=64, epochs=1, seed=4)
    np.testing.assert_array_equal(again.solver.solve(problem).u, other.solver.solve(problem).u)
    random = torch.random.get_rng_state()
    built(instances=64, epochs=1)
    torch.testing.assert_close(torch.random.get_rng_state(), random)


def test_whatever_its_weights_levels_keep_their_bounds_and_what_is_not_finite_falls_back(trained):
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    seen = Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))
    policy = built(instances=64, epochs=1)
    for scale in (1e-3, 30.0, 1e6):
        with torch.no_grad():
            for weights in policy.policy.parameters():
                weights.copy_(scale * torch.randn(weights.shape, generator=torch.Generator().manual_seed(1)))
        for problem in policy.drawn(5, np.random.default_rng(1)):
            answer = policy.solver.solve(problem)
            assert not answer.ok or not problem.unfit(answer.u)
    with torch.no_grad():
        for weights in policy.policy.parameters():
            weights.fill_(np.nan)
    plan = policy.plan(seen)
    assert plan.status not in (PlanStatus.SOLVED, PlanStatus.ACCEPTABLE)
    assert "not finite" in plan.why
    assert trained.plan(seen).status is PlanStatus.ACCEPTABLE


def test_a_gate_that_is_closed_keeps_it_away():
    condemned = Competence(False, reasons=("it errs",), effect_K=7.0, effect_sd_K=5.0)
    card = replace(simple_model().only.card, competence=condemned)
    model = ThermalModel.of_zone(replace(simple_model().only, card=card))
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    plan = built(model, instances=64, epochs=1).plan(
        Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))
    )
    assert plan.status is PlanStatus.GATE


def test_it_keeps_a_house_comfortable(trained):
    house = SimpleHouse()
    run = run_closed_loop(house, trained, replace(house.period("x"), scored_s=86400.0))
    assert run.kpis["tdis_tot"] < 2.0
    assert {step.plan.solver_status for step in run.steps} == {"policy"}


def test_the_gradient_is_that_of_the_cost(trained):
    rng, model = np.random.default_rng(2), trained.solver.model
    assert isinstance(model, PlanModel)
    (problem,) = trained.drawn(1, rng)
    p, u = model.numbers(problem), rng.uniform(0.2, 0.8, (1, problem.n_steps))
    cost, slopes = model.slopes(p, u)
    assert cost == pytest.approx(model.evaluate(p, u).cost)
    for k in model.shape.first_steps[[0, 3, -1]]:
        moved = u.copy()
        moved[0, k] += 1e-7
        assert (model.slopes(p, moved)[0] - cost) / 1e-7 == pytest.approx(slopes[0, k], rel=1e-3, abs=1e-4)


def test_what_a_policy_is_not_trained_through_is_refused():
    zone = simple_model().only
    pair = replace(zone.operator, output_weight=np.full(zone.operator.output_weight.shape, 0.01), feedback=True)
    pair = replace(pair, hidden_weight=np.full(pair.hidden_weight.shape, 0.01))
    with pytest.raises(ControllerConfigError, match=r"not trained; identify it with .*feedback: false"):
        built(ThermalModel.of_zone(replace(zone, operator=pair)))


def test_a_solver_that_a_policy_would_not_use_is_refused():
    with pytest.raises(ConfigError, match="solver: dpc plans by its policy, with no solver"):
        validate(DPCConfig, {"solver": "ipopt"}, "options")
    assert validate(DPCConfig, {"solver": "auto"}, "options").solver == "auto"
