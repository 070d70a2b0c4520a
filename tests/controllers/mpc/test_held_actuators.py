"""Actuators that an override holds enter the problem at their expected levels, and the others plan with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import TWO, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.optimisation.candidate_search import CandidateSearch, SearchConfig
from controllers.optimisation.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.milp import MilpConfig, MilpSolver
from controllers.optimisation.problem import ProblemShape, every_step
from controllers.optimisation.qp import QPSolver
from controllers.optimisation.qp_backends import QPConfig
from controllers.safety.overrides import Override, expected_levels
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation, Plan, PlanStatus
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel

CONDEMNED = Competence(False, (), ("it is wrong",))


@pytest.mark.parametrize("solver", ["qp", "milp", "ipopt", "search"])
def test_every_solver_leaves_actuators_that_are_not_planned_at_zero_and_plans_for_them_again(solver):
    rng = np.random.default_rng(3)
    operator = random_building(rng, 2, (1, 1, 1))
    machinery = machinery_of(operator, (0, 1, 1), share=np.array([0.0, 0.6, 0.6]))
    problem = random_building_problem(rng, operator, machinery)
    shape = ProblemShape(every_step(N), machinery)
    solve = {
        "qp": lambda: QPSolver(operator, shape, QPConfig()),
        "milp": lambda: MilpSolver(operator, shape, MilpConfig()),
        "ipopt": lambda: IpoptSolver(operator, shape, IpoptConfig()),
        "search": lambda: CandidateSearch(operator, N, SearchConfig()),
    }[solver]().solve
    free = solve(problem)
    held = solve(replace(problem, planned=np.array([True, False, True])))
    again = solve(problem)
    assert all(solution.ok for solution in (free, held, again))
    assert free.u[1].max() > 0.1
    np.testing.assert_allclose(held.u[1], 0.0, atol=1e-6)
    np.testing.assert_allclose(again.u, free.u, atol=1e-5)
    if solver != "search":
        reference = QPSolver(operator, shape, QPConfig()).solve(replace(problem, planned=np.array([True, False, True])))
        cost = float(problem.cost(operator, held.u))
        assert cost == pytest.approx(float(problem.cost(operator, reference.u)), rel=1e-5)


def test_levels_expected_of_what_acts_instead_are_those_of_the_last_day():
    house = SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    for level in [1.0] * 24 + [0.25] * 24:
        house.advance(level, HOUR_S)
    history = house.past(HOUR_S)
    native = expected_levels({0: Override(None, PlanStatus.GATE, "")}, history, 3)
    np.testing.assert_allclose(native, [[0.25] * 3])
    rule = expected_levels({0: Override(1.0, PlanStatus.GATE, "")}, history, 3)
    np.testing.assert_allclose(rule, [[1.0, 0.25, 0.25]])
    assert np.isnan(expected_levels({}, history, 3)).all()
    unknown = replace(history, u=np.full_like(history.u, np.nan))
    np.testing.assert_array_equal(expected_levels({0: Override(None, PlanStatus.GATE, "")}, unknown, 2), [[0.0, 0.0]])


def coupled_model(across: float) -> ThermalModel:
    """Two zones, each heated by an actuator that gives the share `across` of its effect to the other zone."""
    zone = simple_model().only
    other = replace(zone.operator, gains=across * zone.operator.gains)
    pairs = ((zone.operator, other), (other, zone.operator))
    operator = BuildingOperator(TWO.zones, TWO.actuators, pairs, (0, 1))
    cards = (zone.card, replace(zone.card, competence=CONDEMNED))
    return ThermalModel(
        operator, (zone.power, zone.power), (zone.free, zone.free), cards, TWO.machines, (0, 1), (0.0, 0.0)
    )


@pytest.mark.parametrize("stand_back", ["native", "rule"])
def test_a_plan_counts_with_what_a_held_actuator_gives_to_its_neighbour(stand_back):
    model = coupled_model(0.5)
    config = MPCConfig(step_s=None, horizon_h=24.0, fallback={"stand_back": stand_back})
    controller = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    seen = two_observation()
    history, boundary = seen.history, seen.boundary

    def planned(level: float) -> Plan:
        levels = np.stack([history.u[0], np.full(history.n_steps, level)])
        return controller.plan(Observation(replace(history, u=levels), boundary))

    still, warm = planned(0.0), planned(0.8)
    for plan, level in ((still, 0.0), (warm, 0.8)):
        assert plan.acting == (PlanStatus.SOLVED, PlanStatus.GATE)
        np.testing.assert_allclose(plan.u[1, 1:], level, atol=1e-9)
        assert not plan.slack_K[1].any(), "what holds the actuator keeps its zone comfortable"
    assert warm.u[0].sum() < still.u[0].sum() - 1.0, "the neighbour heats along"
    np.testing.assert_allclose(warm.T_zone_C, warm.T_free_C + warm.T_forced_K)
    assert (warm.T_zone_C[0] >= boundary.lower_C[0, 1:]).all()
