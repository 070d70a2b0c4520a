"""Held levels: off or a level is decided exactly in the first step."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from mpc_problems import N, random_operator, random_problem

from controllers.errors import ControllerConfigError
from controllers.problem import ProblemShape, every_step
from controllers.qp import QPSolver
from controllers.qp_backends import QPConfig
from controllers.semi_continuous import (
    SemiContinuousConfig,
    SemiContinuousSolver,
    after_first_step,
    first_step_cost,
    held_level,
)
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

HEAT = MachineLoad((1100.0, 30.0, 9000.0, 100.0), (-15.0, 20.0), lowest_level=0.3)


def machine(rng: np.random.Generator, order: int = 2):
    return replace(random_operator(rng, order), heat_input=HeatInput(heat=HEAT))


def solver(operator, n_steps: int = N, n_levels: int = 8) -> SemiContinuousSolver:
    shape = ProblemShape(every_step(n_steps), lowest_level=0.3)
    return SemiContinuousSolver(operator, shape, SemiContinuousConfig(n_levels=n_levels), QPConfig())


def test_the_first_level_is_one_the_machine_can_hold():
    rng = np.random.default_rng(0)
    operator = machine(rng)
    held = solver(operator)
    problems = [random_problem(rng, 2, lowest=0.3, curvature=1e-6) for _ in range(15)]
    warmer = [replace(p, T_free_C=p.T_free_C + shift) for p, shift in zip(problems, np.linspace(0, 9, 15), strict=True)]
    seen = [held.solve(problem).u[0] for problem in warmer]
    assert all(u == 0.0 or 0.3 <= u <= 1.0 for u in seen)
    assert len(set(seen)) > 1


def test_first_step_and_rest_together_are_the_whole_cost():
    rng = np.random.default_rng(1)
    operator = machine(rng)
    problem = random_problem(rng, 2, lowest=0.3, curvature=1e-6)
    u = rng.uniform(0.3, 1.0, N)
    parts = first_step_cost(problem, operator, u[0]) + after_first_step(problem, operator, u[0]).cost(operator, u[1:])
    assert parts == pytest.approx(float(problem.cost(operator, u)))


def test_two_steps_are_solved_as_well_as_by_trying_everything():
    """With one step left the rest is exact as well whenever it is off or full, so brute force cannot be much better."""
    rng = np.random.default_rng(2)
    operator = machine(rng)
    held = solver(operator, 2, n_levels=15)
    for _ in range(8):
        whole = random_problem(rng, 2, lowest=0.3)
        cut = {k: getattr(whole, k)[:2] for k in ("features", "T_free_C", "lower_C", "upper_C", "price_per_kWh")}
        power = {k: getattr(whole, k)[:2] for k in ("power_fixed_W", "power_per_u_W")}
        problem = replace(whole, **cut, **power)
        levels = [0.0, *np.linspace(0.3, 1.0, 15)]
        brute = min(float(problem.cost(operator, np.array(pair))) for pair in itertools.product(levels, levels))
        first = held.solve(problem).u[0]
        best = min(float(problem.cost(operator, np.array([first, second]))) for second in levels)
        assert best <= brute * 1.02 + 1e-9


@pytest.mark.parametrize("share", [0.0, 0.1, 0.35, 0.8, 1.0])
def test_a_held_level_brings_the_heat_of_the_share(share):
    T_out = np.array([-5.0, 3.0, 12.0])
    level = held_level(HeatInput(heat=HEAT), np.full(3, share), T_out, 1.0)
    np.testing.assert_allclose(HEAT(level, T_out), share * HEAT(np.ones(3), T_out), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(held_level(IDENTITY, np.full(3, share), T_out, 1.0), np.full(3, share))


def test_numbers_that_are_not_finite_are_a_failed_solve():
    rng = np.random.default_rng(3)
    solution = solver(machine(rng)).solve(replace(random_problem(rng, 2, lowest=0.3), T_free_C=np.full(N, np.nan)))
    assert (solution.ok, solution.u.size) == (False, 0)


def test_a_horizon_of_one_step_is_refused_with_advice():
    with pytest.raises(ControllerConfigError, match=r"single step here; give a longer controller\.options\.horizon_h"):
        solver(machine(np.random.default_rng(0)), 1)


@pytest.mark.parametrize("spoil", [lambda u: u + 0.5, lambda u: -u - 0.1])
def test_an_answer_that_is_not_what_it_claims_is_refused(monkeypatch, spoil):
    """The levels of the later steps come from shares; the quadratic programme's own check is behind them."""
    rng = np.random.default_rng(4)
    operator, problem = machine(rng), random_problem(rng, 2, lowest=0.3)
    held = solver(operator)
    assert held.solve(problem).ok
    found = QPSolver.solve

    def spoilt(self, problem, guess=None):
        solution = found(self, problem)
        return replace(solution, u=spoil(solution.u))

    monkeypatch.setattr(QPSolver, "solve", spoilt)
    solution = held.solve(problem)
    assert not solution.ok
    assert solution.u.size == 0
    assert solution.problem


def test_heat_that_does_not_grow_with_the_level_is_had_at_the_lowest():
    flat = MachineLoad((9000.0, 100.0, 0.0, 0.0), (-15.0, 20.0), lowest_level=0.3)
    T_out = np.array([-5.0, 3.0])
    level = held_level(HeatInput(heat=flat), np.array([1.0, 0.5]), T_out, 1.0)
    np.testing.assert_allclose(flat(level, T_out), np.array([1.0, 0.5]) * flat(np.ones(2), T_out))
