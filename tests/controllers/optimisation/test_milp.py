"""Choices between off and on: held levels, exclusion and a shared machine, against trying every choice."""

from __future__ import annotations

import itertools
import subprocess
import sys
from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from mpc_problems import (
    N,
    linear_programme_optimum,
    machinery_of,
    random_building,
    random_building_problem,
    random_operator,
    random_problem,
)
from scipy.optimize import linprog

from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver, plan_shape
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, PowerCap, ProblemShape, Weights, every_step
from controllers.optimisation.solvers.held_levels import held_level
from controllers.optimisation.solvers.ipopt import IpoptSolver
from controllers.optimisation.solvers.milp import ChoiceResult, Highs, MilpConfig, MilpSolver
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


def optimum_of_choice(problem: MPCProblem, operator: BuildingOperator, on: np.ndarray) -> float:
    """The problem with on and off (A, N) given, as a linear programme over levels, slack and power above the cap."""
    m, (A, n), Z = problem.machinery, on.shape, problem.T_free_C.shape[0]
    low = np.where(m.held[:, None], m.lowest_level[:, None], 0.0) * on
    high = m.u_max[:, None] * on

    def forced(u: np.ndarray) -> np.ndarray:
        return numpy_problem.forced_K(problem, operator, u).ravel()

    # Affine in the levels while the choice stands, so two points of each give its slope.
    start, middle = np.where(on, 0.5 * (low + high), 0.0), []
    for a, k in itertools.product(range(A), range(n)):
        up, down = start.copy(), start.copy()
        up[a, k], down[a, k] = high[a, k], low[a, k]
        width = high[a, k] - low[a, k]
        middle.append((forced(up) - forced(down)) / width if width else np.zeros(Z * n))
    effect = np.stack(middle, axis=1)
    rest = problem.T_free_C.ravel() + forced(start) - effect @ start.ravel()
    runs = np.stack([np.where(m.held[:, None], on, 0.0)[m.machine_of == i].max(axis=0) for i in range(len(m.machines))])
    price, per_u = problem.price_per_W, problem.power_per_u_W.copy()
    for a in np.flatnonzero(~m.held):  # on/off blocks on a machine of their own
        per_u[a] += problem.power_fixed_W[m.machine_of[a]] / m.lowest_level[a]
    fixed_W = (problem.power_fixed_W * runs).sum(axis=0)
    power = np.concatenate([np.eye(n) * per_u[a] for a in range(A)], axis=1)
    cap = np.full(n, np.inf) if problem.power_cap is None else problem.power_cap.limit_W
    cost = np.concatenate(
        [
            (price[m.machine_of] * per_u).ravel(),
            np.repeat(problem.comfort_price, n),
            np.full(n, problem.cap_price_per_W),
        ]
    )
    none, no_slack, slack = np.zeros((Z * n, n)), np.zeros((n, Z * n)), -np.eye(Z * n)
    A_ub = np.block([[-effect, slack, none], [effect, slack, none], [power, no_slack, -np.eye(n)]])
    b_ub = np.concatenate(
        [rest - problem.lower_C.ravel(), problem.upper_C.ravel() - rest, np.where(np.isinf(cap), 1e9, cap) - fixed_W]
    )
    bounds = [*zip(low.ravel(), high.ravel(), strict=True), *[(0, None)] * (Z * n + n)]
    found = linprog(cost, A_ub=A_ub, b_ub=b_ub, bounds=bounds, method="highs")
    return float(found.fun + (price * problem.power_fixed_W * runs).sum())


def best_choice(problem: MPCProblem, operator: BuildingOperator) -> float:
    (A, n), exclusive = problem.power_per_u_W.shape, problem.machinery.exclusive
    best = np.inf
    for row in itertools.product((0, 1), repeat=A * n):
        on = np.array(row).reshape(A, n)
        if all(on[list(group)].sum(axis=0).max() <= 1 for group in exclusive):
            best = min(best, optimum_of_choice(problem, operator, on))
    return best


