"""The decisions of a run, step by step: who acted and why, the solver, and the first step of each plan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from thermoforce_mpc.data import Array, PlanStatus
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord
from thermoforce_mpc.simulation.report.courses import RESOLUTION
from thermoforce_mpc.simulation.report.packing import Json, exactly, packed, rows_packed

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
