"""`tf-mpc bench faults`: how soon the watch notices a plant that changed for a day, and what the day costs.

Two periods of winter on the embedded plant with the synthetic year, three days of probing, default configuration. The
fault lasts from the end of the second day to that of the third: a mild day (9 to 12 °C) or, for what a mild day hides,
the coldest of the year. Each fault is run with and without the watch; where the watch did not act, both are the same.
What a fault does is measured too: the error of predictions 6 h ahead on its day, discomfort and cost, beside those
without a fault. Where all three are small it is without consequences, and need not be noticed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.faults.faulty_plant import FaultyPlant
from controllers.monitoring.watch import Judged
from controllers.mpc.state import MPCState
from controllers.registry import build_controller
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation, Plan, PlanStatus
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.card import JUDGED_H
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller

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
_FAULT_DAYS, _RUN_DAYS = (2.0, 3.0), 6.0
# Start day of each period, and the faults that are run there.
_PERIODS: dict[str, tuple[int, tuple[str, ...]]] = {
    "mild": (16, tuple(FAULTS)),
    "cold": (28, ("none", "machine half as fast, no meters", "overridden, not reported")),
}
# Goals: noticed within a day of the change; discomfort beside that without the watch, K·h.
_NOTICED_H, _MORE_KH = 24.0, 1.0
# A fault has consequences from these on, each beside the same days without a fault: RMS error of predictions 6 h ahead,
# K; discomfort, K·h; share of the cost. The first is half of what a competent model may have
# (docs/how-it-works/competence.md).
_ERROR_K, _DISCOMFORT_KH, _COST_SHARE = 0.5, 1.0, 0.1

Row = dict[str, Any]


class RecordedController:
    """A controller whose judged predictions are kept: `judged` by time, s, and lead, while its model was in use."""

    def __init__(self, controller: Controller, model: ThermalModel) -> None:
        self._controller, self.model = controller, model
        self.name, self.step_s, self.horizon_s = controller.name, controller.step_s, controller.horizon_s
        self.judged: dict[tuple[float, int], Judged] = {}

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`."""
        plan = self._controller.plan(observation, state)
        assert isinstance(plan.state, MPCState)
        items = (Judged(*row) for row in plan.state.watch[0].tracks[0].judged)
        self.judged |= {(item.time_s, item.lead): item for item in items}
        return plan

    def error_K(self, from_s: float, to_s: float) -> float:
        """RMS error of predictions 6 h ahead that came due after `from_s`, until `to_s`, K; NaN if there were none."""
        longest = len(JUDGED_H) - 1
        errors = [v.error_K for v in self.judged.values() if v.lead == longest and from_s < v.time_s <= to_s]
        return rms(errors)


@dataclass(frozen=True)
class _Ran:
    """A fault's run with the watch and the one without; `error_K`: RMS error 6 h ahead on the day of the fault."""

    watched: RunResult
    alone: RunResult
    error_K: float


def run_faults_bench(
    *, quick: bool = False, progress: Callable[[str], None] = lambda line: None, stand_back: str = "native"
) -> dict[str, Any]:
    """Run every fault with and without the watch.

    Args:
        quick: without a fault and one fault only, on the mild day.
        progress: callback for progress lines.
        stand_back: who acts while the watch has handed control back: 'native' or 'rule'.
    """
    rows: list[Row] = []
    for period, (start_day, faults) in _PERIODS.items():
        if not quick:
            rows += _period_rows(period, start_day, faults, progress, stand_back)
        elif not rows:
            rows += _period_rows(period, start_day, _QUICK, progress, stand_back)
    return results_json("faults", rows, targets(rows))


