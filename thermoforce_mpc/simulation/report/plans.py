"""Decisions and plans of a run, step by step, as arrays of the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from thermoforce_mpc.data import J_PER_KWH, Array, Boundary, Layout, PlanStatus
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord
from thermoforce_mpc.simulation.forecasts import price_paid
from thermoforce_mpc.simulation.report.courses import RESOLUTION
from thermoforce_mpc.simulation.report.page import Json, exactly, packed, rows_packed, smooth

# Decisions of this many steps are in the page; of longer runs every other step, every fourth, ….
MOST_STEPS = 4_000
# Statuses in the order of the ladder, from the plan as wanted to what acts where nothing else can.
LADDER = tuple(PlanStatus)
_FIRST = ("T_free_C", "T_free_low_C", "T_free_high_C", "T_forced_K")


@dataclass(frozen=True)
class _Decision:
    """What the page shows of a step: a step itself, with its plan and forecast, is many times larger.

    `first`: values of `_FIRST` at the end of the step (4, Z), NaN where nothing was planned.
    """

    time_s: float
    step_s: float
    T_zone_C: Array
    T_free_now_C: Array
    first: Array
    status: int
    acting: tuple[int, ...]
    texts: tuple[str, str, str, str]
    iterations: int
    seconds: float
    parts_s: Mapping[str, float]

    @classmethod
    def of(cls, step: StepRecord) -> _Decision:
        plan, names = step.plan, step.boundary.names
        planned = plan.u.size > 0
        first = [getattr(plan, name)[:, 0] if planned else np.full(len(names.zones), np.nan) for name in _FIRST]
        acting = plan.acting if len(plan.acting) == len(names.actuators) else (plan.status,) * len(names.actuators)
        return cls(
            step.time_s,
            step.boundary.step_s,
            step.T_zone_C,
            plan.T_free_now_C,
            np.array(first),
            LADDER.index(plan.status),
            tuple(LADDER.index(status) for status in acting),
            (plan.why, step.refused, "; ".join(step.notes), plan.solver_status),
            plan.iterations,
            step.plan_seconds,
            plan.seconds,
        )


def thinning(result: RunResult, most: int = MOST_STEPS) -> int:
    """Of how many decisions one is shown, so that there are `most`: 1, 2, 4, …"""
    every = 1
    while len(result.steps) > every * most:
        every *= 2
    return every


def decisions_json(result: RunResult, most: int = MOST_STEPS) -> Json:
    """Status, reason, solver and first predicted step of each decision, one of a kind after the other."""
    every = thinning(result, most)
    decisions = [_Decision.of(step) for step in islice(result.steps, 0, None, every)]
    parts = dict.fromkeys(part for decision in decisions for part in decision.parts_s)
    texts, (why, refused, notes, solver) = _numbered([decision.texts for decision in decisions])
    first = np.array([decision.first for decision in decisions]).transpose(1, 2, 0)
    return {
        "every": every,
        "time_s": exactly(np.array([decision.time_s for decision in decisions])),
        "step_s": exactly(np.array([decision.step_s for decision in decisions])),
        "T_zone_C": rows_packed(np.array([decision.T_zone_C for decision in decisions]).T, RESOLUTION["T"]),
        "T_free_now_C": rows_packed(np.array([decision.T_free_now_C for decision in decisions]).T, RESOLUTION["T"]),
        **{name: rows_packed(rows, RESOLUTION["T"]) for name, rows in zip(_FIRST, first, strict=True)},
        "statuses": [status.value for status in LADDER],
        "status": [decision.status for decision in decisions],
        "acting": list(zip(*(decision.acting for decision in decisions), strict=True)),
        "why": why,
        "refused": refused,
        "notes": notes,
        "solver": solver,
        "iterations": [decision.iterations for decision in decisions],
        "plan_ms": packed(np.array([1e3 * decision.seconds for decision in decisions]), 0.1),
        "parts_ms": {
            part: packed(np.array([1e3 * decision.parts_s.get(part, np.nan) for decision in decisions]), 0.1)
            for part in parts
        },
        "texts": texts,
    }


def _numbered(rows: Iterable[Sequence[str]]) -> tuple[list[str], list[list[int]]]:
    """The different texts of rows (n, k), and k columns of n numbers among them."""
    number_of: dict[str, int] = {}
    numbers = [[number_of.setdefault(text, len(number_of)) for text in row] for row in rows]
    return list(number_of), [list(column) for column in zip(*numbers, strict=True)]


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
    every = _thinning(result, n)
    times, lengths, plans = [], [], []
    last_boundary: Boundary | None = None
    for step in islice(result.steps, 0, None, every):
        times.append(step.time_s)
        lengths.append(step.boundary.step_s)
        plans.append(_rows(step, layout, area_m2))
        last_boundary = step.boundary
    assert last_boundary is not None  # n > 0: there is a step
    Z, A = len(layout.names.zones), len(layout.names.actuators)

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
        "ahead": _bounds_ahead(last_boundary, n),
    }


def _thinning(result: RunResult, n: int) -> int:
    """Of how many plans one is kept, 1, 2, 4, …: all of them are of instants whose decisions are shown."""
    # A byte of each temperature and level, two of the cost.
    per_plan = (4 * len(result.names.zones) + len(result.names.actuators) + 2) * n
    every = thinning(result)
    while len(result.steps) / every * per_plan > MOST_BYTES:
        every *= 2
    return every


def _rows(step: StepRecord, layout: Layout, area_m2: float) -> Mapping[str, Array]:
    """Planned courses of a step by name (rows, N); none where nothing was planned."""
    plan = step.plan
    if not plan.u.size:
        return {}
    return {name: getattr(plan, name) for name in (*TEMPERATURES, "u")} | {"cost": _planned_cost(step, layout, area_m2)}


def _planned_cost(step: StepRecord, layout: Layout, area_m2: float) -> Array:
    """Planned cost per m² until the end of each step (1, N), at the prices it was made with; NaN without power."""
    boundary, u = step.boundary, step.plan.u
    n = min(step.plan.power_W.shape[-1], boundary.n_steps)
    price = price_paid(u[:, :n], boundary.price_per_kWh[:, :n], boundary.heating_price_per_kWh[:, :n], layout)
    spent = (step.plan.power_W[:, :n] * price).sum(axis=0) * boundary.step_s
    return np.asarray(np.cumsum(spent) / J_PER_KWH / area_m2)[None]


def _bounds_ahead(boundary: Boundary, n: int) -> Json:
    """The comfort bounds that the last plan looks ahead to: what was measured ends where it begins."""
    return {
        "time_s": exactly(boundary.time_s[:n]),
        "lower_C": rows_packed(boundary.lower_C[:, :n], RESOLUTION["T"]),
        "upper_C": rows_packed(boundary.upper_C[:, :n], RESOLUTION["T"]),
    }
