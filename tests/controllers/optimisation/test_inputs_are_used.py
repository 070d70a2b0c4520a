"""A solver that has solved one instance answers the next as one built anew, whichever of its numbers is another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import sparse
from structures import CASES, instance

from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import Cooling, MPCProblem, PowerCap
from controllers.optimisation.programme import QPData
from controllers.optimisation.solution import Solver
from controllers.optimisation.solvers.highs import Highs, MilpConfig
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.milp import MilpSolver
from controllers.optimisation.solvers.qp import Piqp, QPConfig, QPSolver
from controllers.optimisation.solvers.sqp import SQPConfig, SQPSolver
from controllers.optimisation.statement.terms import PlanExpressions

N = 6
NONE = np.zeros(0, dtype=np.intp)
EXACT = MilpConfig(gap=0.0, max_seconds=30.0)


def programme() -> QPData:
    """Levels near one, with a sum, and rows between bounds."""
    rng = np.random.default_rng(3)
    return QPData(
        sparse.csc_matrix(np.diag(np.full(N, 0.5))),
        rng.normal(size=N),
        sparse.csc_matrix(np.vstack([np.ones(N), np.r_[1.0, -1.0, np.zeros(N - 2)]])),
        np.array([1.0, 0.1]),
        sparse.csc_matrix(rng.normal(size=(3, N))),
        np.full(3, -0.5),
        np.full(3, 0.5),
        np.full(N, -0.4),
        np.full(N, 0.45),
        1.0,
        0.0,
    )


def dense(matrix: sparse.csc_matrix, change: Callable[[Any], Any]) -> sparse.csc_matrix:
    return sparse.csc_matrix(change(matrix.toarray()))


PROGRAMMES: dict[str, Callable[[QPData], QPData]] = {
    "second derivatives": lambda q: replace(q, quadratic=4.0 * q.quadratic),
    "pattern of second derivatives": lambda q: replace(
        q, quadratic=q.quadratic + sparse.csc_matrix(np.outer(np.arange(N), np.arange(N)))
    ),
    "fewer second derivatives": lambda q: replace(
        q, quadratic=sparse.csc_matrix(np.diag(np.r_[np.zeros(3), np.ones(3)]))
    ),
    "slopes": lambda q: replace(q, linear=-q.linear),
    "equations": lambda q: replace(q, A=dense(q.A, lambda a: 2.0 * a)),
    "pattern of equations": lambda q: replace(q, A=dense(q.A, lambda a: a[:, ::-1])),
    "right sides": lambda q: replace(q, b=-q.b),
    "rows": lambda q: replace(q, G=-2.0 * q.G),
    "pattern of rows": lambda q: replace(q, G=dense(q.G, lambda g: np.where(g > 0, g, 0.0))),
    "lower sides of rows": lambda q: replace(q, low=np.array([-np.inf, -0.5, 0.5]), high=np.full(3, 0.55)),
    "upper sides of rows": lambda q: replace(q, high=np.array([-0.1, np.inf, -0.1])),
    "lower bounds": lambda q: replace(q, x_low=np.full(N, -0.1)),
    "upper bounds": lambda q: replace(q, x_high=np.full(N, 0.35)),
    "no bounds": lambda q: replace(q, x_low=np.full(N, -np.inf), x_high=np.full(N, np.inf)),
    "bounds that are far": lambda q: replace(q, x_low=np.full(N, -1e9), x_high=np.full(N, 1e12)),
}


@pytest.mark.parametrize("change", PROGRAMMES.values(), ids=PROGRAMMES)
def test_piqp_solves_the_programme_that_it_is_given(change):
    used, first = Piqp(QPConfig()), programme()
    before, other = used(first), change(first)
    assert before.solved
    found, fresh = used(other), Piqp(QPConfig())(other)
    assert found.solved
    np.testing.assert_allclose(found.x, fresh.x, atol=1e-9)
    assert np.abs(found.x - before.x).max() > 1e-3
    assert other.above_least(found.x, found.multipliers) < 1e-5
    assert other.above_least(found.x, before.multipliers) > 1e-4, "the multipliers of another programme show nothing"


@pytest.mark.parametrize("name", [name for name in PROGRAMMES if "second" not in name and name != "no bounds"])
def test_highs_solves_the_programme_that_it_is_given(name):
    first = replace(programme(), quadratic=sparse.csc_matrix((N, N)))
    before, other = Highs(EXACT)(first, NONE), PROGRAMMES[name](first)
    found = Highs(EXACT)(other, NONE)
    assert before.solved
    if name == "bounds that are far":
        assert found.solved
        assert other.violation(found.x) < 1e-6
        return
    if not found.solved:
        assert found.status == "Infeasible"
        assert not Piqp(QPConfig())(replace(other, quadratic=1e-9 * sparse.identity(N, format="csc"))).solved
        return
    assert np.abs(found.x - before.x).max() > 1e-3
    assert other.above_least(found.x, found.multipliers) < 1e-9


def test_highs_uses_choices_start_gap_and_time():
    rng = np.random.default_rng(0)
    weights, worth = rng.uniform(0.5, 1.5, (2, 40)), rng.uniform(1.0, 2.0, 40)
    q = QPData(
        sparse.csc_matrix((40, 40)), -worth, sparse.csc_matrix((0, 40)), np.zeros(0), sparse.csc_matrix(weights),
        np.full(2, -np.inf), np.full(2, 9.3), np.zeros(40), np.ones(40), 1.0, 0.0,
    )  # fmt: skip
    choices = np.arange(40)
    relaxed, best = Highs(EXACT)(q, NONE), Highs(EXACT)(q, choices)
    assert q.objective(relaxed.x) < q.objective(best.x) - 1e-3
    assert np.abs(best.x - np.round(best.x)).max() < 1e-6
    at_once = Highs(MilpConfig(max_seconds=1e-9))
    for take in (0, 7):
        start = (np.arange(40) == take).astype(float)
        stopped = at_once(q, choices, start)
        assert (stopped.solved, stopped.status) == (False, "Time limit reached")
        np.testing.assert_allclose(stopped.x, start)
    assert at_once(q, choices).x.size == 0
    assert Highs(MilpConfig(gap=0.5))(q, choices).bound < q.objective(best.x) - 1e-3


def ramp(plan: PlanExpressions) -> None:
    """A price of the first change of each level."""
    change = plan.variable("change", plan.u.shape[0], 0.0, 10.0)
    plan.require(change - (plan.u[:, 0] - plan.last_u).T)
    plan.require(change + (plan.u[:, 0] - plan.last_u).T)
    plan.add_cost(0.3 * change)


CHANGES: dict[str, Callable[[MPCProblem], MPCProblem]] = {
    "forced_state_K": lambda p: replace(p, forced_state_K=p.forced_state_K + 0.5),
    "features": lambda p: replace(p, features=p.features + np.array([0.0, -8.0, 100.0, 0.0])),
    "T_free_C": lambda p: replace(p, T_free_C=p.T_free_C - 0.7),
    "lower_C": lambda p: replace(p, lower_C=p.lower_C - 1.0),
    "upper_C": lambda p: replace(p, upper_C=p.upper_C - 1.0),
    "price_per_kWh": lambda p: replace(p, price_per_kWh=p.price_per_kWh * np.linspace(0.2, 6.0, p.n_steps)),
    "power_fixed_W": lambda p: replace(p, power_fixed_W=4.0 * p.power_fixed_W),
    "power_per_u_W": lambda p: replace(p, power_per_u_W=4.0 * p.power_per_u_W),
    "comfort": lambda p: replace(p, weights=replace(p.weights, comfort=0.1 * np.asarray(p.weights.comfort))),
    "curvature": lambda p: replace(p, weights=replace(p.weights, curvature=0.5)),
    "peak": lambda p: replace(p, weights=replace(p.weights, peak=20.0 * p.weights.peak)),
    "peak_so_far_W": lambda p: replace(p, peak_so_far_W=3.0 * p.peak_so_far_W),
    "cooling": lambda p: replace(p, cooling=Cooling(0.0 * p.power_per_u_W, 0.1 * p.power_per_u_W)),
    "power_cap": lambda p: replace(p, power_cap=PowerCap(0.3 * p.power_cap.limit_W, 5.0)),
    "capacity": lambda p: replace(p, capacity=0.4 * p.capacity),
    "available": lambda p: replace(p, available=np.full(p.power_per_u_W.shape, 0.5)),
    "last_u": lambda p: replace(p, last_u=np.ones(p.last_u.shape)),
    "step_s": lambda p: replace(p, step_s=0.5 * p.step_s),
}  # fmt: skip
SOLVERS: dict[str, Callable[..., Solver]] = {
    "ipopt": lambda operator, shape: IpoptSolver(operator, shape, IpoptConfig()),
    "qp": lambda operator, shape: QPSolver(operator, shape, QPConfig()),
    "sqp": lambda operator, shape: SQPSolver(operator, shape, SQPConfig()),
    "milp": lambda operator, shape: MilpSolver(operator, shape, EXACT),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_uses_every_number_of_an_instance(name):
    """Each number moves the levels of some instance, and in every instance the answer is that of a new solver.

    The programme is nearly linear: its optimum sits where limits meet, and may stay there when a number changes (of 25
    instances 1 to 15 do for a number). So a number that moves nothing in one instance is tried in the next.
    """
    # The choice leaves the curvature out, as it says.
    ignored = [number for number in CHANGES if (name, number) != ("milp", "curvature")]
    for seed in range(1, 21):
        operator, problem, shape = instance(CASES["everything convex"], np.random.default_rng(seed))
        problem = replace(problem, last_u=np.zeros(len(operator.actuators)))
        if name != "milp":
            problem = replace(problem, weights=replace(problem.weights, curvature=1e-3))
        shape = replace(shape, terms=(ramp,))
        used = SOLVERS[name](operator, shape)
        before = used.solve(problem)
        assert before.ok, before.problem
        for number in list(ignored):
            other = CHANGES[number](problem)
            found, fresh = used.solve(other), SOLVERS[name](operator, shape).solve(other)
            assert found.ok, (number, found.problem)
            assert found.cost == pytest.approx(fresh.cost, rel=1e-9), number
            unchanged = used.model.evaluate(used.model.numbers(other), before.u, before.own_values)
            assert unchanged.broken or found.cost <= unchanged.cost + 1e-5, (seed, number)
            better = found.cost < unchanged.cost - 1e-5 or bool(unchanged.broken)
            if better and np.abs(found.u - before.u).max() > 1e-4:
                ignored.remove(number)
        if not ignored:
            return
    raise AssertionError(f"in 20 instances nothing moved with {', '.join(ignored)}")


def test_sqp_and_ipopt_start_from_the_levels_that_they_are_given():
    operator, problem, shape = instance(CASES["feedback"], np.random.default_rng(1))
    for solver in (SQPSolver(operator, shape, SQPConfig()), IpoptSolver(operator, shape, IpoptConfig())):
        cold = solver.solve(problem)
        warm = solver.solve(problem, cold.u)
        assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
        assert warm.iterations < cold.iterations


LIMITS = {
    "ipopt, time": lambda operator, shape: IpoptSolver(operator, shape, IpoptConfig(max_seconds=1e-6)),
    "ipopt, iterations": lambda operator, shape: IpoptSolver(operator, shape, IpoptConfig(max_iterations=2)),
    "qp, iterations": lambda operator, shape: QPSolver(operator, shape, QPConfig(max_iterations=2)),
    "sqp, iterations": lambda operator, shape: SQPSolver(operator, shape, SQPConfig(max_iterations=1)),
    "milp, time": lambda operator, shape: MilpSolver(operator, shape, MilpConfig(max_seconds=1e-9)),
}


@pytest.mark.parametrize("name", LIMITS)
def test_a_solver_that_is_stopped_gives_no_optimum(name):
    case = "exclusive" if name.startswith("milp") else "several" if name.startswith("qp") else "feedback"
    operator, problem, shape = instance(CASES[case], np.random.default_rng(1))
    found = LIMITS[name](operator, shape).solve(problem)
    assert not (found.ok and found.optimal)
    assert found.problem
    if name.startswith("milp"):  # the plan at hand is taken
        assert found.ok
        assert "Time limit reached" in found.problem
        assert found.cost < 1.3 * MilpSolver(operator, shape, EXACT).solve(problem).cost


def test_sqp_takes_the_second_derivatives_of_every_programme():
    """Its second programme has other elements than its first; with those of the first it ended 0.4 % above."""
    operator, problem, shape = instance(CASES["feedback"], np.random.default_rng(4))
    operator = operator.map(lambda pair: replace(pair, hidden_weight=4 * pair.hidden_weight, gains=2 * pair.gains))
    best = IpoptSolver(operator, shape, IpoptConfig(tolerance=1e-10)).solve(problem)
    found = SQPSolver(operator, shape, SQPConfig()).solve(problem)
    assert found.optimal, found.problem
    assert found.cost == pytest.approx(best.cost, rel=1e-6)


def test_programmes_of_one_structure_have_one_pattern():
    operator, problem, shape = instance(CASES["feedback"], np.random.default_rng(4))
    model = PlanModel(operator, shape)
    p = model.numbers(problem)
    x = model.evaluate(p, model.cold()).variables
    first, later = model.local(p), model.local(p, x, np.ones(model.functions.local.size1_in(2)))
    later = later.near(np.ones(x.size))
    for ours, theirs in zip((first.quadratic, first.A, first.G), (later.quadratic, later.A, later.G), strict=True):
        np.testing.assert_array_equal(ours.indices, theirs.indices)
        np.testing.assert_array_equal(ours.indptr, theirs.indptr)
    np.testing.assert_allclose(
        later.quadratic.diagonal() - model.local(p, x, np.ones(model.functions.local.size1_in(2))).quadratic.diagonal(),
        1.0,
    )


FAR = (1e3, 1e9, 1e12)


@pytest.mark.parametrize("far", FAR)
def test_a_variable_of_the_user_may_have_far_bounds(far):
    operator, problem, shape = instance(CASES["several"], np.random.default_rng(0))
    problem = replace(problem, last_u=np.full(len(operator.actuators), 0.5))

    def smooth(plan: PlanExpressions) -> None:
        for a in range(plan.u.shape[0]):
            change = plan.variable(f"change {a}", plan.u.shape[1], 0.0, far)
            difference = plan.u[a, :] - ca.horzcat(plan.last_u[a], plan.u[a, :-1])
            plan.require(change - difference)
            plan.require(change + difference)
            plan.add_cost(0.3 * change)

    solver = QPSolver(operator, replace(shape, terms=(smooth,)), QPConfig())
    for _ in range(2):
        found = solver.solve(problem)
        assert found.optimal, found.problem
        assert found.status == "piqp:PIQP_SOLVED"
        assert found.cost == pytest.approx(55.1774, abs=1e-3)


def test_a_far_bound_that_is_reached_holds():
    """Here the bound is what ends the variable: taken as none, the programme is unbounded."""
    operator, problem, shape = instance(CASES["several"], np.random.default_rng(0))

    def most(plan: PlanExpressions) -> None:
        plan.add_cost(-1e-3 * plan.variable("most", 1, 0.0, 2e6))

    shape = replace(shape, terms=(most,))
    ipopt = lambda: IpoptSolver(operator, shape, IpoptConfig())  # noqa: E731
    found = QPSolver(operator, shape, QPConfig(), ipopt).solve(problem)
    assert found.ok, found.problem
    assert found.own["most"] == pytest.approx(2e6)