def _period_rows(
    name: str, start_day: int, faults: Sequence[str], progress: Callable[[str], None], stand_back: str
) -> list[Row]:
    plant = EmbeddedPlant(synthetic_weather())
    testcase = load_testcase("bestest_hydronic_heat_pump")
    period = replace(plant.period(str(start_day)), scored_s=_RUN_DAYS * DAY_S)
    progress(f"{name} day: probing and identifying")
    model = identify_on(plant, before=period, days=3.0, testcase=testcase)
    from_s, to_s = (period.start_s + days * DAY_S for days in _FAULT_DAYS)

    def followed(fault: Mapping[str, Any], enabled: bool) -> tuple[RunResult, float]:
        options = {"watch": {"enabled": enabled}, "fallback": {"stand_back": stand_back}}
        controller = RecordedController(build_controller("thermoforce_mpc", options, testcase, model), model)
        result = run_closed_loop(FaultyPlant(plant, from_s=from_s, to_s=to_s, **fault), controller, period)
        return result, controller.error_K(from_s, to_s)

    def run(fault: Mapping[str, Any]) -> _Ran:
        watched, error_K = followed(fault, True)
        acted = any(step.plan.status is PlanStatus.WATCH for step in watched.steps)
        return _Ran(watched, followed(fault, False)[0] if acted else watched, error_K)

    rows: list[Row] = []
    none: _Ran | None = None
    for fault in faults:
        progress(f"{name} day: {fault}")
        ran = run(FAULTS[fault])
        none = none or ran  # the first is that without a fault
        rows.append(_row(fault, name, ran, none, from_s, to_s))
    return rows


def _row(fault: str, day: str, ran: _Ran, none: _Ran, from_s: float, to_s: float) -> Row:
    """One fault: hours from its beginning to the first alarm, from its end to the return of control, and what it did.

    `error_6h_K` and `without_fault_K`: RMS error of predictions 6 h ahead on that day, with and without the fault.
    """
    watched, alone = ran.watched, ran.alone
    times = [step.time_s for step in watched.steps if step.plan.status is PlanStatus.WATCH]
    after = [time_s for time_s in times if time_s >= to_s]
    step_s = watched.steps[1].time_s - watched.steps[0].time_s
    back = (max(after) + step_s - to_s) / HOUR_S if after else 0.0
    ended = times and times[-1] == watched.steps[-1].time_s
    more_Kh = alone.kpis["tdis_tot"] - none.alone.kpis["tdis_tot"]
    dearer = alone.kpis["cost_tot"] / none.alone.kpis["cost_tot"] - 1.0
    matters = ran.error_K - none.error_K >= _ERROR_K or more_Kh >= _DISCOMFORT_KH or abs(dearer) >= _COST_SHARE
    return {
        "fault": fault,
        "day": day,
        "noticed_h": (times[0] - from_s) / HOUR_S if times else None,
        "back_h": None if not times or ended else back,
        "watch_steps": len(times),
        "error_6h_K": ran.error_K,
        "without_fault_K": none.error_K,
        "consequences": bool(matters),
        "discomfort_Kh": watched.kpis["tdis_tot"],
        "without_watch_Kh": alone.kpis["tdis_tot"],
        "cost": watched.kpis["cost_tot"],
        "without_watch_cost": alone.kpis["cost_tot"],
        "reason": next((s.plan.why for s in watched.steps if s.plan.status is PlanStatus.WATCH), ""),
    }


def targets(rows: list[Row]) -> list[Target]:
    """Targets; a fault that was not noticed misses its own unless it had no consequences, and then has none."""
    found = []
    for row in rows:
        name = f"{row['fault']}, {row['day']} day"
        if row["fault"] == "none":
            found.append(Target(f"{name}: steps under watch", float(row["watch_steps"]), 0.0))
            continue
        if row["noticed_h"] is not None or row["consequences"]:
            noticed = math.nan if row["noticed_h"] is None else row["noticed_h"]
            # An alarm before the fault is a false one.
            found.append(Target(f"{name}: h to notice", noticed if noticed > 0 else math.nan, _NOTICED_H))
        if row["noticed_h"] is not None:
            back = math.nan if row["back_h"] is None else row["back_h"]
            found.append(Target(f"{name}: h from its end to the return of control", back, 2 * _NOTICED_H))
        more = row["discomfort_Kh"] - row["without_watch_Kh"]
        found.append(Target(f"{name}: discomfort more than without the watch, K·h", more, _MORE_KH))
    return found
