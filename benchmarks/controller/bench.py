"""`tf-mpc bench controller`: processor time of solves beside do-mpc and AgentLib-MPC, and shares of a control step."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.controller.agentlib_peer import AgentLibPeer
from benchmarks.controller.do_mpc_peer import DoMpcPeer, without_extras
from benchmarks.controller.steps import FORECAST, WHOLE, part_rows, run_timed
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.planner import build_solver
from controllers.optimisation.plan_model import Evaluator
from controllers.optimisation.problem import MPCProblem, ProblemShape, blocked_moves, every_step
from controllers.optimisation.solution import Solution, Solver
from controllers.optimisation.solvers.ipopt import IpoptSolver
from controllers.optimisation.solvers.qp import QPSolver
from controllers.optimisation.solvers.sqp import SQPSolver
from controllers.registry import controller_config
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase

_TESTCASE = "bestest_hydronic_heat_pump"
# Number of instances; do-mpc needs a large part of a second for each.
_INSTANCES, _QUICK_INSTANCES = 60, 8
_DEFAULT, _BLOCKED, _IPOPT = "qp by PIQP", "qp by PIQP, moves blocked as by default", "ipopt"
_PLANNED, _SQP = "ipopt, moves blocked: the default", "sqp"
# do-mpc with the operator and its network as a model, and with the gain of each step as a precomputed parameter.
_PEER, _HELPED_PEER = "do-mpc", "do-mpc, gain worked out beforehand"
_AGENTLIB = "AgentLib-MPC"

_RATIOS = (
    ("times_faster_than_do_mpc", _PEER),
    ("than_helped_do_mpc", _HELPED_PEER),
    ("than_agentlib_mpc", _AGENTLIB),
)

_TWO_WEEKS_DAYS, _QP_DAYS = 14.0, 4.0

Row = dict[str, Any]
Parts = Mapping[str, Sequence[float]]


class Recorder:
    """Wrapper of a solver that adds its problems to `problems`."""

    def __init__(self, inner: Solver, problems: list[MPCProblem]) -> None:
        self.inner, self.problems = inner, problems

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Record `problem` and solve it with the inner solver."""
        self.problems.append(problem)
        return self.inner.solve(problem, guess)


