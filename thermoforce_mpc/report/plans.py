"""Decisions and plans of a run, step by step, as arrays of the page."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from thermoforce_mpc.data import J_PER_KWH, Array, Layout, PlanStatus
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.loop.forecasts import price_paid
from thermoforce_mpc.report.courses import RESOLUTION
from thermoforce_mpc.report.page import Json, exactly, packed, rows_packed, smooth

# Decisions of this many steps are in the page; of longer runs every other step, every fourth, ….
MOST_STEPS = 4_000
# Statuses in the order of the ladder, from the plan as wanted to what acts where nothing else can.
LADDER = tuple(PlanStatus)
_FIRST = ("T_free_C", "T_free_low_C", "T_free_high_C", "T_forced_K")


def _shown(step: StepRecord) -> dict[str, Any]:
    """What the page shows of a step: a step itself, with its plan and forecast, is many times larger."""
    plan, nothing = step.plan, np.full(len(step.boundary.names.zones), np.nan)
    return {
        "time_s": step.time_s,
        "step_s": step.boundary.step_s,
        "T_zone_C": step.T_zone_C,
        "T_free_now_C": plan.T_free_now_C,
        **{name: getattr(plan, name)[:, 0] if plan.u.size else nothing for name in _FIRST},
        "status": LADDER.index(plan.status),
        "acting": [LADDER.index(status) for status in step.acting],
        "texts": (plan.why, step.refused, "; ".join(step.notes), plan.solver_status),
        "iterations": plan.iterations,
        "plan_ms": 1e3 * step.plan_seconds,
        "parts_s": plan.seconds,
    }


def thinning(result: RunResult, most: int = MOST_STEPS) -> int:
    """Of how many decisions one is shown, so that there are `most`: 1, 2, 4, …"""
    every = 1
    while len(result.steps) > every * most:
        every *= 2
    return every


def decisions_json(result: RunResult, most: int = MOST_STEPS) -> Json:
    """Status, reason, solver and first predicted step of each decision, one of a kind after the other."""
    every = thinning(result, most)
    shown = [_shown(step) for step in islice(result.steps, 0, None, every)]
    columns = {name: [row[name] for row in shown] for name in shown[0]}
    number_of: dict[str, int] = {}
    numbers = [[number_of.setdefault(text, len(number_of)) for text in texts] for texts in columns["texts"]]
    why, refused, notes, solver = (list(column) for column in zip(*numbers, strict=True))
    parts = dict.fromkeys(part for seconds in columns["parts_s"] for part in seconds)
    parts_ms = {part: [1e3 * seconds.get(part, np.nan) for seconds in columns["parts_s"]] for part in parts}
    return {
        "every": every,
        "time_s": exactly(np.array(columns["time_s"])),
        "step_s": exactly(np.array(columns["step_s"])),
        **{
            name: rows_packed(np.array(columns[name]).T, RESOLUTION["T"])
            for name in ("T_zone_C", "T_free_now_C", *_FIRST)
        },
        "statuses": [status.value for status in LADDER],
        "status": columns["status"],
        "acting": list(zip(*columns["acting"], strict=True)),
        "why": why,
        "refused": refused,
        "notes": notes,
        "solver": solver,
        "iterations": columns["iterations"],
        "plan_ms": packed(np.array(columns["plan_ms"]), 0.1),
        "parts_ms": {part: packed(np.array(ms), 0.1) for part, ms in parts_ms.items()},
        "texts": list(number_of),
    }


# Bytes of all plans in the page, before base64 adds a third; more are thinned to every other step, every fourth, ….
MOST_BYTES = 1_900_000
# Planned temperatures are rounded to this, K; beyond the second, large changes would cost too much of it.
FINEST_K, _COARSEST_K = 0.01, 0.05
# Rounding of planned levels, which a byte holds.
_LEVEL = 0.01
TEMPERATURES = ("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C")


def plans_json(result: RunResult, layout: Layout, area_m2: float) -> Json | None:
    """The planned courses over the instants of a run, thinned to `MOST_BYTES`; None where nothing was planned.

    All plans have the length of the longest; what a shorter one does not know is NaN.
    """
    n = max((step.plan.u.shape[-1] for step in result.steps), default=0)
    if not n:
        return None
    Z, A = len(layout.names.zones), len(layout.names.actuators)
    # A byte of each temperature and level, two of the cost. All plans are of instants whose decisions are shown.
    every = thinning(result)
    while len(result.steps) / every * (4 * Z + A + 2) * n > MOST_BYTES:
        every *= 2
    times, lengths, plans, last_boundary = [], [], [], result.steps[-1].boundary
    for step in islice(result.steps, 0, None, every):
        times.append(step.time_s)
        lengths.append(step.boundary.step_s)
        plans.append(_courses(step, layout, area_m2))
        last_boundary = step.boundary

    def over(name: str, rows: int) -> Array:
        """Rows of each kept plan (rows, P, n)."""
        values = np.full((rows, len(plans), n), np.nan)
        for p, plan in enumerate(plans):
            if name in plan:
                values[:, p, : plan[name].shape[-1]] = plan[name]
        return values

    return {
        "every": every,
        "n": n,
        "time_s": exactly(np.array(times)),
        "step_s": exactly(np.array(lengths)),
        "known": [bool(plan) for plan in plans],
        **{name: [smooth(row, FINEST_K, _COARSEST_K) for row in over(name, Z)] for name in TEMPERATURES},
        "u": rows_packed(over("u", A), _LEVEL, bits=8),
        "cost": packed(over("cost", 1)[0], RESOLUTION["cost"]),
        # The comfort bounds that the last plan looks ahead to: what was measured ends where it begins.
        "ahead": {
            "time_s": exactly(last_boundary.time_s[:n]),
            "lower_C": rows_packed(last_boundary.lower_C[:, :n], RESOLUTION["T"]),
            "upper_C": rows_packed(last_boundary.upper_C[:, :n], RESOLUTION["T"]),
        },
    }


def _courses(step: StepRecord, layout: Layout, area_m2: float) -> Mapping[str, Array]:
    """Planned courses of a step by name (rows, N); none where nothing was planned.

    `cost` (1, N): per m² until the end of each step, at the prices the plan was made with; NaN without power.
    """
    plan, boundary = step.plan, step.boundary
    if not plan.u.size:
        return {}
    n = min(plan.power_W.shape[-1], boundary.n_steps)
    prices = boundary.price_per_kWh[:, :n], boundary.heating_price_per_kWh[:, :n]
    spent = (plan.power_W[:, :n] * price_paid(plan.u[:, :n], *prices, layout)).sum(axis=0) * boundary.step_s
    cost = np.cumsum(spent)[None] / J_PER_KWH / area_m2
    return {name: getattr(plan, name) for name in (*TEMPERATURES, "u")} | {"cost": cost}
