"""Runs for tests of reports: planned over several zones with awkward names, and long ones made of copies."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from two_houses import TWO, TwoHouses

from thermoforce_mpc.data import ACTING, HOUR_S, Block, Boundary, Layout, Names, Plan, PlanStatus
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.report import write_report

N = 6
OFF_K = np.array([0.5, -0.25])
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u2028'\""
HOSTILE_NAMES = Names((f"bath{HOSTILE}", "__proto__"), (f"valve{HOSTILE}", "floor"), (f"boiler{HOSTILE}", "heat pump"))


class Planner:
    """Plans that miss the first zone by +0.5 K and the second by −0.25 K: it believes that nothing changes."""

    name, step_s, horizon_s = "planner", HOUR_S, N * HOUR_S

    def __init__(self, names: Names = TWO, why: str = "as ever") -> None:
        self.names, self.why = names, why

    def plan(self, observation, state=None):
        T = observation.T_zone_C[:, None] + OFF_K[:, None] + np.zeros(N)
        return Plan(
            (Block((0.5, 0.25), HOUR_S),), PlanStatus.SOLVED, self.why, u=np.tile([[0.5], [0.25]], N),
            T_free_now_C=observation.T_zone_C, T_free_C=T - 1.0, T_forced_K=np.ones_like(T), T_free_low_C=T - 2.0,
            T_free_high_C=T + 5.0, slack_K=0 * T, power_W=0 * T + 1000.0, names=self.names, solver_status="optimal",
            iterations=7, seconds={"solve": 0.004, "forecast": 0.002},
        )  # fmt: skip


def planned(names: Names = TWO, why: str = "as ever") -> RunResult:
    """Two days of `Planner` on two houses, 48 steps."""
    plant = TwoHouses()
    plant.names = names
    result = run_closed_loop(plant, Planner(names, why), plant.period("x"))
    zones = {f"tdis_tot[{zone}]": value for zone, value in zip(names.zones, (0.5, 1.5), strict=True)}
    kpis = {name: value for name, value in result.kpis.items() if "[" not in name}
    return replace(result, kpis=kpis | zones)


def layout_of(names: Names = TWO) -> Layout:
    """Radiator and boiler for the second zone, floor and heat pump for the first."""
    return Layout(names, (1, 1), (1, 0), (0, 1), (0.0, 0.0), (0.0, 0.0), (60.0, 40.0))


def report_of(
    result: RunResult, baselines: Mapping[str, RunResult], folder: Path, layout: Layout | None = None, **more
) -> str:
    """The page of a run, written into `folder`."""
    manifest = {
        "plant": {"kind": "simple"},
        "command": ["tf-mpc"],
        "environment": {},
        "identification": {
            "actuators": {
                "radiator": {"competence": None},
                "floor": {"competence": {"advice": ["hold full level"]}},
            }
        },
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    kpis = {
        "controller": result.controller, "testcase": "two", "period": "x", "start_day": 10.0, "scored_days": 2.0,
        "price": "constant", "plant": "two houses", "weather": "cosine",
    }  # fmt: skip
    layout = layout or layout_of()
    path = write_report(
        folder, kpis=kpis, result=result, baselines=baselines, currency="EUR", layout=layout, area_m2=100.0, **more
    )
    return path.read_text(encoding="utf-8")


def two_weeks(names: Names, n: int = 192, steps: int = 1344, blocks: int = 3) -> RunResult:
    """A made-up run of a quarter-hourly MPC with `n` steps of horizon: plans and samples of random numbers."""
    random = np.random.default_rng(1)
    Z, A, M = len(names.zones), len(names.actuators), len(names.machines)
    run = planned()
    first = run.steps[0]

    def rows(rows: int, mean: float) -> np.ndarray:
        return mean + random.normal(size=(rows, n + 1))

    boundary = Boundary(
        first.time_s + 900.0 * np.arange(n + 1), rows(1, 5.0)[0], rows(1, 100.0)[0], rows(Z, 1.0), rows(Z, 21.0),
        rows(Z, 24.0), rows(M, 0.2), rows(M, 0.2), names=names,
    )  # fmt: skip
    # Sizes do not depend on the numbers: all steps have the same.
    parts = {
        name: 20.0 + 0.1 * rows(Z, 0.0)[:, :n].cumsum(axis=1)
        for name in ("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "slack_K")
    }
    plan = Plan(
        (),
        PlanStatus.SOLVED,
        "",
        u=rows(A, 0.5)[:, :n].clip(0.0, 1.0),
        T_free_now_C=rows(Z, 20.0)[:, 0],
        power_W=rows(M, 900.0)[:, :n],
        names=names,
        seconds={"solve": 0.01},
        **parts,
    )
    sample = replace(
        first.samples[0], duration_s=900.0 / blocks, names=names, T_zone_C=rows(Z, 21.0)[:, 0],
        lower_C=rows(Z, 21.0)[:, 0], upper_C=rows(Z, 24.0)[:, 0], price_per_kWh=rows(M, 0.2)[:, 0],
        u_measured=rows(A, 0.5)[:, 0], power_W=rows(M, 900.0)[:, 0],
    )  # fmt: skip
    found = []
    for k in range(steps):
        at_s = first.time_s + 900.0 * k
        said = replace(plan, why=f"the lower bound binds in {k} h (80 % band of the free forecast there: 0.{k} K)")
        samples = tuple(replace(sample, start_s=at_s + 900.0 / blocks * b) for b in range(blocks))
        found.append(
            replace(
                first, index=k, time_s=at_s, T_zone_C=sample.T_zone_C, plan=said, samples=samples, boundary=boundary
            )
        )
    unknown = {name: np.full(rows, np.nan) for name, rows in zip(ACTING, (A, M, A, M), strict=True)}
    start = replace(run.start, T_zone_C=sample.T_zone_C, names=names, **unknown)
    return replace(run, steps=found, start=start)
