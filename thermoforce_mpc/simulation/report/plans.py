"""The plans of a run over its instants."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice

import numpy as np

from thermoforce_mpc.data import J_PER_KWH, Array, Boundary, Layout
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord
from thermoforce_mpc.simulation.forecasts import price_paid
from thermoforce_mpc.simulation.report.courses import RESOLUTION
from thermoforce_mpc.simulation.report.decisions import thinning
from thermoforce_mpc.simulation.report.packing import Json, exactly, packed, rows_packed, smooth

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
