"""Choices between off and on: held levels, exclusion and a shared machine, against trying every choice."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from controllers.optimisation.solvers.held_levels import held_level
from mpc_problems import (
    N,
    machinery_of,
    random_building,
    random_building_problem,
    random_operator,
    random_problem,
)

from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver, plan_shape
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import ProblemShape, every_step
from controllers.optimisation.solvers.ipopt import IpoptSolver
from controllers.optimisation.solvers.milp import Highs, MilpConfig, MilpSolver
from controllers.optimisation.solvers.qp import QPSolver
from controllers.optimisation.solvers.qp_backends import QPConfig
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

HEAT = MachineLoad((1100.0, 30.0, 9000.0, 100.0), (-15.0, 20.0), lowest_level=0.3)
EXACT = MilpConfig(gap=0.0)


def machine(rng: np.random.Generator, order: int = 2) -> BuildingOperator:
    return single(replace(random_operator(rng, order), heat_input=HeatInput(heat=HEAT)))


def solver(operator: BuildingOperator, held_steps: int | None = 2, n_steps: int = N, choose=None) -> MilpSolver:
    shape = ProblemShape(every_step(n_steps), EquipmentLayout.one(lowest_level=0.3), held_steps=held_steps)
    return MilpSolver(operator, shape, EXACT, choose=choose)


def test_the_first_level_is_one_the_machine_can_hold():
    rng = np.random.default_rng(0)
    operator = machine(rng)
    milp = solver(operator)
    problems = [random_problem(rng, 2, lowest=0.3, curvature=1e-6) for _ in range(15)]
    warmer = [replace(p, T_free_C=p.T_free_C + shift) for p, shift in zip(problems, np.linspace(0, 9, 15), strict=True)]
    seen = [milp.solve(problem).u[0, 0] for problem in warmer]
    assert all(u == 0.0 or 0.3 <= u <= 1.0 for u in seen)
    assert len(set(seen)) > 1


def test_later_steps_are_relaxed_and_reported_as_the_held_level_of_the_same_heat():
    rng = np.random.default_rng(5)
    operator, problem = machine(rng), random_problem(rng, 2, lowest=0.3, curvature=1e-6)
    problem = replace(problem, T_free_C=problem.T_free_C + 5.0)
    results, highs = [], Highs(EXACT)

    def choose(*given):
        results.append(highs(*given))
        return results[-1]

    milp = solver(operator, held_steps=2, choose=choose)
    solution = milp.solve(problem)
    share = milp.model.levels(results[0].x)
    planned_K = milp.model.evaluate(problem, milp.model.numbers(problem), share).forced_K
    np.testing.assert_allclose(numpy_problem.forced_K(problem, operator, solution.u), planned_K, atol=1e-9)
    np.testing.assert_allclose(solution.u[:, :2], share[:, :2])
    assert np.abs(solution.u[:, 2:] - share[:, 2:]).max() > 0.01, "part load gives another heat than a share"


def test_exclusion_later_is_in_time():
    rng = np.random.default_rng(6)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1), exclusive=((0, 1),))
    problem = random_building_problem(rng, operator, machinery)
    solution = MilpSolver(operator, ProblemShape(every_step(N), machinery, held_steps=4), EXACT).solve(problem)
    assert solution.ok, solution.problem
    assert ((solution.u[:, :4] > 1e-6).sum(axis=0) <= 1).all()
    assert solution.u.sum(axis=0).max() <= 1.0 + 1e-6
    both = QPSolver(
        operator, ProblemShape(every_step(N), replace(machinery, exclusive=())), QPConfig()
    ).solve(replace(problem, machinery=replace(machinery, exclusive=())))  # fmt: skip
    assert both.u.sum(axis=0).max() > 1.2
    model = PlanModel(operator, ProblemShape(every_step(N), machinery, held_steps=4))
    assert "act together" in model.evaluate(problem, model.numbers(problem), both.u).broken


@pytest.mark.parametrize("share", [0.0, 0.1, 0.35, 0.8, 1.0])
def test_a_held_level_brings_the_heat_of_the_share(share):
    T_out = np.array([-5.0, 3.0, 12.0])
    level = held_level(HeatInput(heat=HEAT), np.full(3, share), T_out, 1.0)
    np.testing.assert_allclose(HEAT(level, T_out), share * HEAT(np.ones(3), T_out), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(held_level(IDENTITY, np.full(3, share), T_out, 1.0), np.full(3, share))
    at_most = held_level(HeatInput(heat=HEAT), np.full(3, 0.8 * share), T_out, 0.8)
    np.testing.assert_allclose(HEAT(at_most, T_out), share * HEAT(np.full(3, 0.8), T_out), rtol=1e-12, atol=1e-9)


def test_heat_that_does_not_grow_with_the_level_is_had_at_the_lowest():
    flat = MachineLoad((9000.0, 100.0, 0.0, 0.0), (-15.0, 20.0), lowest_level=0.3)
    T_out = np.array([-5.0, 3.0])
    level = held_level(HeatInput(heat=flat), np.array([1.0, 0.5]), T_out, 1.0)
    np.testing.assert_allclose(flat(level, T_out), np.array([1.0, 0.5]) * flat(np.ones(2), T_out))


def test_the_solver_prints_nothing():
    """Its version was printed into the output of commands, by the first solver of a process."""
    code = "from controllers.optimisation.solvers.milp import silent_highs; silent_highs().run()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == done.stderr == ""


def test_numbers_that_are_not_finite_are_a_failed_solve():
    rng = np.random.default_rng(3)
    problem = replace(random_problem(rng, 2, lowest=0.3), T_free_C=np.full((1, N), np.nan))
    solution = solver(machine(rng)).solve(problem)
    assert (solution.ok, solution.u.size) == (False, 0)


def test_a_solver_that_raises_is_a_failed_solve():
    def crash(*given):
        raise MemoryError("out of memory")

    rng = np.random.default_rng(4)
    milp = solver(machine(rng), choose=crash)
    assert "raised MemoryError: out of memory" in milp.solve(random_problem(rng, 2, lowest=0.3)).problem


def test_a_gap_that_is_left_is_reported():
    rng = np.random.default_rng(4)
    operator, problem = machine(rng), random_problem(rng, 2, lowest=0.3)
    highs = Highs(EXACT)

    def halfway(programme, choices, start):
        result = highs(programme, choices, start)
        return replace(result, status="Time limit reached", bound=0.5 * (programme.linear @ result.x))

    solution = solver(operator, choose=halfway).solve(problem)
    assert solution.ok, solution.problem
    assert solution.gap == pytest.approx(0.5, rel=0.2)
    assert solution.status.startswith("highs:Time limit reached, gap 0.")


def test_it_starts_from_the_relaxation_rounded_within_lowest_levels_and_exclusion():
    rng = np.random.default_rng(9)
    operator = random_building(rng, 2, (1, 1, 1))
    machinery = machinery_of(operator, (0, 1, 2), lowest_level=np.array([0.3, 1.0, 0.4]), exclusive=((0, 1),))
    highs, starts = Highs(EXACT), []

    def seen(programme, choices, start):
        starts.append(start[choices].reshape(6, 3).T)
        return highs(programme, choices, start)

    milp = MilpSolver(operator, ProblemShape(every_step(N), machinery, held_steps=6), EXACT, choose=seen)
    for _ in range(5):
        assert milp.solve(random_building_problem(rng, operator, machinery)).ok
    on = np.array(starts)
    assert set(np.unique(on)) == {0.0, 1.0}
    assert on[:, :2].sum(axis=1).max() == 1.0
    assert (on[:, 0].max(), on[:, 1].max(), on[:, 2].max()) == (1.0, 1.0, 1.0)


def test_auto_chooses_it_for_levels_that_are_held():
    rng = np.random.default_rng(8)
    config, operator = MPCConfig(step_s=3600.0, horizon_h=12.0), machine(rng)
    built = build_solver(config, operator, plan_shape(config, operator, EquipmentLayout.one(lowest_level=0.3)))
    assert isinstance(built, MilpSolver)
    assert built.model.structure.n_chosen == 1
    linear = single(random_operator(rng, 2))
    shape = plan_shape(config, linear, EquipmentLayout.one())
    assert isinstance(build_solver(config, linear, shape), IpoptSolver)
    three = random_building(rng, 3, (1, 1, 1))
    shape = ProblemShape(every_step(N), machinery_of(three, (0, 1, 2)))
    assert isinstance(build_solver(config, three, shape), QPSolver)
    with pytest.raises(ControllerConfigError, match=r"known for a lowest level of 0\.3, not 0\.5"):
        build_solver(config, operator, plan_shape(config, operator, EquipmentLayout.one(lowest_level=0.5)))