@pytest.mark.slow
@pytest.mark.parametrize("heat", [IDENTITY, HeatInput(heat=HEAT)], ids=["identity", "heat"])
@pytest.mark.parametrize(
    ("signs", "machine_of", "lowest", "exclusive"),
    [
        ((1, 1), (0, 0), (0.3, 0.3), ()),  # a shared machine with its fixed part
        ((1, -1), (0, 1), (0.3, 0.3), ((0, 1),)),  # heating or cooling
        ((1, 1), (0, 1), (0.3, 1.0), ((0, 1),)),  # one held, one in blocks
    ],
)
def test_the_plan_is_the_best_of_all_choices(signs, machine_of, lowest, exclusive, heat):
    if heat is not IDENTITY and lowest[1] == 1.0:
        pytest.skip("one heat law per building in this test")
    rng = np.random.default_rng(1)
    operator = random_building(rng, 2, signs, heat=heat)
    machinery = machinery_of(operator, machine_of, lowest_level=np.array(lowest), exclusive=exclusive)
    shape = ProblemShape(every_step(3), machinery, capped=True, held_steps=3)
    milp = MilpSolver(operator, shape, EXACT)
    relaxed = QPSolver(operator, replace(shape, held_steps=0), QPConfig())
    gained = []
    for _ in range(2):
        # A little too cold, and where the second actuator cools, its zone a little too warm.
        wanted = np.array([20.6, 24.4 if signs[1] < 0 else 20.7])[:, None]
        problem = random_building_problem(
            rng,
            operator,
            machinery,
            n=3,
            T_free_C=wanted + rng.uniform(-0.3, 0.3, (2, 3)),
            lower_C=np.full((2, 3), 21.0),
            forced_state_K=np.zeros((2, 2, 2)),
            power_cap=PowerCap(np.full(3, 2500.0), 1.0),
            terminal_price_per_K=np.zeros((2, 2, 2)),
            weights=Weights(1.0, 0.0),
        )
        solution, bound = milp.solve(problem), relaxed.solve(problem)
        assert solution.ok, solution.problem
        assert bound.ok, bound.problem
        best = best_choice(problem, operator)
        assert float(numpy_problem.cost(problem, operator, solution.u)) == pytest.approx(best, rel=1e-6)
        assert solution.gap <= 1e-6
        assert ((solution.u[machinery.held] == 0.0) | (solution.u[machinery.held] >= 0.3 - 1e-9)).all()
        gained.append(best - bound.cost)
    assert min(gained) > -1e-6
    assert max(gained) > 1e-3, "a choice that costs nothing tests nothing"


def test_the_first_level_is_one_the_machine_can_hold():
    rng = np.random.default_rng(0)
    operator = machine(rng)
    milp = solver(operator)
    problems = [random_problem(rng, 2, lowest=0.3, curvature=1e-6) for _ in range(15)]
    warmer = [replace(p, T_free_C=p.T_free_C + shift) for p, shift in zip(problems, np.linspace(0, 9, 15), strict=True)]
    seen = [milp.solve(problem).u[0, 0] for problem in warmer]
    assert all(u == 0.0 or 0.3 <= u <= 1.0 for u in seen)
    assert len(set(seen)) > 1


def test_two_steps_are_solved_as_well_as_by_trying_everything():
    rng = np.random.default_rng(2)
    operator = machine(rng)
    milp = solver(operator, held_steps=None, n_steps=2)
    for _ in range(8):
        problem = random_problem(rng, 2, lowest=0.3, n=2)
        levels = [0.0, *np.linspace(0.3, 1.0, 15)]
        brute = min(
            float(numpy_problem.cost(problem, operator, np.array([pair]))) for pair in itertools.product(levels, levels)
        )
        assert float(numpy_problem.cost(problem, operator, milp.solve(problem).u)) <= brute * (1 + 1e-6)


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


def test_without_choices_it_is_the_convex_optimum():
    rng = np.random.default_rng(7)
    operator, problem = single(random_operator(rng, 2)), random_problem(rng, 2)
    solution = MilpSolver(operator, ProblemShape(every_step(N)), EXACT).solve(problem)
    best = linear_programme_optimum(problem, operator)
    assert float(numpy_problem.cost(problem, operator, solution.u)) == pytest.approx(best, rel=1e-6)


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


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda r: replace(r, x=r.x + 0.5), "leaves its bounds"),
        (lambda r: replace(r, x=0.0 * r.x), "but its levels cost"),
        (lambda r: replace(r, x=np.nan * r.x), "not finite"),
        (lambda r: ChoiceResult(np.empty(0), "Time limit reached", 0, -np.inf), "Time limit reached and no plan"),
    ],
)
def test_an_answer_that_is_not_what_it_claims_is_refused(spoil, reason):
    rng = np.random.default_rng(4)
    operator, problem = machine(rng), random_problem(rng, 2, lowest=0.3)
    assert solver(operator).solve(problem).ok
    highs = Highs(EXACT)
    solution = solver(operator, choose=lambda *given: spoil(highs(*given))).solve(problem)
    assert (solution.ok, solution.u.size) == (False, 0)
    assert reason in solution.problem


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
