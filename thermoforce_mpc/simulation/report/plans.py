"""The decisions of a run over its instants: what was planned, how the solver did, who acted and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array, Layout, PlanStatus
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord
from thermoforce_mpc.simulation.report.courses import RESOLUTION, price_paid
from thermoforce_mpc.simulation.report.packing import Json, exactly, packed, rows_packed, smooth

_JOULE_PER_KWH = 3.6e6
# Bytes of all plans in the page, before base64 adds a third; more are thinned to every other step, every fourth, ….
MOST_BYTES = 1_900_000
# Planned temperatures are rounded to this, K; beyond the second, large changes would cost too much of it.
_FINEST_K, _COARSEST_K = 0.01, 0.05
# Reasons, notes and computing times of this many steps; of longer runs every other step, ….
MOST_STEPS = 4_000
# Statuses in the order of the ladder, from the plan as wanted to what acts where nothing else can.
LADDER = tuple(PlanStatus)


def steps_json(result: RunResult) -> Json:
    """Status, reason, solver and first predicted step of each decision, by step."""
    steps = result.steps[:: -(-len(result.steps) // MOST_STEPS)]
    texts: dict[str, int] = {}

    def told(values: Sequence[str]) -> list[int]:
        return [texts.setdefault(text, len(texts)) for text in values]

    plans = [step.plan for step in steps]
    parts = dict.fromkeys(part for plan in plans for part in plan.seconds)
    first = {name: _first(steps, name) for name in ("T_free_C", "T_free_low_C", "T_free_high_C", "T_forced_K")}
    return {
        "every": -(-len(result.steps) // MOST_STEPS),
        "time_s": exactly(np.array([step.time_s for step in steps])),
        "step_s": exactly(np.array([step.boundary.step_s for step in steps])),
        "T_zone_C": rows_packed(np.array([step.T_zone_C for step in steps]).T, RESOLUTION["T"]),
        "T_free_now_C": rows_packed(np.array([plan.T_free_now_C for plan in plans]).T, RESOLUTION["T"]),
        **{name: rows_packed(values, RESOLUTION["T"]) for name, values in first.items()},
        "statuses": [status.value for status in LADDER],
        "status": [LADDER.index(plan.status) for plan in plans],
        "acting": [[LADDER.index(status) for status in row] for row in zip(*map(_acting, steps), strict=True)],
        "why": told([plan.why for plan in plans]),
        "refused": told([step.refused for step in steps]),
        "notes": told(["; ".join(step.notes) for step in steps]),
        "solver": told([plan.solver_status for plan in plans]),
        "iterations": [plan.iterations for plan in plans],
        "plan_ms": packed(np.array([1e3 * step.plan_seconds for step in steps]), 0.1),
        "parts_ms": {
            part: packed(np.array([1e3 * plan.seconds.get(part, np.nan) for plan in plans]), 0.1) for part in parts
        },
        "texts": list(texts),
    }


def plans_json(result: RunResult, layout: Layout, area_m2: float, most_bytes: int = MOST_BYTES) -> Json | None:
    """The planned courses over the instants of a run, thinned to `most_bytes`; None where nothing was planned.

    All plans have the length of the longest; what a shorter one does not know is NaN.
    """
    names = result.names
    n = max((step.plan.u.shape[-1] for step in result.steps), default=0)
    if not n:
        return None
    # A byte of each temperature and level, two of the cost.
    per_plan = (4 * len(names.zones) + len(names.actuators) + 2) * n
    every = 1
    while len(result.steps) / every * per_plan > most_bytes:
        every *= 2
    kept = result.steps[::every]

    def over(rows: int, of: Any) -> Array:
        """Rows of each kept plan (rows, P, n)."""
        found = np.full((rows, len(kept), n), np.nan)
        for i, step in enumerate(kept):
            if step.plan.u.size:
                values = of(step)
                found[:, i, : values.shape[-1]] = values
        return found

    def temperatures(name: str) -> list[Json]:
        rows = over(len(names.zones), lambda step: getattr(step.plan, name))
        return [smooth(row, _FINEST_K, _COARSEST_K) for row in rows]

    return {
        "every": every,
        "n": n,
        "time_s": exactly(np.array([step.time_s for step in kept])),
        "step_s": exactly(np.array([step.boundary.step_s for step in kept])),
        "known": [bool(step.plan.u.size) for step in kept],
        **{name: temperatures(name) for name in ("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C")},
        "u": rows_packed(over(len(names.actuators), lambda step: step.plan.u), 0.01, bits=8),
        "cost": packed(over(1, lambda step: _planned_cost(step, layout, area_m2))[0], RESOLUTION["cost"]),
        "ahead": _bounds_ahead(kept[-1], n),
    }


def _acting(step: StepRecord) -> Sequence[PlanStatus]:
    """Source of the action of each actuator."""
    count = len(step.boundary.names.actuators)
    return step.plan.acting if len(step.plan.acting) == count else (step.plan.status,) * count


def _first(steps: Sequence[StepRecord], name: str) -> Array:
    """First planned value of a signal (rows, steps), NaN where nothing was planned."""
    rows = steps[0].boundary.names.rows(name)
    nothing = np.full(rows, np.nan)
    return np.array([getattr(step.plan, name)[:, 0] if step.plan.u.size else nothing for step in steps]).T


def _planned_cost(step: StepRecord, layout: Layout, area_m2: float) -> Array:
    """Planned cost per m² until the end of each step (1, n), at the prices it was told; NaN without power."""
    boundary, u = step.boundary, step.plan.u
    n = min(step.plan.power_W.shape[-1], boundary.n_steps)
    price = price_paid(u[:, :n], boundary.price_per_kWh[:, :n], boundary.heating_price_per_kWh[:, :n], layout)
    spent = (step.plan.power_W[:, :n] * price).sum(axis=0) * boundary.step_s
    return np.asarray(np.cumsum(spent) / _JOULE_PER_KWH / area_m2)[None]


def _bounds_ahead(step: StepRecord, n: int) -> Json:
    """The comfort bounds that the last plan looks ahead to: what was measured ends where it begins."""
    boundary = step.boundary
    return {
        "time_s": exactly(boundary.time_s[:n]),
        "lower_C": rows_packed(boundary.lower_C[:, :n], RESOLUTION["T"]),
        "upper_C": rows_packed(boundary.upper_C[:, :n], RESOLUTION["T"]),
    }
