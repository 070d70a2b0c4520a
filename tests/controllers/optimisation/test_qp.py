"""The quadratic qp_data: the same optimum as Ipopt, a second solver behind the first, and no trust in a status."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import numpy_problem
import pytest
from mpc_problems import (
    N,
    linear_programme_optimum,
    machinery_of,
    random_building,
    random_operator,
    random_problem,
)

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import ProblemShape, Weights, blocked_moves, every_step
from controllers.optimisation.solution import SolverAnswer, checked
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.qp import Piqp, QPConfig, QPSolver, SolverResult
from controllers.optimisation.statement.algebra import difference_equation
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import driven_rollout, single
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator

SHAPES = {
    "every step": ProblemShape(every_step(N)),
    "blocked": ProblemShape(blocked_moves(N, 3600.0, 4.0, 3.0)),
    "peak": ProblemShape(every_step(N), peak=True),
}


def full_problem(rng: np.random.Generator, order: int, *, peak: bool):
    problem = random_problem(rng, order, curvature=1e-6)
    weights = Weights(5.0, 1e-6, 2e-4 if peak else 0.0)
    return replace(problem, weights=weights, peak_so_far_W=1500.0)


def test_it_finds_the_optimum_of_the_linear_programme():
    rng = np.random.default_rng(11)
    operator = single(random_operator(rng, 2))
    solver = QPSolver(operator, ProblemShape(every_step(N)), QPConfig())
    for _ in range(5):
        problem = random_problem(rng, 2)
        best = linear_programme_optimum(problem, operator)
        assert float(numpy_problem.cost(problem, operator, solver.solve(problem).u)) == pytest.approx(best, rel=1e-6)


def test_steps_of_one_move_share_their_level():
    rng = np.random.default_rng(6)
    operator, shape = single(random_operator(rng, 1)), SHAPES["blocked"]
    u = QPSolver(operator, shape, QPConfig()).solve(full_problem(rng, 1, peak=False)).u[0]
    assert shape.move_of_step.tolist() == [0, 1, 2, 3, 4, 4, 4, 5, 5, 5, 6, 6]
    for move in range(4, shape.n_moves):
        assert np.ptp(u[shape.move_of_step == move]) == 0.0


def test_a_priced_peak_is_lower():
    rng = np.random.default_rng(7)
    operator = single(random_operator(rng, 2))
    problem = full_problem(rng, 2, peak=True)
    free = QPSolver(operator, SHAPES["every step"], QPConfig()).solve(replace(problem, weights=Weights(5.0, 1e-6)))
    dear = QPSolver(operator, SHAPES["peak"], QPConfig()).solve(replace(problem, weights=Weights(5.0, 1e-6, 1.0)))
    assert numpy_problem.power_W(problem, dear.u).max() < numpy_problem.power_W(problem, free.u).max() - 100.0


def test_ipopt_acts_where_it_fails(monkeypatch):
    rng = np.random.default_rng(9)
    operator, shape = single(random_operator(rng, 2)), SHAPES["every step"]
    problem = random_problem(rng, 2, curvature=1e-6)
    fails = lambda q: SolverResult(False, np.zeros(q.linear.size), "a word of its own", 1)  # noqa: E731
    ipopt = partial(IpoptSolver, operator, shape, IpoptConfig())
    solution = QPSolver(operator, shape, QPConfig(), ipopt, fails).solve(problem)
    assert solution.ok
    assert solution.status == "ipopt:Solve_Succeeded"
    failed = QPSolver(operator, shape, QPConfig(), None, fails).solve(problem)
    assert (failed.ok, failed.u.size) == (False, 0)
    assert "ended with a word of its own" in failed.problem
    monkeypatch.setattr(Piqp, "__call__", lambda _, programme: fails(programme))  # where Ipopt begins, too
    stopped = partial(IpoptSolver, operator, shape, IpoptConfig(max_iterations=1))
    failed = QPSolver(operator, shape, QPConfig(), stopped, fails).solve(problem)
    assert not failed.ok
    assert all(word in failed.problem for word in ("a word of its own", "Maximum_Iterations_Exceeded"))


def test_a_failed_solve_does_not_spoil_the_next():
    rng = np.random.default_rng(10)
    operator = single(random_operator(rng, 2))
    problem = random_problem(rng, 2, curvature=1e-6)
    solver = QPSolver(operator, SHAPES["every step"], QPConfig())
    first = solver.solve(problem)
    refused = solver.solve(replace(problem, price_per_kWh=np.full((1, N), np.nan)))
    assert not refused.ok
    assert "not finite" in refused.problem
    np.testing.assert_allclose(solver.solve(problem).u, first.u, atol=1e-6)


def test_a_problem_that_is_not_convex_is_refused_with_advice():
    rng = np.random.default_rng(0)
    pair, two = random_operator(rng, 1), random_building(rng, 2, (1, 1))
    with pytest.raises(ControllerConfigError, match=r"exclude one another.* use a model .*or solver: ipopt"):
        QPSolver(two, ProblemShape(every_step(N), machinery_of(two, (0, 1), exclusive=((0, 1),))), QPConfig())
    heat = MachineLoad((1000.0, 0.0, 9000.0, 0.0), (-10.0, 20.0), lowest_level=0.3)
    with pytest.raises(ControllerConfigError, match=r"known for a lowest level of 0\.3, not 1"):
        QPSolver(single(replace(pair, heat_input=HeatInput(heat=heat))), ProblemShape(every_step(N)), QPConfig())


def test_a_claim_that_is_true_is_accepted_and_one_that_is_too_good_is_not():
    """And levels are called the optimum only with multipliers that show it."""
    rng = np.random.default_rng(13)
    operator, problem = single(random_operator(rng, 1)), random_problem(rng, 1)
    problem = replace(problem, T_free_C=problem.T_free_C + 6.0)
    model = PlanModel(operator, ProblemShape(every_step(N)))
    p = model.numbers(problem)
    best = Piqp(QPConfig())(model.local(p))
    shows = model.local(p).unit * best.multipliers
    u = model.levels(best.x)
    cost = float(numpy_problem.cost(problem, operator, u))
    true = checked(model, problem, p, SolverAnswer(model.evaluate(p, u).variables, cost, "ok", 1, multipliers=shows))
    assert (true.ok, true.optimal, true.problem) == (True, True, "")
    assert not checked(model, problem, p, SolverAnswer(best.x, 0.9 * cost, "ok", 1, multipliers=shows)).ok
    unshown = checked(model, problem, p, SolverAnswer(best.x, cost, "ok", 1))
    assert (unshown.ok, unshown.optimal) == (True, False)
    assert "without what shows" in unshown.problem
    u[0, u[0].argmax()] *= 0.9
    x = model.evaluate(p, u).variables
    worse = checked(
        model, problem, p, SolverAnswer(x, float(numpy_problem.cost(problem, operator, u)), "ok", 1, multipliers=shows)
    )
    assert (worse.ok, worse.optimal) == (True, False)
    assert "may cost" in worse.problem


def test_the_difference_equation_answers_like_the_modes_whatever_the_lengths_of_steps():
    rng = np.random.default_rng(14)
    operator = random_operator(rng, 3)
    lengths = [1, 1, 1, 1, 4, 4, 2, 1, 4, 4, 4, 3]
    drive = rng.uniform(0.0, 1.0, len(lengths))
    modes = driven_rollout(operator, np.zeros(3), np.repeat(drive, lengths))
    y = modes.sum(axis=-1)[np.cumsum(lengths) - 1]
    for k in range(3, len(lengths)):
        left, right = difference_equation(operator.poles, operator.gains[None], lengths[k - 2 : k + 1])
        assert left @ y[k::-1][:4] == pytest.approx(float(right[:, 0] @ drive[k::-1][:3]), rel=1e-9)


def piqp_alone_finds_ipopts_optimum(operator, problem):
    shape = ProblemShape(every_step(problem.n_steps))
    ours = QPSolver(operator, shape, QPConfig()).solve(problem)
    reference = IpoptSolver(operator, shape, IpoptConfig(tolerance=1e-10)).solve(problem)
    assert ours.ok, ours.problem
    best = float(numpy_problem.cost(problem, operator, reference.u))
    assert float(numpy_problem.cost(problem, operator, ours.u)) == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("time_constants_h", [(0.01, 3.0), (0.3, 4.0, 900.0), (2.0, 2.2, 2.4)])
def test_very_fast_very_slow_and_nearly_equal_modes_are_planned_with(time_constants_h):
    """Their difference equation is nearly an integrator, or forgets all within a step: the check must not refuse it."""
    rng = np.random.default_rng(15)
    n, order = 192, len(time_constants_h)
    poles = np.exp(-0.25 / np.array(time_constants_h))
    operator = single(linear_operator(poles, np.full(order, 0.05), step_s=900.0))
    problem = replace(random_problem(rng, order, n=n, curvature=1e-6), step_s=900.0)
    piqp_alone_finds_ipopts_optimum(operator, problem)


@pytest.mark.parametrize("gain", [0.0, 1e-12])
def test_slow_modes_without_gain_do_not_fail_the_solver(gain):
    """As a fit leaves them: two more lags that nearly cancel, over two days at 900 s."""
    rng = np.random.default_rng(19)
    poles = np.exp(-0.25 / np.array([40.0, 400.0, 4000.0]))
    operator = single(linear_operator(poles, np.array([4.0, gain, gain]) * (1.0 - poles), step_s=900.0))
    forced_K = np.array([[[rng.uniform(0.0, 5.0), 0.0, 0.0]]])
    problem = replace(random_problem(rng, 3, n=192, curvature=1e-6), step_s=900.0, forced_state_K=forced_K)
    piqp_alone_finds_ipopts_optimum(operator, problem)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_the_plan_does_not_depend_on_the_currency(rate):
    rng = np.random.default_rng(16)
    operator, shape = single(random_operator(rng, 2)), SHAPES["every step"]
    problem = random_problem(rng, 2, curvature=1e-3)
    weights = Weights(rate * problem.weights.comfort, rate * problem.weights.curvature)
    elsewhere = replace(problem, price_per_kWh=rate * problem.price_per_kWh, weights=weights)
    here, there = (QPSolver(operator, shape, QPConfig()).solve(p) for p in (problem, elsewhere))
    assert there.ok, there.problem
    np.testing.assert_allclose(there.u, here.u, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 12])
def test_cooling_over_any_horizon_has_ipopts_optimum(n):
    """A horizon may be shorter than the order of the difference equation."""
    rng = np.random.default_rng(17)
    operator = single(linear_operator(np.linspace(0.3, 0.97, 3), -rng.uniform(0.1, 0.5, 3), step_s=3600.0, sign=-1))
    problem = replace(
        random_problem(rng, 3, n=n, curvature=1e-6),
        T_free_C=rng.uniform(26.0, 32.0, (1, n)),
        forced_state_K=-rng.uniform(0.0, 1.0, (1, 1, 3)),
    )
    piqp_alone_finds_ipopts_optimum(operator, problem)


@pytest.mark.slow
@pytest.mark.parametrize("peak", [False, True])
def test_wild_instances_are_solved_as_by_ipopt(peak):
    """Zones far outside the band, negative and free power, heat of yesterday, discomfort that costs nothing or all."""
    rng = np.random.default_rng(18)
    operator, shape = single(random_operator(rng, 3)), ProblemShape(blocked_moves(96, 3600.0, 12.0, 3.0), peak=peak)
    piqp, ipopt = QPSolver(operator, shape, QPConfig()), IpoptSolver(operator, shape, IpoptConfig())
    for _ in range(40):
        problem = random_problem(rng, 3, n=96, curvature=1e-6)
        problem = replace(
            problem,
            T_free_C=problem.T_free_C + rng.choice([-20.0, 0.0, 20.0]) + rng.normal(0.0, 5.0, (1, 96)),
            forced_state_K=rng.normal(0.0, rng.choice([0.1, 15.0]), (1, 1, 3)),
            price_per_kWh=rng.choice([0.0, 1.0]) * rng.normal(0.05, 0.2, (1, 96)),
            weights=Weights(10.0 ** rng.uniform(-3, 4), 1e-6, 10.0 ** rng.uniform(-5, -1) if peak else 0.0),
        )
        ours, other = piqp.solve(problem), ipopt.solve(problem)
        assert ours.ok, ours.problem
        assert other.ok, other.problem
        assert ours.cost == pytest.approx(other.cost, rel=1e-5, abs=1e-5)


def test_a_solver_that_raises_is_followed_by_the_next(monkeypatch):
    rng = np.random.default_rng(8)
    operator, problem = single(random_operator(rng, 2)), random_problem(rng, 2, curvature=1e-6)
    shape = ProblemShape(every_step(N))
    solver = QPSolver(operator, shape, QPConfig(), partial(IpoptSolver, operator, shape, IpoptConfig()))
    best = solver.solve(problem)

    def crash(self, programme):
        raise MemoryError("out of memory")

    with monkeypatch.context() as broken:
        broken.setattr(Piqp, "__call__", crash)
        solution = solver.solve(problem)
        assert solution.status.startswith("ipopt")
        np.testing.assert_allclose(solution.u, best.u, atol=1e-4)
        failed = QPSolver(operator, shape, QPConfig()).solve(problem)
        assert (failed.ok, failed.problem) == (False, "piqp: raised MemoryError: out of memory")
    np.testing.assert_array_equal(solver.solve(problem).u, best.u)
