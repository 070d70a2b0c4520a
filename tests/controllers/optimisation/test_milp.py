"""Choices between actuators that exclude one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem, random_operator

from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver, plan_shape
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import EquipmentLayout, MPCProblem, ProblemShape, every_step
from controllers.optimisation.solvers.ipopt import IpoptSolver
from controllers.optimisation.solvers.milp import Highs, MilpConfig, MilpSolver
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.heat_input import HeatInput

HEAT = MachineLoad((1100.0, 30.0, 9000.0, 100.0), (-15.0, 20.0), lowest_level=0.3)
EXACT = MilpConfig(gap=0.0)


def either(rng: np.random.Generator) -> tuple[BuildingOperator, MPCProblem]:
    """Two zones, of which one is heated at a time."""
    operator = random_building(rng, 2, (1, 1))
    return operator, random_building_problem(rng, operator, machinery_of(operator, (0, 1), exclusive=((0, 1),)))


def solver(operator: BuildingOperator, problem: MPCProblem, choose=None) -> MilpSolver:
    return MilpSolver(operator, ProblemShape(every_step(N), problem.machinery), EXACT, choose=choose)


def test_exclusion_later_is_in_time():
    rng = np.random.default_rng(6)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1), exclusive=((0, 1),))
    problem = random_building_problem(rng, operator, machinery)
    later_K = np.where(np.arange(N) < 6, 0.0, 6.0)  # both are wanted later
    problem = replace(problem, lower_C=problem.lower_C + later_K, upper_C=problem.upper_C + later_K)
    solution = MilpSolver(operator, ProblemShape(every_step(N), machinery, chosen_steps=4), EXACT).solve(problem)
    assert solution.ok, solution.problem
    assert ((solution.u[:, :4] > 1e-6).sum(axis=0) <= 1).all()
    assert solution.u.sum(axis=0).max() <= 1.0 + 1e-6
    both = QPSolver(
        operator, ProblemShape(every_step(N), replace(machinery, exclusive=())), QPConfig()
    ).solve(replace(problem, machinery=replace(machinery, exclusive=())))  # fmt: skip
    assert both.u[:, 4:].sum(axis=0).max() > 1.2
    model = PlanModel(operator, ProblemShape(every_step(N), machinery, chosen_steps=4))
    assert "act together" in model.evaluate(model.numbers(problem), both.u).broken


def test_the_solver_prints_nothing(capfd):
    operator, problem = either(np.random.default_rng(3))
    assert solver(operator, problem).solve(problem).ok
    assert "".join(capfd.readouterr()) == ""


def test_numbers_that_are_not_finite_are_a_failed_solve():
    operator, problem = either(np.random.default_rng(3))
    solution = solver(operator, problem).solve(replace(problem, T_free_C=np.full((2, N), np.nan)))
    assert (solution.ok, solution.u.size) == (False, 0)


def test_a_solver_that_raises_is_a_failed_solve():
    def crash(*given):
        raise MemoryError("out of memory")

    operator, problem = either(np.random.default_rng(4))
    assert "raised MemoryError: out of memory" in solver(operator, problem, crash).solve(problem).problem


def test_a_gap_that_is_left_is_reported():
    operator, problem = either(np.random.default_rng(4))
    highs = Highs(EXACT)

    def halfway(programme, choices, start):
        result = highs(programme, choices, start)
        total = programme.constant + programme.unit * (programme.linear @ result.x)
        return replace(result, status="Time limit reached", bound=(0.5 * total - programme.constant) / programme.unit)

    solution = solver(operator, problem, halfway).solve(problem)
    assert solution.ok, solution.problem
    assert solution.gap == pytest.approx(0.5)
    assert solution.status == "highs:Time limit reached, gap 0.5"


def test_it_starts_from_the_relaxation_rounded_within_exclusion():
    rng = np.random.default_rng(9)
    operator = random_building(rng, 2, (1, 1, 1))
    machinery = machinery_of(operator, (0, 1, 2), lowest_level=np.array([0.3, 1.0, 0.4]), exclusive=((0, 1),))
    highs, starts = Highs(EXACT), []

    def seen(programme, choices, start):
        starts.append(start[choices].reshape(6, 2).T)
        return highs(programme, choices, start)

    milp = MilpSolver(operator, ProblemShape(every_step(N), machinery, chosen_steps=6), EXACT, choose=seen)
    for _ in range(5):
        assert milp.solve(random_building_problem(rng, operator, machinery)).ok
    on = np.array(starts)
    assert set(np.unique(on)) == {0.0, 1.0}
    assert on.sum(axis=1).max() == 1.0
    assert (on[:, 0].max(), on[:, 1].max()) == (1.0, 1.0)


def test_auto_chooses_it_for_actuators_that_exclude_one_another_and_logs_what_it_chose(caplog):
    caplog.set_level("INFO", "controllers")
    rng = np.random.default_rng(8)
    config, (operator, problem) = MPCConfig(step_s=3600.0, horizon_h=12.0), either(rng)
    built = build_solver(config, operator, plan_shape(config, operator, problem.machinery))
    assert isinstance(built, MilpSolver)
    assert built.model.structure.n_chosen == 1
    stepped = single(replace(random_operator(rng, 2), heat_input=HeatInput(heat=HEAT)))
    shape = plan_shape(config, stepped, EquipmentLayout.one(lowest_level=0.3))
    assert isinstance(build_solver(config, stepped, shape), IpoptSolver)
    three = random_building(rng, 3, (1, 1, 1))
    shape = ProblemShape(every_step(N), machinery_of(three, (0, 1, 2), lowest_level=np.array([0.3, 1.0, 0.4])))
    assert isinstance(build_solver(config, three, shape), QPSolver)
    assert caplog.messages == [
        "solver milp, by auto for 2 zone(s) with choices between levels",
        "solver ipopt, by auto for 1 zone(s) without choices between levels",
        "solver qp, by auto for 3 zone(s) without choices between levels",
    ]
    with pytest.raises(ControllerConfigError, match=r"known for a lowest level of 0\.3, not 0\.5"):
        build_solver(config, stepped, plan_shape(config, stepped, EquipmentLayout.one(lowest_level=0.5)))
