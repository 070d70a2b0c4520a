"""How fast a control step is: our solvers beside do-mpc on the same instances, and where a step's time goes."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from controllers.ipopt import IpoptSolver
from controllers.mpc import ThermoForceMPC
from controllers.mpc_config import MPCConfig
from controllers.problem import MPCProblem, ProblemShape, Solution, every_step
from controllers.qp import QPSolver
from controllers.registry import build_controller
from thermoforce_mpc.bench.do_mpc_peer import DoMpcPeer, without_extras
from thermoforce_mpc.bench.result import Target, bench_result
from thermoforce_mpc.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.composition import identify_on
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.scenario import load_testcase
from thermoforce_mpc.types import Array
from thermoforce_mpc.weather import synthetic_weather

_TESTCASE = "bestest_hydronic_heat_pump"
# Instances that are solved by everyone; do-mpc needs a good part of a second for each.
_INSTANCES, _QUICK_INSTANCES = 60, 8


class Recorder:
    """Stands before a solver and keeps what it is asked."""

    def __init__(self, inner: Any) -> None:
        self.inner, self.problems = inner, list[MPCProblem]()

    def solve(self, problem: MPCProblem) -> Solution:
        """Pass on and remember."""
        self.problems.append(problem)
        solution: Solution = self.inner.solve(problem)
        return solution


def run_controller_bench(*, quick: bool = False, progress: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Record instances in a closed loop on the embedded plant, then let every solver solve the same ones.

    Returns:
        The bench's result; one row per solver, then one per part of a step.
    """
    progress("identifying and recording a closed loop on the embedded plant")
    mpc, recorder, result = _recorded(days=1.0 if quick else 14.0)
    every = max(1, len(recorder.problems) // (_QUICK_INSTANCES if quick else _INSTANCES))
    problems = [without_extras(problem) for problem in recorder.problems[::every]]
    operator = mpc._operator
    shape = ProblemShape(every_step(problems[0].n_steps), problems[0].u_max, problems[0].lowest_level)
    config = MPCConfig()
    solvers: dict[str, Callable[[MPCProblem], Array]] = {
        "qp (PIQP)": _levels(QPSolver(operator, shape, config.qp)),
        "qp (Clarabel)": _levels(QPSolver(operator, shape, config.qp.model_copy(update={"backends": ("clarabel",)}))),
        "ipopt": _levels(IpoptSolver(operator, shape, config.ipopt)),
    }
    try:
        solvers["do-mpc"] = DoMpcPeer(operator, problems[0]).solve
    except ConfigError as error:
        progress(str(error))
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    costs: dict[str, list[float]] = {name: [] for name in solvers}
    for i, problem in enumerate(problems):  # side by side, so that a busy moment hits all alike
        for name, solve in solvers.items():
            began = time.perf_counter()
            u = solve(problem)
            seconds[name].append(time.perf_counter() - began)
            costs[name].append(float(problem.cost(operator, np.clip(u, 0.0, problem.u_max))))
        if i % 10 == 9:
            progress(f"{i + 1} of {len(problems)} instances")
    median = {name: float(np.median(values)) for name, values in seconds.items()}
    reference = np.array(costs["ipopt"])
    rows: list[dict[str, Any]] = [
        {
            "solver": name,
            "steps": problems[0].n_steps,
            "instances": len(problems),
            "median_ms": 1e3 * median[name],
            "times_faster_than_do_mpc": median["do-mpc"] / median[name] if "do-mpc" in median else None,
            "worst_relative_difference_to_ipopt": float(
                np.max(np.abs(np.array(costs[name]) - reference) / (1e-9 + np.abs(reference)))
            ),
        }
        for name in solvers
    ]
    rows += _parts(result)
    return bench_result("controller", rows, _targets(rows, median, result))


def _recorded(days: float) -> tuple[ThermoForceMPC, Recorder, RunResult]:
    testcase = load_testcase(_TESTCASE)
    with closing(EmbeddedPlant(synthetic_weather())) as plant:
        period = replace(plant.period("peak_heat_day"), scored_s=days * 86400.0)
        model = identify_on(plant, before=period, days=3.0, testcase=testcase)
        mpc = build_controller("thermoforce_mpc", {}, testcase, model)
        if not isinstance(mpc, ThermoForceMPC):
            raise TypeError("the registry's thermoforce_mpc is not a ThermoForceMPC")
        recorder = Recorder(mpc._solver)
        mpc._solver = recorder
        result = run_closed_loop(plant, mpc, period)
    return mpc, recorder, result


def _levels(solver: QPSolver | IpoptSolver) -> Callable[[MPCProblem], Array]:
    def solve(problem: MPCProblem) -> Array:
        solution = solver.solve(problem)
        if not solution.ok:
            raise RuntimeError(f"bench controller: {solution.problem}")
        return solution.u

    return solve


def _parts(result: RunResult) -> list[dict[str, Any]]:
    """Where the time of a control step goes, ms (median and total)."""
    parts: dict[str, list[float]] = {
        "predict (free response, forced state)": [step.plan.seconds.get("predict", 0.0) for step in result.steps],
        "solve": [step.plan.seconds.get("solve", 0.0) for step in result.steps],
        "boundary forecast": [step.forecast_seconds for step in result.steps],
        "plant": [step.plant_seconds for step in result.steps],
    }
    return [
        {"part of a step": name, "median_ms": 1e3 * float(np.median(values)), "total_s": float(np.sum(values))}
        for name, values in parts.items()
    ]


def _targets(rows: list[dict[str, Any]], median: dict[str, float], result: RunResult) -> list[Target]:
    targets = []
    if "do-mpc" in median:
        by_name = {row["solver"]: row for row in rows if "solver" in row}
        targets += [
            Target("qp: times faster than do-mpc", median["do-mpc"] / median["qp (PIQP)"], 50.0, "at least"),
            Target("ipopt: times faster than do-mpc", median["do-mpc"] / median["ipopt"], 3.0, "at least"),
            Target(
                "do-mpc and ipopt: worst relative difference of the optimum",
                by_name["do-mpc"]["worst_relative_difference_to_ipopt"],
                1e-4,
            ),
        ]
    controller = sum(step.plan_seconds for step in result.steps)
    plant = sum(step.plant_seconds for step in result.steps)
    return [*targets, Target("time in the controller over time in the plant", controller / plant, 1.0)]
