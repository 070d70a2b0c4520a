"""The peer of the controller bench solves the same problem, and says what to install where it is missing."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from in_do_mpc import do_mpc_cost
from mpc_problems import N, random_operator, random_problem

from benchmarks.controller.agentlib_peer import AgentLibPeer
from benchmarks.controller.bench import solver_row
from benchmarks.controller.do_mpc_peer import DoMpcPeer, without_extras
from controllers.optimisation.problem import ProblemShape, Weights, every_step
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.operator.building import single


@pytest.mark.slow
@pytest.mark.parametrize("gain_beforehand", [False, True])
def test_do_mpc_finds_the_optimum_of_ipopt_and_levels_cost_there_what_the_statement_says(gain_beforehand):
    pytest.importorskip("do_mpc", reason="extra [bench]", exc_type=ImportError)
    rng = np.random.default_rng(3)
    operator = random_operator(rng, 3)
    problems = [random_problem(rng, 3, curvature=1e-6) for _ in range(3)]
    peer, operator = DoMpcPeer(operator, problems[0], gain_beforehand=gain_beforehand), single(operator)
    ipopt = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    for problem in problems:
        best = ipopt.solve(problem).cost
        p = ipopt.model.numbers(problem)
        found = ipopt.model.evaluate(p, np.clip(peer.solve(problem), 0, 1)[None]).cost
        assert found == pytest.approx(best, rel=1e-4)
        assert ipopt.model.evaluate(p, np.zeros((1, N))).cost > 1.001 * best
    for problem in problems:
        u = rng.uniform(0.0, 1.0, (1, N))
        cost = ipopt.model.evaluate(ipopt.model.numbers(problem), u).cost
        assert do_mpc_cost(peer, problem, u) == pytest.approx(cost, rel=1e-7)


@pytest.mark.slow
def test_agentlib_mpc_finds_the_optimum_of_ipopt():
    pytest.importorskip("agentlib_mpc", reason="in no extra, since it asks for versions of its own")
    rng = np.random.default_rng(3)
    operator = random_operator(rng, 3)
    problems = [random_problem(rng, 3, curvature=1e-6) for _ in range(3)]
    peer, operator = AgentLibPeer(operator, problems[0]), single(operator)
    ipopt = IpoptSolver(operator, ProblemShape(every_step(N)), IpoptConfig())
    for problem in problems:
        u = np.clip(peer.solve(problem), 0, 1)[None]
        assert ipopt.model.brings(problem, u).cost == pytest.approx(ipopt.solve(problem).cost, rel=1e-4)


@pytest.mark.parametrize(
    ("module", "advice", "build"),
    [
        ("do_mpc", r"pip install -e '\.\[bench\]'", lambda *of: DoMpcPeer(*of, gain_beforehand=True)),
        ("agentlib_mpc.data_structures.mpc_datamodels", r"pip install agentlib_mpc", AgentLibPeer),
    ],
)
def test_a_missing_peer_is_named(monkeypatch, module, advice, build):
    monkeypatch.setitem(sys.modules, module, None)
    rng = np.random.default_rng(3)
    with pytest.raises(ConfigError, match=advice):
        build(random_operator(rng, 1), random_problem(rng, 1))


def test_what_the_peer_cannot_express_is_left_out():
    rng = np.random.default_rng(4)
    problem = replace(
        random_problem(rng, 2),
        weights=Weights(5.0, 1e-6, peak=1.0),
        peak_so_far_W=1.0,
    )
    plain = without_extras(problem)
    assert (plain.weights.peak, plain.weights.comfort) == (0.0, 5.0)


def test_rows_compare_with_the_peer_and_the_reference():
    seconds = {"ipopt": [0.2, 0.4, 0.3], "do-mpc": [0.9, 0.9, 1.5], "qp by PIQP": [0.01, 0.02, 0.03]}
    seconds["AgentLib-MPC"] = [0.5, 0.5, 0.6]
    costs = {"ipopt": [1.0, 2.0, 4.0], "do-mpc": [1.0, 2.0, 4.0], "qp by PIQP": [1.0, 2.0, 4.4]}
    row = solver_row("qp by PIQP", seconds, costs, steps=N)
    assert row["times_faster_than_do_mpc"] == pytest.approx(45.0)
    assert row["than_agentlib_mpc"] == pytest.approx(25.0)
    assert row["than_helped_do_mpc"] is None
    assert row["worst_relative_difference_to_ipopt"] == pytest.approx(0.1)
