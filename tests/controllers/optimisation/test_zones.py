"""Several zones, actuators and machines in one plan: the optimum found another way, and what they share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem, random_operator, random_problem

from benchmarks.zones.scaling import building_operator
from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import EquipmentLayout, PowerCap, ProblemShape, Weights, blocked_moves, every_step
from controllers.optimisation.solution import SolverAnswer, checked
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from controllers.optimisation.statement.algebra import groups_of
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.parameters import linear_operator

SIGNS = (1, 1, 1, -1)
# Two heating actuators on one heat pump of limited capacity, a third on a boiler, and a chiller.
MACHINES, SHARES = (0, 0, 1, 2), np.array([0.7, 0.6, 0.0, 0.5])


def whole_problem(rng: np.random.Generator, **building):
    """Three zones with everything that a plan may hold: shared machine, cap, priced peak, weights per zone."""
    operator = random_building(rng, 3, SIGNS, **building)
    machinery = machinery_of(operator, MACHINES, share=SHARES)
    problem = random_building_problem(
        rng, operator, machinery, peak_so_far_W=1500.0, power_cap=PowerCap(np.full(N, 3000.0), 0.5)
    )
    problem = replace(problem, weights=replace(problem.weights, peak=2e-4))
    shape = ProblemShape(blocked_moves(N, 3600.0, 6.0, 2.0), machinery, peak=True, capped=True)
    return operator, problem, shape


def permuted(operator: BuildingOperator, zones: list[int], actuators: list[int]) -> BuildingOperator:
    return BuildingOperator(
        tuple(operator.zones[z] for z in zones),
        tuple(operator.actuators[a] for a in actuators),
        tuple(tuple(operator.pairs[z][a] for a in actuators) for z in zones),
        tuple(zones.index(operator.home[a]) for a in actuators),
    )


def test_the_order_of_zones_actuators_and_machines_does_not_change_the_plan():
    rng = np.random.default_rng(3)
    operator, problem, shape = whole_problem(rng)
    zones, actuators, machines = [2, 0, 1], [3, 1, 0, 2], [1, 2, 0]
    other = permuted(operator, zones, actuators)
    m = problem.machinery
    machinery = EquipmentLayout(
        other.actuators,
        tuple(m.machines[i] for i in machines),
        m.u_max[actuators],
        m.lowest_level[actuators],
        m.u_min[actuators],
        np.array([machines.index(m.machine_of[a]) for a in actuators]),
        m.share[actuators],
    )
    turned = replace(
        problem,
        **{name: getattr(problem, name)[zones] for name in ("features", "T_free_C", "lower_C", "upper_C")},
        forced_state_K=problem.forced_state_K[np.ix_(zones, actuators)],
        **{name: getattr(problem, name)[machines] for name in ("price_per_kWh", "power_fixed_W")},
        power_per_u_W=problem.power_per_u_W[actuators],
        machinery=machinery,
        weights=replace(problem.weights, comfort=np.asarray(problem.weights.comfort)[zones]),
    )
    ours = QPSolver(operator, shape, QPConfig()).solve(problem)
    theirs = QPSolver(other, replace(shape, machinery=machinery), QPConfig()).solve(turned)
    assert ours.ok, ours.problem
    assert theirs.ok, theirs.problem
    assert float(numpy_problem.cost(turned, other, theirs.u)) == pytest.approx(
        float(numpy_problem.cost(problem, operator, ours.u)), rel=1e-7
    )
    np.testing.assert_allclose(theirs.u, ours.u[actuators], atol=1e-3)


def test_zones_that_share_nothing_are_planned_as_if_alone():
    rng = np.random.default_rng(4)
    operator = random_building(rng, 3, (1, 1, 1), reach=0.0)
    machinery = machinery_of(operator, (0, 1, 2))
    problem = random_building_problem(rng, operator, machinery)
    together = QPSolver(operator, ProblemShape(every_step(N), machinery), QPConfig()).solve(problem)
    assert together.ok, together.problem
    for z in range(3):
        pair, one = operator.pairs[z][z], slice(z, z + 1)
        assert pair is not None
        rows = ("features", "T_free_C", "lower_C", "upper_C", "price_per_kWh", "power_fixed_W", "power_per_u_W")
        alone = replace(
            problem,
            **{name: getattr(problem, name)[one] for name in rows},
            forced_state_K=problem.forced_state_K[one, one],
            machinery=EquipmentLayout.one(),
            weights=Weights(float(np.asarray(problem.weights.comfort)[z]), 1e-6),
        )
        solution = QPSolver(single(pair), ProblemShape(every_step(N)), QPConfig()).solve(alone)
        np.testing.assert_allclose(together.u[z], solution.u[0], atol=1e-4)


@pytest.mark.slow
def test_zones_may_differ_in_order():
    rng = np.random.default_rng(20)
    n, hours = 192, ((40.0,), (0.5, 4.0, 40.0))
    poles = [np.exp(-0.25 / np.array(taus)) for taus in hours]
    slab, air = (linear_operator(a, 4.0 * (1.0 - a), step_s=900.0) for a in poles)
    operator = BuildingOperator(("bath", "study"), ("actuator 0", "actuator 1"), ((slab, None), (None, air)), (0, 1))
    machinery = machinery_of(operator, (0, 1))
    problem = random_building_problem(rng, operator, machinery, n=n, step_s=900.0)
    for moves in (every_step(n), blocked_moves(n, 900.0, 12.0, 1.0)):
        shape = ProblemShape(moves, machinery)
        ours = QPSolver(operator, shape, QPConfig()).solve(problem)
        best = IpoptSolver(operator, shape, IpoptConfig(tolerance=1e-10)).solve(problem)
        assert ours.optimal, ours.problem
        assert ours.cost == pytest.approx(best.cost, rel=1e-6)


def test_a_shared_machine_runs_as_long_as_the_longest_and_pays_its_fixed_part_once():
    rng = np.random.default_rng(5)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 0), share=np.array([0.9, 0.8]))
    problem = random_building_problem(rng, operator, machinery)
    u = np.zeros((2, N))
    u[:, 0], u[:, 1] = (0.6, 0.2), (0.5, 0.6)
    per_u = (problem.power_per_u_W * u).sum(axis=0)
    np.testing.assert_allclose(
        numpy_problem.running(problem, u)[0, :3], [0.9 * 0.6 + 0.8 * 0.2, 0.9 * 0.5 + 0.8 * 0.6, 0.0]
    )
    np.testing.assert_allclose(
        numpy_problem.power_W(problem, u)[0], problem.power_fixed_W[0] * numpy_problem.running(problem, u)[0] + per_u
    )
    unlimited = replace(problem, machinery=machinery_of(operator, (0, 0)))
    np.testing.assert_allclose(numpy_problem.running(unlimited, u)[0, :3], [0.6, 0.6, 0.0])


def test_a_shared_machine_cycles_below_its_lowest_load():
    rng = np.random.default_rng(5)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 0), share=np.array([0.2, 0.3]), cycles_below=(0.4,))
    problem = random_building_problem(rng, operator, machinery)
    u = np.zeros((2, N))
    u[:, 0], u[:, 1], u[:, 2] = (1.0, 0.2), (0.5, 1.0), (1.0, 1.0)
    # Both open: above its lowest load. One alone asks for 0.2 / 0.4 or 0.3 / 0.4 of the time.
    np.testing.assert_allclose(numpy_problem.running(problem, u)[0, :4], [0.2 + 0.8 * 0.5, 0.5 + 0.5 * 0.75, 1.0, 0.0])
    # Where it does not cycle, it runs for the longest of them.
    in_full = replace(problem, machinery=machinery_of(operator, (0, 0), share=machinery.share))
    np.testing.assert_allclose(numpy_problem.running(in_full, u)[0, :4], [1.0, 1.0, 1.0, 0.0])


def test_a_machine_of_one_actuator_needs_no_variable_of_its_own():
    rng = np.random.default_rng(6)
    operator = random_building(rng, 2, (1, 1))
    own = PlanModel(operator, ProblemShape(every_step(N), machinery_of(operator, (0, 1))))
    shared = PlanModel(operator, ProblemShape(every_step(N), machinery_of(operator, (0, 0))))
    alone = PlanModel(single(random_operator(rng, 3)), ProblemShape(every_step(N)))
    assert (own.n_variables, shared.n_variables, alone.n_variables) == (8 * N, 9 * N, 4 * N)


def test_capacity_is_kept_where_it_would_be_exceeded():
    rng = np.random.default_rng(7)
    operator = random_building(rng, 2, (1, 1))
    limited = machinery_of(operator, (0, 0), share=np.array([0.8, 0.8]))
    problem = random_building_problem(rng, operator, limited)
    solution = QPSolver(operator, ProblemShape(every_step(N), limited), QPConfig()).solve(problem)
    free = machinery_of(operator, (0, 0))
    unlimited = QPSolver(operator, ProblemShape(every_step(N), free), QPConfig()).solve(
        replace(problem, machinery=free)
    )
    assert (0.8 * solution.u.sum(axis=0)).max() <= 1.0 + 1e-6
    assert (0.8 * unlimited.u.sum(axis=0)).max() > 1.2
    model, cost = PlanModel(operator, ProblemShape(every_step(N), limited)), unlimited.cost
    p = model.numbers(problem)
    refused = checked(model, problem, p, SolverAnswer(model.evaluate(p, unlimited.u).variables, cost, "ok", 1))
    assert "capacity of machine 0" in refused.problem


def test_power_above_the_cap_is_bought_only_where_comfort_is_worth_it():
    rng = np.random.default_rng(8)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1))
    problem = random_building_problem(rng, operator, machinery)
    free = QPSolver(operator, ProblemShape(every_step(N), machinery), QPConfig()).solve(problem)
    limit = 0.5 * numpy_problem.power_W(problem, free.u).sum(axis=0).max()
    shape = ProblemShape(every_step(N), machinery, capped=True)
    over = []
    for price in (0.1, 100.0):
        capped = replace(problem, power_cap=PowerCap(np.full(N, limit), price))
        solution = QPSolver(operator, shape, QPConfig()).solve(capped)
        assert solution.ok, solution.problem
        over.append(np.maximum(numpy_problem.power_W(problem, solution.u).sum(axis=0) - limit, 0.0).sum())
    assert over[0] > 100.0
    assert over[1] < 0.01 * over[0]


def test_messages_name_the_actuator():
    rng = np.random.default_rng(11)
    operator = random_building(rng, 2, (1, 1))
    problem = random_building_problem(rng, operator, machinery_of(operator, (0, 1)))
    u = np.zeros((2, N))
    u[1, 3] = 1.5
    model = PlanModel(operator, ProblemShape(every_step(N), problem.machinery))
    p = model.numbers(problem)
    solution = checked(model, problem, p, SolverAnswer(model.evaluate(p, u).variables, 0.0, "ok", 1))
    assert "u of actuator 1 leaves its bounds" in solution.problem
    with pytest.raises(DataError, match=r"2 zones, 2 actuators and 2 machines over 12 steps: price_per_kWh has shape"):
        replace(problem, price_per_kWh=problem.price_per_kWh[0])
    with pytest.raises(DataError, match=r"weights\.comfort has shape \(3,\)"):
        replace(problem, weights=Weights(np.ones(3), 0.0))
    with pytest.raises(ControllerConfigError, match="actuator 0: levels from 0 to -1"):
        replace(problem.machinery, u_max=np.array([-1.0, 1.0]))
    with pytest.raises(
        ControllerConfigError, match=r"actuator 0: a level that heats and cools .* does not switch below"
    ):
        replace(problem.machinery, u_min=np.array([-1.0, 0.0]), lowest_level=np.array([0.3, 1.0]))
    with pytest.raises(ControllerConfigError, match=r"actuator 1: it shares machine machine 0, so it cannot hold"):
        machinery_of(operator, (0, 0), lowest_level=np.array([1.0, 0.3]))
    turned = replace(problem.machinery, actuators=("actuator 1", "actuator 0"))
    with pytest.raises(ControllerConfigError, match="same in the same order"):
        QPSolver(operator, ProblemShape(every_step(N), turned), QPConfig())


def test_one_zone_is_solved_as_in_arrays_of_length_one():
    """Two machines of half the power each that feed one zone are one machine."""
    rng = np.random.default_rng(12)
    pair = random_operator(rng, 2)
    problem = random_problem(rng, 2, curvature=1e-6)
    half = replace(pair, gains=0.5 * pair.gains)
    twice = BuildingOperator(("zone",), ("left", "right"), ((half, half),), (0, 0))
    both = {name: np.repeat(0.5 * getattr(problem, name), 2, axis=0) for name in ("power_fixed_W", "power_per_u_W")}
    machinery = machinery_of(twice, (0, 1))
    split = replace(
        problem,
        **both,
        price_per_kWh=np.repeat(problem.price_per_kWh, 2, axis=0),
        forced_state_K=np.repeat(0.5 * problem.forced_state_K, 2, axis=1),
        machinery=machinery,
    )
    whole = QPSolver(single(pair), ProblemShape(every_step(N)), QPConfig()).solve(problem)
    halves = QPSolver(twice, ProblemShape(every_step(N), machinery), QPConfig()).solve(split)
    assert halves.ok, halves.problem
    np.testing.assert_allclose(halves.u, np.repeat(whole.u, 2, axis=0), atol=1e-3)


@pytest.mark.parametrize(("n_zones", "neighbours", "acting"), [(10, 2, 10), (20, 2, 5), (20, 4, 20), (5, 0, 1)])
def test_a_pattern_is_filled_only_where_that_is_faster(n_zones: int, neighbours: int, acting: int):
    """PIQP took 51 ms for ten rooms as they are, 26 filled; for twenty 100 and 163."""
    operator = building_operator(n_zones, neighbours, np.random.default_rng(0))
    for group in groups_of(operator, 84, power_couples=True):
        assert group.actuators.size == acting
        np.testing.assert_array_equal(operator.gains[group.zone, group.actuators], group.gains)
