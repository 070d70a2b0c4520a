"""The statement against a second one in numpy, on random instances of every structure."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from structures import CASES, Case, instance, random_levels

from controllers.optimisation.plan_model import Evaluation, PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

EACH = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
Drawn = tuple[BuildingOperator, MPCProblem, ProblemShape, PlanModel, np.random.Generator]


def drawn(case: Case, instances: int = 2) -> Iterator[Drawn]:
    """Random instances with their model."""
    for seed in range(instances):
        rng = np.random.default_rng(seed)
        operator, problem, shape = instance(case, rng)
        yield operator, problem, shape, PlanModel(operator, shape), rng


def is_numpys(found: Evaluation, problem: MPCProblem, operator: BuildingOperator, u: Array) -> None:
    forced = numpy_problem.forced_K(problem, operator, u)
    expected = {
        "cost": numpy_problem.cost(problem, operator, u),
        "energy_cost": numpy_problem.energy_cost(problem, u),
        "power_W": numpy_problem.power_W(problem, u),
        "forced_K": forced,
        "slack_K": numpy_problem.slack_K(problem, problem.T_free_C + forced),
        "running": numpy_problem.running(problem, u),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
@EACH
def test_levels_cost_and_bring_what_numpy_says(case):
    for operator, problem, shape, programme, rng in drawn(case):
        model = programme.by_steps
        for _ in range(5):
            u = random_levels(rng, problem, shape)
            found = model.evaluate(model.numbers(problem), u)
            assert not found.broken
            is_numpys(found, problem, operator, u)


@pytest.mark.slow
@EACH
def test_a_longer_step_is_its_control_steps_where_they_are_alike(case):
    """Energy, and temperatures at its end; what varies within it is taken as its mean."""
    for _, problem, shape, model, rng in drawn(case):
        first, of = shape.first_steps, shape.move_of_step
        names = ["price_per_kWh", "power_fixed_W", "power_per_u_W"] + ["power_per_u2_W"] * (
            problem.power_per_u2_W is not None
        )
        alike = {name: getattr(problem, name)[:, first][:, of] for name in names}
        alike["features"] = problem.features[:, first][:, of]
        if problem.cooling is not None:
            cooling = (value[:, first][:, of] for value in vars(problem.cooling).values())
            alike["cooling"] = type(problem.cooling)(*cooling)
        if problem.exchange is not None:
            alike["exchange"] = type(problem.exchange)(*(row[first][of] for row in vars(problem.exchange).values()))
        problem, by_steps = replace(problem, **alike), model.by_steps
        u = random_levels(rng, problem, shape)
        found = model.evaluate(model.numbers(problem), u)
        fine = by_steps.evaluate(by_steps.numbers(problem), u)
        assert found.energy_cost.sum() == pytest.approx(fine.energy_cost.sum(), rel=1e-9)
        if not model.structure.hidden:  # a gain that sees the plan changes within a longer step
            ends = np.append(first[1:], shape.n_steps) - 1
            np.testing.assert_allclose(found.forced_K, fine.forced_K[:, ends], atol=1e-9)


@pytest.mark.slow
@EACH
def test_levels_start_a_solver_with_all_variables_and_the_cost_of_the_check(case):
    """Every equation holds, every inequality and bound is kept, and the levels come back."""
    for _, problem, shape, model, rng in drawn(case):
        p = model.numbers(problem)
        for _ in range(5):
            u = random_levels(rng, problem, shape)
            x = model.evaluate(p, u).variables
            programme = model.local(p, x)
            np.testing.assert_allclose(programme.b, 0.0, atol=1e-9)
            assert programme.low.max(initial=0.0) <= 1e-9
            assert (np.maximum(programme.x_low, -programme.x_high) <= 1e-9).all()
            cost = model.evaluate(p, u).cost
            assert programme.constant == pytest.approx(cost, rel=1e-9, abs=1e-9)
            np.testing.assert_allclose(model.levels(x), u, atol=1e-12)


@EACH
def test_convex_is_what_is_convex(case):
    _, _, _, model, _ = next(drawn(case))
    assert model.convex is case.convex
    assert bool(model.choices.size) is bool("exclusive" in case.machinery)


@EACH
def test_what_leaves_a_limit_is_said(case):
    """Full level or full cooling of all actuators, while it is decided which of them acts and later."""
    for _, problem, shape, model, _ in drawn(case, 1):
        m, p, early = problem.machinery, model.numbers(problem), shape.move_of_step < shape.n_chosen_moves
        capacity = np.ones((len(m.machines), early.size)) if problem.capacity is None else problem.capacity
        for levels, steps in itertools.product((m.u_max, np.where(m.u_min < 0.0, m.u_min, m.u_max)), (early, ~early)):
            u = levels[:, None] * steps
            over = np.flatnonzero((m.fed_by @ (m.share[:, None] * np.maximum(u, 0.0)) > capacity).any(axis=1))
            limits = [f"the capacity of {m.machines[i]}" for i in over]
            limits += ["exclude one another"] * bool(m.exclusive and steps.any())
            broken = model.evaluate(p, u).broken
            assert any(limit in broken for limit in limits) if limits else broken == ""
