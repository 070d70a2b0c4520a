"""Both solvers on problems whose optimum is known another way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from controllers.ipopt import IpoptConfig, IpoptSolver
from controllers.problem import MPCProblem, ProblemShape, Weights, every_step
from controllers.search import CandidateSearch, SearchConfig
from thermoforce_mpc.operator.parameters import OperatorParameters, linear_operator

N = 12


def random_operator(rng: np.random.Generator, order: int) -> OperatorParameters:
    base = linear_operator(np.linspace(0.3, 0.97, order), rng.uniform(0.1, 0.5, order), step_s=3600.0)
    return OperatorParameters(
        **{
            **{name: getattr(base, name) for name in base.__dataclass_fields__},
            "hidden_weight": rng.normal(size=(32, 4)),
            "hidden_bias": rng.normal(size=32),
            "output_weight": rng.normal(size=32) / 6,
            "feature_mean": np.array([10.0, 5.0, 100.0, 0.0]),
            "feature_scale": np.array([3.0, 5.0, 100.0, 0.7]),
        }
    )


def random_problem(rng: np.random.Generator, order: int, lowest: float = 1.0, curvature: float = 0.0) -> MPCProblem:
    return MPCProblem(
        forced_state_K=rng.uniform(0, 5, order),
        features=rng.normal([10, 5, 100, 0], [3, 5, 100, 0.7], (N, 4)),
        T_free_C=rng.uniform(12, 16, N),
        lower_C=np.where(np.arange(N) % 5 < 3, 21.0, 15.0),
        upper_C=np.full(N, 24.0),
        price_per_kWh=rng.uniform(0.1, 0.4, N),
        power_fixed_W=rng.uniform(1000, 2000, N),
        power_per_u_W=rng.uniform(2000, 3000, N),
        step_s=3600.0,
        u_max=1.0,
        lowest_level=lowest,
        weights=Weights(5.0, curvature),
        terminal_price_per_K=np.zeros(order),
    )


def linear_programme_optimum(problem: MPCProblem, operator: OperatorParameters) -> float:
    """The same problem condensed and solved by HiGHS: the effect of each u is a column of unit responses."""
    at_rest = problem.forced_K(operator, np.zeros(N))
    effect = np.stack([problem.forced_K(operator, row) - at_rest for row in np.eye(N)], axis=1)
    T_rest = problem.T_free_C + at_rest
    cost = np.concatenate([problem.price_per_W * problem.power_W(np.ones(N)), np.full(N, problem.comfort_price)])
    A = np.block([[-effect, -np.eye(N)], [effect, -np.eye(N)]])
    b = np.concatenate([T_rest - problem.lower_C, problem.upper_C - T_rest])
    bounds = [(0, 1)] * N + [(0, None)] * N
    return float(linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs").fun)


@pytest.mark.parametrize("order", [1, 3])
def test_ipopt_finds_the_optimum_of_the_linear_programme(order):
    rng = np.random.default_rng(order)
    operator = random_operator(rng, order)
    solver = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    for _ in range(5):
        problem = random_problem(rng, order)
        solution = solver.solve(problem)
        assert solution.ok, solution.problem
        best = linear_programme_optimum(problem, operator)
        assert float(problem.cost(operator, solution.u)) == pytest.approx(best, rel=1e-5, abs=1e-5)


def test_the_numpy_objective_counts_the_fixed_part_while_on():
    rng = np.random.default_rng(0)
    problem = random_problem(rng, 1, lowest=0.5)
    u = np.full(N, 0.75)
    expected = (problem.price_per_kWh * (problem.power_fixed_W + 0.75 * problem.power_per_u_W) / 1000).sum()
    operator = random_operator(rng, 1)
    slack = problem.slack_K(problem.T_free_C + problem.forced_K(operator, u))
    assert float(problem.cost(operator, u)) == pytest.approx(expected + 5.0 * slack.sum())


def test_ipopt_is_never_worse_than_the_candidates_when_levels_are_held():
    rng = np.random.default_rng(3)
    operator = random_operator(rng, 2)
    ipopt = IpoptSolver(operator, ProblemShape(every_step(N), lowest_level=0.3), IpoptConfig())
    search = CandidateSearch(operator, N, SearchConfig())
    for _ in range(5):
        problem = random_problem(rng, 2, lowest=0.3, curvature=1e-6)
        ours, theirs = ipopt.solve(problem), search.solve(problem)
        assert ours.ok
        assert theirs.ok
        assert problem.cost(operator, ours.u) <= problem.cost(operator, theirs.u) + 1e-4


def test_numbers_that_are_not_finite_are_a_failed_solve_not_an_action():
    rng = np.random.default_rng(1)
    operator = random_operator(rng, 1)
    problem = random_problem(rng, 1)
    broken = MPCProblem(**{**problem.__dict__, "T_free_C": np.full(N, np.nan)})
    solver = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    solution = solver.solve(broken)
    assert (solution.ok, solution.u.size) == (False, 0)
    assert "not finite" in solution.problem
    assert solver.solve(problem).ok, "a failed solve must not spoil the next"


def test_too_few_iterations_are_a_failed_solve():
    rng = np.random.default_rng(2)
    operator = random_operator(rng, 1)
    solution = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig(max_iterations=1)).solve(
        random_problem(rng, 1)
    )
    assert not solution.ok
    assert solution.status == "Maximum_Iterations_Exceeded"


def test_search_returns_the_cheapest_of_its_candidates():
    rng = np.random.default_rng(4)
    operator = random_operator(rng, 1)
    problem = random_problem(rng, 1, lowest=0.3)
    search = CandidateSearch(operator, N, SearchConfig(levels=(0.0, 1.0), first_stretch_steps=(3,)))
    solution = search.solve(problem)
    rows = np.array([[a] * 3 + [b] * (N - 3) for a in (0.0, 1.0) for b in (0.0, 1.0)])
    assert float(problem.cost(operator, solution.u)) == pytest.approx(float(problem.cost(operator, rows).min()))
