"""A machine whose water the plan sets: valves that share it, and power that grows faster than heat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.checks import ControllerConfigError
from controllers.monitoring.watch import level_fault
from controllers.optimisation.problem import Cooling, PowerCap, ProblemShape, every_step
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from controllers.optimisation.solvers.sqp import SQPConfig, SQPSolver
from controllers.registry import controller_config
from thermoforce_mpc.data import Layout, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.testcases import load_testcase

STEP_S = 900.0


def valves() -> Actuators:
    names = Names(("a", "b"), ("valve a", "valve b"), ("heat pump",))
    layout = Layout(names, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (20.0, 20.0))
    config = ActuationConfig(mode="supply", lowest_level=0.2)
    return Actuators(layout, [Actuation(config)] * 2)


@pytest.mark.parametrize(
    ("asked", "levels"),
    [
        ((0.6, 0.5), (0.6, 0.6)),
        ((0.6, 0.2), (0.6, 0.0)),
        ((0.15, 0.15), (0.2, 0.2)),
        ((0.05, 0.0), (0.0, 0.0)),
        ((0.0, 0.0), (0.0, 0.0)),
        ((1.0, None), (1.0, None)),
    ],
    ids=str,
)
def test_open_valves_share_the_water_that_the_neediest_asks_for(asked, levels):
    acted = valves().realise(asked, STEP_S, (ActuationState(), ActuationState()))
    assert [(block.u, block.duration_s) for block in acted.together()] == [(levels, STEP_S)]


def test_in_a_longer_step_a_valve_that_asks_for_less_is_open_for_its_share():
    states = (ActuationState(on=True), ActuationState(on=True))
    blocks = valves().realise((0.8, 0.4), 3600.0, states).together()
    assert [(block.u, block.duration_s) for block in blocks] == [((0.8, 0.8), 1800.0), ((0.8, 0.0), 1800.0)]


def test_valves_of_such_a_machine_are_run_that_way_unless_something_else_is_named():
    apartment = load_testcase("twozone_apartment_hydronic")
    assert controller_config("thermoforce_mpc", {}, apartment).actuation.mode == "supply"
    assert controller_config("pi", {}, apartment).actuation.mode == "supply"
    named = controller_config("thermoforce_mpc", {"actuation": {"mode": "duty"}}, apartment)
    assert named.actuation.mode == "duty"
    other = load_testcase("house:3rooms")
    with pytest.raises(ControllerConfigError, match="mode: supply"):
        controller_config("thermoforce_mpc", {"actuation": {"mode": "supply"}}, other)


def curved_problem(rng: np.random.Generator):
    operator = random_building(rng, 2, (1, 1))
    problem = random_building_problem(rng, operator, machinery_of(operator, (0, 0), share=np.array([0.6, 0.6])))
    # Zones that a moderate level holds inside the band, so that cost is mostly energy.
    problem = replace(problem, T_free_C=np.full((2, N), 15.0), lower_C=np.full((2, N), 17.0))
    return operator, replace(problem, power_per_u2_W=np.repeat(rng.uniform(500.0, 1500.0, (2, 1)), N, axis=1))


def test_no_other_levels_cost_less_where_power_grows_faster_than_heat():
    rng = np.random.default_rng(4)
    operator, problem = curved_problem(rng)
    solution = QPSolver(operator, ProblemShape(every_step(N), problem.machinery), QPConfig()).solve(problem)
    assert solution.ok, solution.problem
    best = float(numpy_problem.cost(problem, operator, solution.u))
    others = np.clip(solution.u + rng.normal(0.0, 0.1, (300, 2, N)) * (rng.random((300, 1, N)) < 0.1), 0.0, 1.0)
    others *= np.minimum(1.0, 1.0 / (0.6 * others.sum(axis=1, keepdims=True) + 1e-9))
    assert numpy_problem.cost(problem, operator, others).min() >= best * (1.0 - 1e-6)
    straight = replace(problem, power_per_u2_W=None, power_per_u_W=problem.power_per_u_W + problem.power_per_u2_W)
    flat = QPSolver(operator, ProblemShape(every_step(N), problem.machinery), QPConfig()).solve(straight)
    assert best < 0.999 * float(numpy_problem.cost(problem, operator, flat.u)), "levels are spread over time"


def test_power_that_grows_faster_than_heat_is_that_of_heating():
    rng = np.random.default_rng(4)
    operator, problem = curved_problem(rng)
    machinery = replace(problem.machinery, u_min=np.array([-1.0, 0.0]), share=np.zeros(2))
    cooling = Cooling(np.full((2, N), 0.2), np.full((2, N), 900.0))
    signed = replace(problem, machinery=machinery, cooling=cooling, T_free_C=np.full((2, N), 30.0))
    solution = QPSolver(operator, ProblemShape(every_step(N), machinery), QPConfig()).solve(signed)
    assert solution.ok, solution.problem
    assert solution.u[0].min() < -0.5
    cold = np.minimum(solution.u, 0.0)
    np.testing.assert_allclose(
        numpy_problem.power_W(signed, cold), numpy_problem.power_W(replace(signed, power_per_u2_W=None), cold)
    )


@pytest.mark.parametrize("solver", [IpoptSolver, SQPSolver])
def test_a_cap_sees_power_that_grows_faster_than_heat(solver):
    rng = np.random.default_rng(4)
    operator, problem = curved_problem(rng)
    options = IpoptConfig() if solver is IpoptSolver else SQPConfig()
    shape = ProblemShape(every_step(N), problem.machinery, capped=True, curved=True)
    free = solver(operator, replace(shape, capped=False), options).solve(problem)
    limit_W = 0.8 * numpy_problem.power_W(problem, free.u).sum(axis=0).max()
    capped = replace(problem, power_cap=PowerCap(np.full(N, limit_W), 50.0))
    solution = solver(operator, shape, options).solve(capped)
    assert solution.ok, solution.problem
    assert numpy_problem.power_W(capped, solution.u).sum(axis=0).max() <= limit_W + 1.0
    assert solution.cost == pytest.approx(float(numpy_problem.cost(capped, operator, solution.u)))
    blind = QPSolver(operator, replace(shape, curved=False), QPConfig())
    with pytest.raises(DataError, match="part in u², which its shape"):
        blind.solve(capped)
    with pytest.raises(ControllerConfigError, match="not convex"):
        QPSolver(operator, shape, QPConfig())


@pytest.mark.parametrize(("measured", "fault"), [((0.62, 0.02), False), ((0.0, 0.0), True)], ids=["swings", "stuck"])
def test_a_level_that_swings_about_what_was_asked_for_is_no_fault(measured, fault):
    n = 32
    asked = [(k * STEP_S, 0.32) for k in range(n)]
    u = np.resize(np.array(measured), n)
    edges = np.arange(n + 1) * STEP_S
    history = Record(edges, np.full(n + 1, 21.0), np.zeros(n + 1), np.zeros(n + 1), u, np.zeros(n), np.zeros(n))
    assert bool(level_fault(asked, history)) is fault
    assert level_fault(asked, history.last(0)) == "", "nothing was measured yet"
