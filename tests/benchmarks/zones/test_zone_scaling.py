"""The script of solve times over the number of zones solves what it times, and fits its exponent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from in_do_mpc import do_mpc_cost

from benchmarks.zones.do_mpc_building import DoMpcBuilding
from benchmarks.zones.scaling import building_operator, building_problem, exponent, solve_times
from controllers.optimisation.problem import MPCProblem, PowerCap, ProblemShape, every_step
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from thermoforce_mpc.errors import DataError


def shortened(problem: MPCProblem, n: int) -> MPCProblem:
    """The instance's first `n` steps."""
    steps = ("T_free_C", "lower_C", "upper_C", "price_per_kWh", "power_fixed_W", "power_per_u_W")
    parts = {name: getattr(problem, name)[:, :n] for name in steps}
    cap = PowerCap(problem.power_cap.limit_W[:n], problem.power_cap.price_per_kWh)
    return replace(problem, **parts, features=problem.features[:, :n], power_cap=cap)


def test_the_exponent_is_the_slope_of_log_time():
    assert exponent({1: 2.0, 2: 4.0, 8: 16.0}) == pytest.approx(1.0)
    assert exponent({1: 1.0, 10: 100.0}) == pytest.approx(2.0)


def test_buildings_are_solved_at_every_size():
    seconds = solve_times((1, 2), neighbours=1, instances=1)
    assert set(seconds) == {1, 2}
    assert all(0.0 < value < 10.0 for value in seconds.values())


def test_neighbours_are_reached_and_no_one_else():
    rng = np.random.default_rng(0)
    operator = building_operator(5, 1, rng)
    assert [pair is not None for pair in operator.pairs[0]] == [True, True, False, False, True]
    problem = building_problem(operator, rng)
    assert (problem.T_free_C.shape, problem.price_per_kWh.shape) == ((5, 192), (1, 192))


@pytest.mark.slow
@pytest.mark.parametrize("modes_shared", [False, True])
def test_do_mpc_finds_the_same_optimum_of_a_building_and_levels_cost_there_the_same(modes_shared):
    pytest.importorskip("do_mpc", reason="extra [bench]", exc_type=ImportError)
    rng = np.random.default_rng(0)
    operator = building_operator(2, 1, rng)
    problem = shortened(building_problem(operator, rng), 24)
    peer = DoMpcBuilding(operator, problem, modes_shared=modes_shared)
    solver = QPSolver(operator, ProblemShape(every_step(24), problem.machinery, capped=True), QPConfig())
    model, p = solver.model, solver.model.numbers(problem)
    found = model.evaluate(p, np.clip(peer.solve(problem), 0.0, 1.0))
    assert found.cost == pytest.approx(solver.solve(problem).cost, rel=1e-4)
    assert found.running.max() > 0.2
    assert found.power_W.sum(axis=0).max() > 0.9 * problem.power_cap.limit_W[0], "cap and machine matter"
    for _ in range(3):
        u = rng.uniform(0.0, [[0.9], [0.6]], (2, 24))
        cost = model.evaluate(p, u).cost
        assert do_mpc_cost(peer, problem, u) == pytest.approx(cost, rel=1e-7)


def test_what_is_not_written_in_do_mpc_is_refused():
    rng = np.random.default_rng(0)
    operator = building_operator(2, 1, rng)
    problem = building_problem(operator, rng)
    exclusive = replace(problem, machinery=replace(problem.machinery, exclusive=((0, 1),)))
    peak = replace(problem, weights=replace(problem.weights, peak=1.0))
    for other in (exclusive, peak, replace(problem, power_cap=None)):
        with pytest.raises(DataError, match="do-mpc: this operator or problem"):
            DoMpcBuilding(operator, other, modes_shared=True)
