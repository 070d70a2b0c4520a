"""Actuators that an override holds enter the problem at their expected levels, and the others plan with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem
from simple_house import OutdoorResponse, simple_model
from two_houses import TWO, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.held_actuators import expected_levels
from controllers.optimisation.candidate_search import CandidateSearch, SearchConfig
from controllers.optimisation.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.milp import MilpConfig, MilpSolver
from controllers.optimisation.problem import ProblemShape, every_step
from controllers.optimisation.qp import QPSolver
from controllers.optimisation.qp_backends import QPConfig
from controllers.safety.overrides import Override
from thermoforce_mpc.data import Plan, PlanStatus
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


def test_what_holds_an_actuator_is_expected_to_keep_its_zone_at_the_bound():
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1))
    problem = random_building_problem(rng, operator, machinery, T_free_C=np.full((2, N), 19.0))
    others = np.stack([np.full(N, 0.3), np.full(N, 0.9)])
    for level in (None, 1.0):
        u = expected_levels(operator, problem, {1: Override(level, PlanStatus.GATE, "")}, others)
        assert not u[0].any()
        assert ((u >= 0.0) & (u <= 1.0)).all()
        if level is not None:
            assert u[1, 0] == level
        T_C = problem.T_free_C + problem.forced_K(operator, np.stack([others[0], u[1]]))
        inside = (u[1] > 1e-9) & (u[1] < 1.0 - 1e-9)
        assert inside.sum() > 3
        np.testing.assert_allclose(T_C[1, inside], problem.lower_C[1, inside])
        assert (T_C[1, u[1] == 0.0] >= problem.lower_C[1, u[1] == 0.0] - 1e-9).all()


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
    def planned(across: float) -> Plan:
        config = MPCConfig(step_s=None, horizon_h=24.0, fallback={"stand_back": stand_back})
        controller = ThermoForceMPC(coupled_model(across), config, free_response=OutdoorResponse())
        return controller.plan(two_observation())

    alone, warmed = planned(0.0), planned(0.4)
    for plan in (alone, warmed):
        assert plan.acting == (PlanStatus.SOLVED, PlanStatus.GATE)
        assert plan.u[1].max() > 0.5, "what is expected of the held one is part of the plan"
        np.testing.assert_allclose(plan.T_zone_C, plan.T_free_C + plan.T_forced_K)
    assert warmed.u[0].sum() < alone.u[0].sum() - 1.0, "its neighbour heats less"
