"""No solver calls levels the optimum that are none: at extremes of the weights, and on problems that are hard."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem, random_operator, random_problem
from structures import CASES, instance

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape, Weights, every_step
from controllers.optimisation.solution import Solution, Solver, SolverAnswer, checked
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.milp import MilpConfig, MilpSolver
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from controllers.optimisation.solvers.sqp import SQPConfig, SQPSolver
from controllers.optimisation.statement.terms import PlanExpressions
from thermoforce_mpc.model.operator.building import BuildingOperator, single


def solvers(operator: BuildingOperator, shape: ProblemShape) -> dict[str, Solver]:
    """Those that take the problem, each with Ipopt behind it, and PIQP alone."""
    ipopt = lambda: IpoptSolver(operator, shape, IpoptConfig())  # noqa: E731
    build: dict[str, Callable[[], Solver]] = {
        "ipopt": ipopt,
        "piqp alone": lambda: QPSolver(operator, shape, QPConfig()),
        "qp": lambda: QPSolver(operator, shape, QPConfig(), ipopt),
        "sqp": lambda: SQPSolver(operator, shape, SQPConfig(), fallback=ipopt),
        "milp": lambda: MilpSolver(operator, shape, MilpConfig(gap=0.0), fallback=ipopt),
    }
    found = {}
    for name, make in build.items():
        try:
            found[name] = make()
        except ControllerConfigError:
            continue
    return found


def but_discomfort(solution: Solution) -> float:
    assert solution.evaluation is not None
    return sum(map(abs, solution.evaluation.parts.values())) - solution.evaluation.parts["discomfort"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one zone", "several", "peak", "signed", "stepped", "everything convex"])
@pytest.mark.parametrize("weight", [1e-4, 1.0, 1e4, 1e6, 1e8])
def test_an_optimum_is_one_whatever_comfort_weighs(name, weight):
    """PIQP and Ipopt, left alone, called plans optimal whose energy was several times as dear."""
    operator, problem, shape = instance(CASES[name], np.random.default_rng(1))
    comfort = weight * np.asarray(problem.weights.comfort)
    problem = replace(problem, weights=replace(problem.weights, comfort=comfort))
    answers = {solver: each.solve(problem) for solver, each in solvers(operator, shape).items()}
    assert all(answer.ok for solver, answer in answers.items() if solver != "piqp alone"), answers
    assert all(answer.optimal for solver, answer in answers.items() if solver != "piqp alone"), answers
    least = min(answer.cost for answer in answers.values() if answer.ok)
    for solver, answer in answers.items():
        if answer.ok and answer.optimal:
            assert answer.cost <= least + 1e-3 * but_discomfort(answer) + 1e-5 * abs(weight) + 1e-7, solver
        else:
            assert answer.problem


def either() -> tuple[BuildingOperator, MPCProblem, ProblemShape]:
    """Of two zones one is heated at a time, for little comfort that can be had at small cost."""
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    problem = random_building_problem(rng, operator, machinery_of(operator, (0, 1), exclusive=((0, 1),)))
    free, low = np.full((2, N), 21.6), np.full((2, N), 21.0)
    free[:, 8:10] = 21.3
    free[0, 9:], free[1, 10:] = 20.9, 20.85
    at_rest = np.zeros_like(problem.forced_state_K)
    problem = replace(problem, T_free_C=free, lower_C=low, upper_C=np.full((2, N), 30.0), forced_state_K=at_rest)
    return operator, problem, ProblemShape(every_step(N), problem.machinery, chosen_steps=N)


@pytest.mark.parametrize("weight", [1.0, 1e5, 1e6, 1e8])
def test_choices_look_at_prices_whatever_comfort_weighs(weight):
    """At 1e6 times the usual the plan was four times as dear, "optimal, gap 0"."""
    operator, problem, shape = either()
    heavy = replace(problem, weights=replace(problem.weights, comfort=weight * np.asarray(problem.weights.comfort)))
    found = MilpSolver(operator, shape, MilpConfig(gap=0.0)).solve(heavy)
    assert found.optimal, found.problem
    assert PlanModel(operator, shape).brings(problem, found.u).cost == pytest.approx(0.2420, abs=1e-3)


@pytest.mark.parametrize("weight", [0.02, 5.0, 221.0, 1e5])
def test_all_off_is_a_plan_whatever_comfort_weighs(weight):
    """A bound that Ipopt relaxes by 1e-8 is worth 2e-4 where a K·h weighs 221: no reason to refuse levels of 0."""
    rng = np.random.default_rng(0)
    operator = single(random_operator(rng, 2))
    problem = random_problem(rng, 2, n=96)
    warm = replace(problem, T_free_C=np.full((1, 96), 22.0), upper_C=np.full((1, 96), 40.0))
    warm = replace(warm, weights=Weights(weight, 1e-6), forced_state_K=0.0 * problem.forced_state_K)
    for name, solver in solvers(operator, ProblemShape(every_step(96))).items():
        found = solver.solve(warm)
        assert found.ok, (name, found.problem)
        assert found.optimal or name == "piqp alone", (name, found.problem)
        assert found.u.max() < 1e-5
        assert found.cost == pytest.approx(0.0, abs=1e-3)


def test_a_claim_may_be_off_by_what_bounds_relaxed_are_worth_and_by_no_more():
    rng = np.random.default_rng(0)
    operator = single(random_operator(rng, 2))
    shape = ProblemShape(every_step(96))
    problem = random_problem(rng, 2, n=96)
    off = np.zeros((1, 96))
    for weight in (221.0, 5.0):
        warm = replace(problem, T_free_C=np.full((1, 96), 22.0), upper_C=np.full((1, 96), 40.0))
        warm = replace(warm, weights=Weights(weight, 0.0), forced_state_K=0.0 * problem.forced_state_K)
        model = PlanModel(operator, shape)
        p = model.numbers(warm)
        x = model.evaluate(p, off).variables
        relaxed = -2e-8 * weight * 96
        assert checked(model, warm, p, SolverAnswer(x, relaxed, "ipopt", 1)).ok
        assert "its levels cost" in checked(model, warm, p, SolverAnswer(x, -1e-3 * weight, "ipopt", 1)).problem


def scaled_J(plan: PlanExpressions) -> None:
    """Energy in J beside power in W."""
    energy = plan.variable("energy_J", plan.u.shape[1], 0.0, 1e9)
    plan.equal(energy - ca.sum1(plan.power_W) * plan.step_s)
    plan.add_cost(1e-9 * energy)


def tiny(plan: PlanExpressions) -> None:
    """A variable of 1e-6 that costs 1e6."""
    share = plan.variable("tiny", plan.u.shape[1], 0.0, 1.0)
    plan.require(share * 1e6 - ca.sum1(plan.u))
    plan.add_cost(1e6 * share)


def rows_of_one_kind(factor: float) -> Callable[[PlanExpressions], None]:
    def add(plan: PlanExpressions) -> None:
        total = plan.variable("total", 1, 0.0, 10.0)
        for i in range(4):
            plan.require(0.9 - plan.u[0, :])
            plan.equal(total - (1.0 + i * factor) * ca.sum2(plan.u[0, :]))

    return add


def contradiction(plan: PlanExpressions) -> None:
    plan.require(plan.u[0, 2] - 0.6, "a level of 0.6")
    plan.require(0.4 - plan.u[0, 2], "a level of 0.4")


# What a term does to the problem, and how it is answered: a plan, levels without the claim, or none.
HARD: dict[str, tuple[Callable[[PlanExpressions], None], str]] = {
    "infeasible": (lambda plan: plan.require(plan.u[0, 0] - 1.5, "a level of 1.5"), "none"),
    "contradiction": (contradiction, "none"),
    "unbounded": (lambda plan: plan.add_cost(-plan.variable("free", 3, 0.0, np.inf)), "no optimum"),
    "concave": (lambda plan: plan.add_cost(-2.0 * plan.u**2), "no optimum"),
    "indefinite": (lambda plan: plan.add_cost(5.0 * plan.u[:, 1:] * plan.u[:, :-1]), "no optimum"),
    "joules beside watts": (scaled_J, "plan"),
    "tiny": (tiny, "plan"),
    "duplicated": (rows_of_one_kind(0.0), "plan"),
    "nearly dependent": (rows_of_one_kind(1e-10), "plan"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HARD)
def test_a_hard_problem_is_answered_soon_and_truly(name):
    term, expected = HARD[name]
    operator, problem, shape = instance(CASES["several"], np.random.default_rng(1))
    problem = replace(problem, last_u=np.zeros(len(operator.actuators)))
    answers = {}
    for solver, each in solvers(operator, replace(shape, terms=(term,))).items():
        begun = time.perf_counter()
        answers[solver] = each.solve(problem)
        assert time.perf_counter() - begun < 5.0, solver
        assert answers[solver].problem or answers[solver].optimal
    if expected == "none":
        assert not any(answer.ok for answer in answers.values())
    elif expected == "no optimum":
        assert not any(answer.ok and answer.optimal for answer in answers.values()), answers
    else:
        best = answers["ipopt"].cost
        for solver, answer in answers.items():
            if solver != "piqp alone":
                assert answer.ok, (solver, answer.problem)
            if answer.ok and answer.optimal:
                assert answer.cost == pytest.approx(best, rel=1e-4), solver


COEXIST = """
import sys
import highspy
highs = highspy.Highs()
highs.setOptionValue("output_flag", False)
column = highs.addVariable(0.0, 1.0, -1.0)
highs.changeColIntegrality(0, highspy.HighsVarType.kInteger)
highs.setOptionValue("threads", 2)
highs.run()
sys.path[:0] = {folders}
import numpy as np
from structures import CASES, instance
from test_optima_are_shown import solvers
for name in ("several", "exclusive", "feedback"):
    operator, problem, shape = instance(CASES[name], np.random.default_rng(1))
    for solver, each in solvers(operator, shape).items():
        found = each.solve(problem)
        assert found.ok and found.optimal, (name, solver, found.problem)
        print(name, solver, found.status)
from scipy.optimize import linprog
least = linprog([1.0], bounds=[(1.0, 2.0)], method="highs").fun
print(least, "libcasadi_conic_highs" in open("/proc/self/maps").read())
"""


@pytest.mark.slow
def test_every_solver_solves_in_a_process_that_has_used_highspy():
    """CasADi's HiGHS died there, since both wheels bring a library of one name: it is not loaded."""
    script = COEXIST.format(folders=[path for path in sys.path if path])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.split("\n")
    assert sum(line.startswith("several") for line in said) == 5
    assert "exclusive milp highs:Optimal, gap 0" in said
    assert said[-2] == "1.0 False"
