"""Benchmark of differentiable predictive control: a trained policy beside the MPC on the same model and plant."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from controllers.dpc.config import DPCConfig
from controllers.dpc.controller import DPC
from controllers.registry import build_controller, controller_config
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.simulation.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.simulation.comparison.results_json import Target, results_json
from thermoforce_mpc.simulation.composition import scored_period
from thermoforce_mpc.simulation.models.identifying import identify_on

_WINDOWS = ("peak_heat_day", "typical_heat_day")


def run_dpc_bench(
    *,
    days: float = 14.0,
    price: str = "constant",
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Probe the embedded plant before the first window, identify and train once; then each controls both windows."""
    testcase = load_testcase("bestest_hydronic_heat_pump")
    plant = EmbeddedPlant(synthetic_weather())
    options: dict[str, Any] = {"training": {"iterations": 60}} if quick else {}
    days = min(days, 1.0) if quick else days
    rows: list[dict[str, Any]] = []
    over: dict[str, list[float]] = {"cost": [], "discomfort": [], "decision": [], "fallbacks": []}
    progress("probing and identification")
    first = scored_period(plant, _WINDOWS[0], days)
    model = identify_on(plant, before=first, days=3.0, testcase=testcase, step_s=900.0)
    config = controller_config("dpc", options, testcase)
    assert isinstance(config, DPCConfig)
    total = config.training.iterations

    def told(done: int, loss: float) -> None:
        if done % 50 == 0:
            progress(f"training: {done} of {total}, loss {loss:.3f}")

    wall, cpu = time.perf_counter(), time.process_time()
    policy = DPC(model, config, progress=told)
    trained_s, trained_cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    contestants: list[Controller] = [
        policy,
        build_controller("thermoforce_mpc", {}, testcase, model),
        build_controller("thermostat", {}, testcase),
    ]
    for name in _WINDOWS:
        window = scored_period(plant, name, days)
        found = {}
        for controller in contestants:
            progress(f"{name}: {controller.name}")
            found[controller.name] = run = run_closed_loop(plant, controller, window, price)
            rows.append(
                {
                    "window": name,
                    "controller": controller.name,
                    "cost": run.kpis["cost_tot"],
                    "discomfort_Kh": run.kpis["tdis_tot"],
                    "training_s": trained_s if controller is policy else None,
                    "training_cpu_s": trained_cpu_s if controller is policy else None,
                    "step_ms": 1e3 * float(np.median([step.plan_seconds for step in run.steps])),
                    "decision_ms": _decision_ms(run),
                    "not_solved": sum(n for level, n in run.fallback_levels().items() if level not in _SOUND),
                }
            )
        ours, mpc = found["dpc"], found["thermoforce_mpc"]
        over["cost"].append(ours.kpis["cost_tot"] / mpc.kpis["cost_tot"])
        over["discomfort"].append(ours.kpis["tdis_tot"] - mpc.kpis["tdis_tot"])
        over["decision"].append((_decision_ms(ours) or np.nan) / (_decision_ms(mpc) or np.nan))
        over["fallbacks"].append(float(rows[-3]["not_solved"]))
    targets = [
        Target("cost of dpc over that of the MPC, worst window", max(over["cost"]), 1.05),
        Target("discomfort of dpc above the MPC's, worst window, K·h", max(over["discomfort"]), 0.5),
        Target("time of a decision over that of the MPC's solve, worst window", max(over["decision"]), 1.0),
        Target("steps of dpc that the policy did not decide", max(over["fallbacks"]), 0.0),
    ]
    return results_json("dpc", rows, targets)


_SOUND = ("solved", "bridged", "rule")


def _decision_ms(run: RunResult) -> float | None:
    """Median time of the solve, or of the policy in its place, ms."""
    times = [step.plan.seconds["solve"] for step in run.steps if "solve" in step.plan.seconds]
    return 1e3 * float(np.median(times)) if times else None