def run_controller_bench(*, quick: bool = False, progress: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Record instances in a closed loop on the embedded plant and solve them with every solver.

    Returns:
        Result of the bench: one row per solver, then one per part of a step beside Ipopt and beside the QP.
    """
    progress("identifying and recording a closed loop on the embedded plant")
    days = 1.0 if quick else _TWO_WEEKS_DAYS
    mpc, recorded, beside_ipopt = _recorded("ipopt", days)
    _, _, beside_qp = _recorded("qp", min(days, _QP_DAYS))
    every = max(1, len(recorded) // (_QUICK_INSTANCES if quick else _INSTANCES))
    problems = [without_extras(problem) for problem in recorded[::every]]
    seconds, costs = _timed(_contestants(mpc, problems[0], progress), problems, mpc.evaluator, progress)
    rows = [solver_row(name, seconds, costs, problems[0].n_steps) for name in seconds]
    rows += [*part_rows("ipopt", beside_ipopt), *part_rows("qp", beside_qp)]
    return results_json("controller", rows, [*_targets(rows), *_step_targets(beside_ipopt, beside_qp, days)])


def _contestants(
    mpc: ThermoForceMPC, example: MPCProblem, progress: Callable[[str], None]
) -> dict[str, Callable[[MPCProblem], Array]]:
    """Every solver by name, built for problems like `example`; default move blocking is a separate entry."""
    operator, config = mpc.planning_operator, MPCConfig()
    free = ProblemShape(every_step(example.n_steps), example.machinery)
    blocked = replace(
        free,
        move_of_step=blocked_moves(
            example.n_steps, example.step_s, config.move_blocking.free_h, config.move_blocking.hold_h
        ),
    )
    solvers = {
        _DEFAULT: _levels(QPSolver(operator, free, config.qp)),
        _BLOCKED: _levels(QPSolver(operator, blocked, config.qp)),
        _SQP: _levels(SQPSolver(operator, free, config.sqp, config.qp)),
        _IPOPT: _levels(IpoptSolver(operator, free, config.ipopt)),
        _PLANNED: _levels(IpoptSolver(operator, blocked, config.ipopt)),
    }
    alone = operator.of_actuator(0)
    for name, peer in (
        (_PEER, lambda: DoMpcPeer(alone, example, gain_beforehand=False).solve),
        (_HELPED_PEER, lambda: DoMpcPeer(alone, example, gain_beforehand=True).solve),
        (_AGENTLIB, lambda: AgentLibPeer(alone, example).solve),
    ):
        try:
            solvers[name] = peer()
        except ConfigError as error:
            progress(str(error))
    return solvers


def _timed(
    solvers: Mapping[str, Callable[[MPCProblem], Array]],
    problems: Sequence[MPCProblem],
    model: Evaluator,
    progress: Callable[[str], None],
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Processor time, s, and cost of each solver on each problem; they alternate, so that other load affects all."""
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    costs: dict[str, list[float]] = {name: [] for name in solvers}
    for i, problem in enumerate(problems):
        for name, solve in solvers.items():
            began = time.process_time()
            u = np.atleast_2d(solve(problem))
            seconds[name].append(time.process_time() - began)
            u = np.clip(u, 0.0, problem.machinery.u_max[:, None])
            costs[name].append(model.brings(problem, u).cost)
        if i % 10 == 9:
            progress(f"{i + 1} of {len(problems)} instances")
    return seconds, costs


def solver_row(name: str, seconds: Mapping[str, list[float]], costs: Mapping[str, list[float]], steps: int) -> Row:
    """Median time of one solver, ms, ratios to peers, and largest relative difference of the cost to Ipopt's."""
    median = float(np.median(seconds[name]))
    reference = np.array(costs[_IPOPT])
    worst = float(np.max(np.abs(np.array(costs[name]) - reference) / (1e-9 + np.abs(reference))))
    row: Row = {"solver": name, "steps": steps, "instances": len(reference), "median_ms": 1e3 * median}
    for label, peer in _RATIOS:
        row[label] = float(np.median(seconds[peer])) / median if peer in seconds else None
    return row | {"worst_relative_difference_to_ipopt": worst}


def _recorded(solver: str, days: float) -> tuple[ThermoForceMPC, list[MPCProblem], Parts]:
    """The default controller beside a solver, the problems of its run on the embedded plant, and its parts."""
    testcase = load_testcase(_TESTCASE)
    config = controller_config("thermoforce_mpc", {"solver": solver}, testcase)
    assert isinstance(config, MPCConfig)
    problems: list[MPCProblem] = []

    def recorder(operator: BuildingOperator, shape: ProblemShape) -> Solver:
        return Recorder(build_solver(config, operator, shape), problems)

    with closing(EmbeddedPlant(synthetic_weather())) as plant:
        period = replace(plant.period("peak_heat_day"), scored_s=days * DAY_S)
        model = identify_on(plant, before=period, days=3.0, testcase=testcase)
        mpc = ThermoForceMPC(model, config, solver=recorder)
        _, parts = run_timed(plant, mpc, period)
    return mpc, problems, parts


def _levels(solver: Solver) -> Callable[[MPCProblem], Array]:
    def solve(problem: MPCProblem) -> Array:
        solution = solver.solve(problem)
        if not solution.ok:
            raise RuntimeError(f"bench controller: {solution.problem}")
        return solution.u

    return solve


def _targets(rows: Sequence[Row]) -> list[Target]:
    by_name = {row["solver"]: row for row in rows if "solver" in row}
    same = "worst_relative_difference_to_ipopt"
    targets = [
        Target(f"{_DEFAULT}: worst relative difference of its optimum to Ipopt's", by_name[_DEFAULT][same], 1e-6)
    ]
    if _AGENTLIB in by_name:
        faster = by_name[_IPOPT]["than_agentlib_mpc"]
        targets += [
            Target(f"{_IPOPT}: times faster than {_AGENTLIB}", faster, 5.0, "at least"),
            Target(f"{_AGENTLIB}: worst relative difference of its optimum", by_name[_AGENTLIB][same], 1e-4),
        ]
    if _PEER in by_name:
        targets += [
            Target(f"{name}: times faster than {_PEER}", by_name[name]["times_faster_than_do_mpc"], goal, "at least")
            for name, goal in ((_DEFAULT, 50.0), (_BLOCKED, 50.0), (_IPOPT, 12.0), (_PLANNED, 12.0))
        ]
        targets.append(Target(f"{_PEER}: worst relative difference of its optimum", by_name[_PEER][same], 1e-4))
    return targets


def _step_targets(beside_ipopt: Parts, beside_qp: Parts, days: float) -> list[Target]:
    def median_ms(values: Sequence[float]) -> float:
        return 1e3 * float(np.median(values))

    in_controller_s = sum(beside_ipopt[WHOLE]) * _TWO_WEEKS_DAYS / days
    return [
        Target("free forecast, median ms", median_ms(beside_ipopt[FORECAST]), 3.0),
        Target("whole step beside Ipopt, median ms", median_ms(beside_ipopt[WHOLE]), 12.0),
        Target("whole step beside the QP, median ms", median_ms(beside_qp[WHOLE]), 6.0),
        Target("steps of two weeks without the plant, s", in_controller_s, 10.0),
    ]
