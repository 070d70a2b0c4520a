"""The closed loops of a run as its journal tells them, whole or as far as they came."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from boptest_client import safe_text
from thermoforce_mpc.data import DAY_S, Boundary, Period, Plan, PlanStatus
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, sample_of, time_rat
from thermoforce_mpc.simulation.journal.journal import NAME, Entry, JournalError, making_sense, read_run
from thermoforce_mpc.simulation.journal.journal_values import (
    margins_of,
    measurement_of,
    names_of,
    planned_of,
)
from thermoforce_mpc.simulation.journal.told_steps import ToldStep, next_forecast, told_loops, told_steps
from thermoforce_mpc.simulation.kept_steps import KeptSteps


@dataclass(frozen=True)
class ToldRun:
    """A run: its scenario, command and version, what the plant said of itself, its models' records, and its loops.

    A loop that was cut off has no KPIs but those of its `time_rat`.
    """

    scenario: Scenario
    command: tuple[str, ...]
    version: str
    plant: Mapping[str, Any]
    models: Mapping[str, Any]
    results: Mapping[str, RunResult]

    @property
    def cut_off(self) -> tuple[str, ...]:
        """Names of the controllers whose loop has not ended."""
        return tuple(name for name, result in self.results.items() if "ener_tot" not in result.kpis)


def told_run(folder: Path) -> ToldRun:
    """The run whose journal is in `folder`.

    Raises:
        JournalError: there is no journal, it is damaged, or no step of the run has ended.
    """
    path = folder / NAME
    with making_sense(path):
        entries = read_run(path).entries
        first = entries[0]
        scenario = validate(Scenario, dict(first.content["scenario"]), first.where)
        windows = [Period(**entry.content["answer"]) for entry in entries if entry.kind == "period"]
        results = {}
        for name, loop in told_loops(entries).items():
            steps = _kept_steps(loop)
            if steps:
                period = replace(windows[0], scored_s=scenario.days * DAY_S)
                results[name] = _result(name, period, loop, steps)
        if not results:
            raise JournalError(f"{path}: no step has ended yet, so that there is nothing to show")
        return ToldRun(
            scenario,
            tuple(safe_text(word) for word in first.content["command"]),
            safe_text(first.content.get("version")),
            _plant(entries),
            next((entry.content["models"] for entry in entries if entry.kind == "models"), {}),
            results,
        )


def _plant(entries: Sequence[Entry]) -> Mapping[str, Any]:
    """What the plant said of itself, and how it was started again."""
    info: Mapping[str, Any] = next((entry.content["info"] for entry in entries if entry.kind == "plant"), {})
    contents = (entry.content for entry in entries)
    answered = (told for content in contents for told in (content, *content.get("advances", ())))
    restarts = [words for told in answered for words in (told.get("answer") or {}).get("restarts", ())]
    said = {key: safe_text(value) if isinstance(value, str) else value for key, value in info.items()}
    return {**said, "description": safe_text("; ".join([str(info.get("description")), *dict.fromkeys(restarts)]))}


def _kept_steps(loop: Sequence[Entry]) -> KeptSteps[StepRecord]:
    steps: KeptSteps[StepRecord] = KeptSteps()
    for step in _records(loop):
        steps.append(step)
    return steps


def _result(name: str, period: Period, loop: Sequence[Entry], steps: Sequence[StepRecord]) -> RunResult:
    reset = next(entry.content for entry in loop if entry.kind == "reset")
    start = measurement_of(reset["answer"], names_of(reset["answer"]["names"]))
    recorded: Mapping[str, Any] = next((entry.content["answer"] for entry in loop if entry.kind == "kpis"), {})
    kpis = {key: math.nan if value is None else float(value) for key, value in recorded.items()}
    kpis["time_rat"] = time_rat(steps, steps[0].boundary.step_s)
    return RunResult(period, name, kpis, steps, start)


def _records(loop: Sequence[Entry]) -> Iterator[StepRecord]:
    """The steps of a loop that have ended."""
    steps: list[ToldStep] = []
    last_forecast: Boundary | None = None
    for step in told_steps(loop):
        steps.append(step)
        if step.done is None:
            return
        boundary, last_forecast = next_forecast(steps, last_forecast)
        yield _record(step, boundary)
        # Of steps before, only what was measured is asked for: their plans would not fit in memory.
        steps[-1] = replace(step, told={}, done=None)


def _record(step: ToldStep, boundary: Boundary) -> StepRecord:
    decision, end = step.told, step.done
    assert end is not None
    assert step.before is not None
    samples, now_s = [], step.time_s
    for block, reading in zip(step.blocks, step.after, strict=True):
        samples.append(sample_of(now_s, block, reading, boundary))
        now_s = reading.time_s
    return StepRecord(
        index=int(decision["index"]),
        time_s=step.time_s,
        T_zone_C=step.before.T_zone_C,
        boundary=boundary,
        plan=_plan(step, {name: float(s) for name, s in end["seconds"].items()}),
        refused=str(decision["refused"]),
        plan_seconds=float(end["plan_seconds"]),
        forecast_seconds=float(end["forecast_seconds"]),
        plant_seconds=float(end["plant_seconds"]),
        samples=tuple(samples),
        notes=step.notes,
    )


def _plan(step: ToldStep, seconds: Mapping[str, float]) -> Plan:
    decision = step.told
    arrays: dict[str, Any] = planned_of(decision)
    plan = Plan(
        blocks=step.blocks,
        status=PlanStatus(decision["status"]),
        why=str(decision["why"]),
        news=str(decision.get("news", "")),
        solver_status=str(decision["solver_status"]),
        iterations=int(decision["iterations"]),
        export_calls=int(decision["export_calls"]),
        seconds=seconds,
        margins=margins_of(decision),
        names=step.names,
        acting=tuple(PlanStatus(status) for status in decision["acting"]),
    )
    return replace(plan, **arrays)
