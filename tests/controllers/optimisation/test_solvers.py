"""Ipopt on problems whose optimum is known another way."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import numpy_problem
import pytest
from mpc_problems import N, linear_programme_optimum, multi_start_optimum, random_operator, random_problem
from structures import CASES, instance

from controllers.optimisation.problem import MPCProblem, ProblemShape, every_step
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.qp import Piqp, SolverResult
from thermoforce_mpc.model.operator.building import single


@pytest.mark.parametrize("order", [1, 3])
def test_ipopt_finds_the_optimum_of_the_linear_programme(order):
    rng = np.random.default_rng(order)
    operator = single(random_operator(rng, order))
    solver = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    for _ in range(5):
        problem = random_problem(rng, order)
        solution = solver.solve(problem)
        assert solution.ok, solution.problem
        best = linear_programme_optimum(problem, operator)
        assert float(numpy_problem.cost(problem, operator, solution.u)) == pytest.approx(best, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(
    ("level", "share", "at"),
    [(0.25, 0.5, 0.5), (0.5, 1.0, 0.5), (0.75, 1.0, 0.75)],
    ids=["switched", "at the lowest level", "held"],
)
def test_the_numpy_objective_counts_the_fixed_part_while_on(level, share, at):
    rng = np.random.default_rng(0)
    problem = random_problem(rng, 1, lowest=0.5)
    problem = replace(problem, power_per_u2_W=4.5 * problem.power_fixed_W)
    u = np.full((1, N), level)
    power_W = share * (problem.power_fixed_W + at * problem.power_per_u_W + at**2 * problem.power_per_u2_W)
    np.testing.assert_allclose(numpy_problem.power_W(problem, u), power_W)
    expected = (problem.price_per_kWh * power_W / 1000).sum()
    operator = single(random_operator(rng, 1))
    slack = numpy_problem.slack_K(problem, problem.T_free_C + numpy_problem.forced_K(problem, operator, u))
    assert float(numpy_problem.cost(problem, operator, u)) == pytest.approx(expected + 5.0 * slack.sum())


def test_a_fixed_part_that_is_not_worth_a_higher_level_counts_in_proportion_to_it():
    """Power per heat falls above the lowest level, where only a curve would say how far: it counts as at that level."""
    problem = random_problem(np.random.default_rng(0), 1, lowest=0.5)
    at_lowest_W = problem.power_fixed_W + 0.5 * problem.power_per_u_W
    np.testing.assert_allclose(numpy_problem.power_W(problem, np.full((1, N), 0.75)), 1.5 * at_lowest_W)
    bent = replace(problem, power_per_u2_W=2.0 * problem.power_fixed_W)  # half of the fixed part is worth it
    expected = (0.5 + 0.5 * 1.5 + 0.75**2 * 2.0) * problem.power_fixed_W + 0.75 * problem.power_per_u_W
    np.testing.assert_allclose(numpy_problem.power_W(bent, np.full((1, N), 0.75)), expected)


def test_numbers_that_are_not_finite_are_a_failed_solve_not_an_action():
    rng = np.random.default_rng(1)
    operator = single(random_operator(rng, 1))
    problem = random_problem(rng, 1)
    broken = MPCProblem(**{**problem.__dict__, "T_free_C": np.full((1, N), np.nan)})
    solver = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    solution = solver.solve(broken)
    assert (solution.ok, solution.u.size) == (False, 0)
    assert "not finite" in solution.problem
    assert solver.solve(problem).ok, "a failed solve must not spoil the next"


def unsolved(_, programme):
    return SolverResult(False, np.zeros(programme.linear.size), "ended early", 1)


def crash(*_):
    raise MemoryError("out of memory")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.convex and "xclu" not in name])
def test_a_convex_problem_begins_at_the_optimum_of_piqp(name):
    operator, problem, shape = instance(CASES[name], np.random.default_rng(4))
    solution = IpoptSolver(operator, shape, IpoptConfig()).solve(problem)
    assert solution.status == "ipopt:Solve_Succeeded"
    assert solution.iterations <= 4


@pytest.mark.parametrize("piqp", [unsolved, crash])
def test_where_piqp_finds_no_optimum_ipopt_finds_the_same_from_a_guess(monkeypatch, piqp):
    operator, problem, shape = instance(CASES["everything convex"], np.random.default_rng(4))
    near = IpoptSolver(operator, shape, IpoptConfig()).solve(problem)
    monkeypatch.setattr(Piqp, "__call__", piqp)
    far = IpoptSolver(operator, shape, IpoptConfig()).solve(problem)
    assert far.status == "ipopt:Solve_Succeeded"
    assert far.iterations > 5
    assert near.cost == pytest.approx(far.cost, rel=1e-6)
    np.testing.assert_allclose(near.u, far.u, atol=1e-3)


def test_too_few_iterations_are_a_failed_solve(monkeypatch):
    monkeypatch.setattr(Piqp, "__call__", unsolved)  # from its optimum, one is enough
    rng = np.random.default_rng(2)
    operator = single(random_operator(rng, 1))
    solution = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig(max_iterations=1)).solve(
        random_problem(rng, 1)
    )
    assert not solution.ok
    assert solution.status == "ipopt:Maximum_Iterations_Exceeded"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_ipopt_finds_the_optimum_where_the_gain_sees_the_plan(seed):
    """Derivatives are not constant there: told that they were, Ipopt stopped early with its word for success."""
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, 2)
    operator = replace(
        operator,
        feedback=True,
        hidden_weight=operator.hidden_weight / 2,
        feature_mean=np.array([20.0, 5.0, 100.0, 0.0]),
        gains=2 * operator.gains,
    )
    assert operator.feedback_active
    operator = single(operator)
    problem = random_problem(rng, 2, curvature=1e-6)
    problem = replace(problem, T_free_C=problem.T_free_C + 3.0)
    solution = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig()).solve(problem)
    assert solution.ok, solution.problem
    best = multi_start_optimum(problem, operator, rng, starts=4)
    assert float(numpy_problem.cost(problem, operator, solution.u)) <= best * (1 + 1e-4)


def tanhs(function: ca.Function) -> int:
    return sum(function.instruction_id(k) == ca.OP_TANH for k in range(function.n_instructions()))


@pytest.mark.parametrize("name", ["one zone", "blocked", "several", "feedback"])
def test_ipopt_is_given_the_exported_operator_with_its_network(name):
    """33 tanh of each actuator and step stand in what Ipopt evaluates, with the weights among its parameters."""
    operator, problem, shape = instance(CASES[name], np.random.default_rng(0))
    solver = IpoptSolver(operator, shape, IpoptConfig())
    found, gains = solver.solve(problem), 33 * shape.n_moves * len(operator.actuators)
    assert tanhs(solver.programme.get_function("nlp_g")) == gains
    weights = sum(operator.of_actuator(a).hidden_weight.size for a in range(len(operator.actuators)))
    assert solver.programme.size1_in("p") > weights + 4 * shape.n_moves
    assert found.parameters == operator.n_used >= 195
    # Other weights are another optimum of the same graph.
    other = operator.map(lambda pair: replace(pair, output_weight=-pair.output_weight))
    again = IpoptSolver(other, shape, IpoptConfig())
    assert again.programme is solver.programme
    assert abs(again.solve(problem).cost - found.cost) > 1e-4
    assert tanhs(solver.programme.get_function("nlp_f")) == 0
