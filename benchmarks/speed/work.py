"""Work that `benchmarks.speed` measures from within, in either checkout: `python -P work.py NAME [NUMBER]`.

It knows only what both checkouts have, and prints its figures as a line of JSON, by name. Where a figure is of time it
is processor time, ms, of one thread: the clock of the parts of a step is replaced by that of the processor.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

Figures = dict[str, float | list[float]]
"""A list holds results that are to be equal in both checkouts."""

_TESTCASE = "bestest_hydronic_heat_pump"
_MEASURED = Path(__file__).resolve().parents[3] / "shared" / "measured_buildings"
_STEPS_OF_A_DAY = 96
# Parts of a step that have goals of their own.
_BIG = ("free forecast", "solve")
_MAP = {
    "time": {"zone": "UTC"}, "outdoor": "out", "sun": "sun", "step": "15min",
    "zones": {"zone": {"temperature": "T", "lower": "low", "upper": "high", "floor_area_m2": 100.0}},
    "actuators": {"heater": {"level": "u"}}, "machines": {"machine": {"power": "P", "price": 0.25}},
}  # fmt: skip


def step(days: float) -> Figures:
    """The default run on the embedded plant with its journal: what of a step takes how long."""
    parts = _parts(days)
    whole, forecast, solve = (np.array(parts[name]) for name in ("whole step, without the plant", *_BIG))
    return {
        "median step": 1e3 * float(np.median(whole)),
        "mean step": 1e3 * float(np.mean(whole)),
        "of it: all but forecast and solve": 1e3 * float(np.median(whole - forecast - solve)),
        "one forecast": 1e3 * float(np.median(forecast)),
        "one solve": 1e3 * float(np.median(solve)),
    }


def growth(days: float) -> Figures:
    """The same step on the last day and on the second, and a report of ten times the days."""
    whole = np.array(_parts(days)["whole step, without the plant"])
    late, early = (np.median(whole[at : at + _STEPS_OF_A_DAY]) for at in (-_STEPS_OF_A_DAY, _STEPS_OF_A_DAY))
    spent = []
    for number, length in enumerate((days / 10.0, days)):
        folder = f"run{number}"
        run = ["run", "--testcase", _TESTCASE, "--controller", "thermostat", "--baselines", "", "--days", str(length)]
        _tf_mpc([*run, "--quiet", "--out", folder])
        spent.append(_tf_mpc(["report", folder])[0])
    return {
        "last day's step over the second's": float(late / early),
        "report of 10 times the days": spent[1] / spent[0],
    }


def _parts(days: float) -> dict[str, list[float]]:
    from dataclasses import replace

    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from controllers.registry import controller_config
    from thermoforce_mpc.boundary.weather import synthetic_weather
    from thermoforce_mpc.plants.embedded import EmbeddedPlant
    from thermoforce_mpc.plants.testcases import load_testcase

    time.perf_counter = time.process_time  # an earlier checkout's bench does not
    identify_on = _either("experiment.identifying", "simulation.models.identifying").identify_on
    run_timed = import_module("benchmarks.controller.steps").run_timed
    testcase = load_testcase(_TESTCASE)
    plant = EmbeddedPlant(synthetic_weather())
    period = replace(plant.period("peak_heat_day"), scored_s=days * 86400.0)
    model = identify_on(plant, before=period, days=3.0, testcase=testcase)
    config = controller_config("thermoforce_mpc", {}, testcase)
    assert isinstance(config, MPCConfig)
    _, parts = run_timed(plant, ThermoForceMPC(model, config), period)
    return dict(parts)


def rooms(number: float) -> Figures:
    """Seeded buildings of so many rooms: up to five by Ipopt, more by the QP, moves as by default."""
    scaling: Any = import_module("benchmarks.zones.scaling")
    from controllers.mpc.config import MPCConfig
    from controllers.optimisation.solvers.ipopt import IpoptSolver

    count = int(number)
    rng = np.random.default_rng([1, count])
    operator = scaling.building_operator(count, 2, rng)
    problems = [scaling.building_problem(operator, rng) for _ in range(6)]
    moves = scaling.blocked_moves(problems[0].n_steps, 900.0, 12.0, 1.0)
    shape = scaling.ProblemShape(moves, problems[0].machinery, capped=True)
    config = MPCConfig()
    by_ipopt = count <= 5
    solver: Any = (
        IpoptSolver(operator, shape, config.ipopt) if by_ipopt else scaling.QPSolver(operator, shape, config.qp)
    )
    seconds, levels = [], []
    for problem in problems:
        began = time.process_time()
        solution = solver.solve(problem)
        seconds.append(time.process_time() - began)
        if not solution.ok:
            raise RuntimeError(f"{count} rooms: {solution.problem}")
        levels.append(float(np.mean(solution.u)))
    return {"one solve": 1e3 * float(np.median(seconds)), "mean levels": levels}


def many(number: float) -> Figures:
    """Plans of so many houses at an instant, in two processes."""
    from benchmarks.fleet.plan_many import measure_plan_many

    (found,) = measure_plan_many((int(number),), workers=2)
    return {"processor of a plan": found.cpu_ms, "plans a second": found.per_second, "all processes, MB": found.peak_MB}


def rooms_identified(number: float) -> Figures:
    """Identification of the record `all19` in ../shared, nine rooms, or of one of them."""
    import thermoforce_mpc as tf

    name = "one19" if number == 1 else "all19"
    measured = tf.read_measurements(_MEASURED / "ehbe" / "ehbe_2019_15min.csv", str(_MEASURED / f"{name}.yaml"))
    began = time.process_time()
    model = tf.identify(measured.record, layout=measured.layout)
    spent_ms = 1e3 * (time.process_time() - began)
    pairs = [pair for row in model.operator.pairs for pair in row if pair is not None]
    return {"identification": spent_ms, "step responses, K": [float(pair.impulse(96).sum()) for pair in pairs]}


def control(_: float) -> Figures:
    """One decision of `tf-mpc control` on files of ten days, with the default controller."""
    import pandas as pd

    n, rng = 960, np.random.default_rng(0)
    at = pd.date_range(end=pd.Timestamp.now("UTC").floor("15min"), periods=n, freq="15min")
    hour = np.arange(n) / 4
    outdoor, sun = 4 + 3 * np.sin(hour / 3.8), np.maximum(0.0, 300 * np.sin((hour - 8) / 24 * 2 * np.pi))
    u = np.repeat(rng.choice([0.0, 0.4, 0.7, 1.0], n // 6), 6)
    T, fast, slow = [], 0.0, 5.0
    for level, out in zip(u, outdoor, strict=True):
        T.append(out + fast + slow + 4.0 + 0.02 * rng.normal())
        fast, slow = fast * 0.92 + 0.16 * level, slow * 0.996 + 0.1 * level
    both = {"low": 20.0, "high": 24.0}
    table = pd.DataFrame({"time": at, "T": T, "out": outdoor, "sun": sun, "u": u, "P": 3000.0 * u} | both)
    table.to_csv("house.csv", index=False)
    hours = pd.date_range(at[-1].floor("1h"), periods=60, freq="1h")
    ahead = pd.DataFrame({"time": hours, "out": 4.0 + np.sin(np.arange(60) / 4.0), "sun": 0.0} | both)
    ahead.to_csv("tomorrow.csv", index=False)
    Path("map.yaml").write_text(json.dumps(_MAP), encoding="utf-8")
    _tf_mpc(["identify", "--data", "house.csv", "--map", "map.yaml", "--out", "model"])
    of_files = [f"--set=connection.{one}" for one in ("measurements=house.csv", "forecast=tomorrow.csv")]
    spent_ms, peak_MB = _tf_mpc(["control", "--model", "model", "--map", "map.yaml", *of_files, "--dry-run"])
    return {"processor of a dry run": spent_ms, "memory of control, MB": peak_MB}


def peers(_: float) -> Figures:
    """Ipopt's time on the 96-step problem of one zone as a share of do-mpc's, and of AgentLib-MPC's where installed."""
    _tf_mpc(["bench", "controller", "--quick", "--json", "bench.json"])
    rows = json.loads(Path("bench.json").read_text(encoding="utf-8"))["rows"]
    (ipopt,) = (row for row in rows if row.get("solver") == "ipopt")
    faster = {"do-mpc": "times_faster_than_do_mpc", "AgentLib-MPC": "than_agentlib_mpc"}
    return {f"Ipopt over {peer}": 1.0 / ipopt[key] for peer, key in faster.items() if ipopt.get(key)}


