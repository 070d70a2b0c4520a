"""`tf-mpc bench faults`: how soon the watch notices a plant that changed for a day, and what the day costs.

One week of winter on the embedded plant with the synthetic year, three days of probing, default configuration. The
fault lasts from the end of the second day to that of the third. Each fault is run with and without the watch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from controllers.registry import build_controller
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, PlanStatus
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.research.bench.faulty_plant import FaultyPlant
from thermoforce_mpc.scenario.scenario import load_testcase
from thermoforce_mpc.simulation.bench_result import Target, bench_result
from thermoforce_mpc.simulation.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.simulation.identifying import identify_on

_BLIND: Mapping[str, Any] = {"reports_u": False, "meters": False}
# Every fault by name: options of `FaultyPlant`.
FAULTS: dict[str, Mapping[str, Any]] = {
    "none": {"fault": "none"},
    "machine half as fast": {"fault": "weak"},
    "machine half as fast, no meters": {"fault": "weak", "meters": False},
    "window open": {"fault": "window"},
    "sensor moved": {"fault": "sensor"},
    "actuator stuck at 0": {"fault": "stuck", "level": 0.0},
    "actuator stuck at 1, not reported": {"fault": "stuck", "level": 1.0, **_BLIND},
    "overridden": {"fault": "overridden"},
    "overridden, not reported": {"fault": "overridden", **_BLIND},
}
_QUICK = ("none", "actuator stuck at 0")
_FAULT_DAYS, _RUN_DAYS, _START_DAY = (2.0, 3.0), 6.0, 16
# Goals: noticed within a day of the change; discomfort beside that without the watch, K·h.
_NOTICED_H, _MORE_KH = 24.0, 1.0

Row = dict[str, Any]


def run_faults_bench(
    *, quick: bool = False, progress: Callable[[str], None] = lambda line: None, stand_back: str = "native"
) -> dict[str, Any]:
    """Run every fault with and without the watch.

    Args:
        quick: without a fault and one fault only.
        progress: callback for progress lines.
        stand_back: who acts while the watch has handed control back: 'native' or 'rule'.
    """
    plant = EmbeddedPlant(synthetic_weather())
    testcase = load_testcase("bestest_hydronic_heat_pump")
    period = replace(plant.period(str(_START_DAY)), scored_s=_RUN_DAYS * DAY_S)
    progress("probing and identifying")
    model = identify_on(plant, before=period, days=3.0, testcase=testcase)
    from_s, to_s = (period.start_s + days * DAY_S for days in _FAULT_DAYS)

    def run(fault: Mapping[str, Any], enabled: bool) -> RunResult:
        options = {"watch": {"enabled": enabled}, "fallback": {"stand_back": stand_back}}
        controller = build_controller("thermoforce_mpc", options, testcase, model)
        return run_closed_loop(FaultyPlant(plant, from_s=from_s, to_s=to_s, **fault), controller, period)

    rows = []
    for name in _QUICK if quick else FAULTS:
        progress(name)
        rows.append(_row(name, run(FAULTS[name], True), run(FAULTS[name], False), from_s, to_s))
    return bench_result("faults", rows, _targets(rows))


def _row(name: str, watched: RunResult, alone: RunResult, from_s: float, to_s: float) -> Row:
    """One fault: hours from its beginning to the first alarm, from its end to the return of control, and the costs."""
    times = [step.time_s for step in watched.steps if step.plan.status is PlanStatus.WATCH]
    after = [time_s for time_s in times if time_s >= to_s]
    step_s = watched.steps[1].time_s - watched.steps[0].time_s
    back = (max(after) + step_s - to_s) / HOUR_S if after else 0.0
    ended = times and times[-1] == watched.steps[-1].time_s
    return {
        "fault": name,
        "noticed_h": (times[0] - from_s) / HOUR_S if times else None,
        "back_h": None if not times or ended else back,
        "watch_steps": len(times),
        "discomfort_Kh": watched.kpis["tdis_tot"],
        "without_watch_Kh": alone.kpis["tdis_tot"],
        "cost": watched.kpis["cost_tot"],
        "without_watch_cost": alone.kpis["cost_tot"],
        "reason": next((s.plan.why for s in watched.steps if s.plan.status is PlanStatus.WATCH), ""),
    }


def _targets(rows: list[Row]) -> list[Target]:
    faulty = [row for row in rows if row["fault"] != "none"]
    none = next(row for row in rows if row["fault"] == "none")
    targets = [Target("steps under watch without a fault", float(none["watch_steps"]), 0.0)]
    for row in faulty:
        noticed = math.nan if row["noticed_h"] is None else row["noticed_h"]
        # An alarm before the fault is a false one.
        targets.append(Target(f"{row['fault']}: h to notice", noticed if noticed > 0 else math.nan, _NOTICED_H))
        back = math.nan if row["back_h"] is None else row["back_h"]
        targets.append(Target(f"{row['fault']}: h from its end to the return of control", back, 2 * _NOTICED_H))
        more = row["discomfort_Kh"] - row["without_watch_Kh"]
        targets.append(Target(f"{row['fault']}: discomfort more than without the watch, K·h", more, _MORE_KH))
    return targets
