"""The parts of a control step in a closed loop with its journal, by processor time, and their shares of the step's."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from thermoforce_mpc.data import Block, Period, Plan
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord, run_closed_loop
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.records.journal import NAME, Journal
from thermoforce_mpc.records.recorded_plant import JournaledPlant

# Parts of `Plan.seconds` by what they are called here.
_PARTS = {"forecast": "free forecast", "estimate": "forced state", "solve": "solve", "check": "check of the plan"}
WHOLE, FORECAST = "whole step, without the plant", _PARTS["forecast"]


class TimedJournal(JournaledPlant):
    """A plant whose journal's records of decisions and of ended steps are timed: `decided_s` and `ended_s` of each."""

    def __init__(self, plant: Plant, journal: Journal) -> None:
        super().__init__(plant, journal)
        self.decided_s: list[float] = []
        self.ended_s: list[float] = []

    def decided(self, index: int, time_s: float, plan: Plan, blocks: Sequence[Block], refused: str) -> Sequence[Block]:
        """See `JournaledPlant.decided`."""
        began = time.perf_counter()
        blocks = super().decided(index, time_s, plan, blocks, refused)
        self.decided_s.append(time.perf_counter() - began)
        return blocks

    def ended(self, record: StepRecord) -> StepRecord:
        """See `JournaledPlant.ended`."""
        began = time.perf_counter()
        record = super().ended(record)
        self.ended_s.append(time.perf_counter() - began)
        return record


@contextmanager
def _by_processor() -> Iterator[None]:
    """The clock of the parts of a step is the processor's, so that other work on the machine counts little."""
    wall, time.perf_counter = time.perf_counter, time.process_time
    try:
        yield
    finally:
        time.perf_counter = wall


def run_timed(plant: Plant, controller: Controller, period: Period) -> tuple[RunResult, dict[str, list[float]]]:
    """A closed loop with a journal, and the seconds of processor of each part of its steps by name."""
    with TemporaryDirectory() as folder, _by_processor():
        journaled = TimedJournal(plant, Journal(Path(folder) / NAME))
        ends = []

        def on_step(step: StepRecord) -> None:
            ends.append(time.perf_counter())

        result = run_closed_loop(journaled, controller, period, on_step=on_step, keeper=journaled)
    # The first step begins with the reset of the plant.
    return result, parts_of(result.steps[1:], journaled.decided_s[1:], journaled.ended_s[1:], np.diff(ends).tolist())


def parts_of(
    steps: Sequence[StepRecord], decided_s: Sequence[float], ended_s: Sequence[float], whole_s: Sequence[float]
) -> dict[str, list[float]]:
    """Seconds of each part of steps that took `whole_s` in all, of which their journal `decided_s` and `ended_s`.

    The forecast of the boundary and the plant are with what of them is recorded where they are asked.
    """
    parts = {name: [step.plan.seconds.get(key, 0.0) for step in steps] for key, name in _PARTS.items()}
    inside = [sum(of_step) for of_step in zip(*parts.values(), strict=True)]
    parts["controller, rest"] = [step.plan_seconds - s for step, s in zip(steps, inside, strict=True)]
    parts["boundary forecast"] = [step.forecast_seconds for step in steps]
    parts["journal"] = [sum(both) for both in zip(decided_s, ended_s, strict=True)]
    # The decision is recorded where the loop's clock of the plant runs already.
    plant = [step.plant_seconds - s for step, s in zip(steps, decided_s, strict=True)]
    without_plant = [all_s - s for all_s, s in zip(whole_s, plant, strict=True)]
    known = [sum(of_step) for of_step in zip(*parts.values(), strict=True)]
    parts["loop, rest"] = [all_s - s for all_s, s in zip(without_plant, known, strict=True)]
    parts[WHOLE] = without_plant
    parts["plant"] = plant
    return parts


def part_rows(solver: str, parts: Mapping[str, Sequence[float]]) -> list[dict[str, Any]]:
    """One row for each part: median of a step, ms, and share of all steps without the plant, %; processor time."""
    whole_s = sum(parts[WHOLE])
    return [
        {
            "part of a step": name,
            "beside": solver,
            "median_ms": 1e3 * float(np.median(values)),
            "share_percent": 100.0 * sum(values) / whole_s,
        }
        for name, values in parts.items()
    ]