def _tf_mpc(words: list[str]) -> tuple[float, float]:
    """Processor time, ms, and peak memory, MB, of a command; raises `RuntimeError` where it fails."""
    starter = "import os, sys, json; _, s, r = os.wait4(os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ), 0);"
    starter += "print(json.dumps([s, r.ru_utime + r.ru_stime, r.ru_maxrss]), file=open('used.json', 'w'))"
    call = [sys.executable, "-S", "-c", starter, sys.executable, "-m", "thermoforce_mpc", *words]
    os.spawnve(os.P_WAIT, sys.executable, call, os.environ)
    code, seconds, peak_kB = json.loads(Path("used.json").read_text(encoding="utf-8"))
    if code:
        raise RuntimeError(f"tf-mpc {' '.join(words)}: exit code {os.waitstatus_to_exitcode(code)}")
    return 1e3 * seconds, peak_kB / 1024.0


def _either(now: str, before: str) -> Any:
    """A module of `thermoforce_mpc` by its name today, or by the one it had."""
    try:
        return import_module(f"thermoforce_mpc.{now}")
    except ModuleNotFoundError:
        return import_module(f"thermoforce_mpc.{before}")


_WORK = {one.__name__: one for one in (step, growth, rooms, many, rooms_identified, control, peers)}

if __name__ == "__main__":
    print(json.dumps(_WORK[sys.argv[1]](float(sys.argv[2] if len(sys.argv) > 2 else 0))))
