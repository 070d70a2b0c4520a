"""The closed loops of a run as its journal tells them, step by step, whole or as far as they came."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from boptest_client import safe_text
from thermoforce_mpc.data import (
    DAY_S,
    SIGNALS,
    SINGLE,
    Array,
    Block,
    Boundary,
    Measurement,
    Names,
    Period,
    Plan,
    PlanStatus,
    Record,
)
from thermoforce_mpc.model.forecast_gaps import completed, lengthened
from thermoforce_mpc.model.screening import Limits, screened_history
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, sample_of, time_rat, with_level
from thermoforce_mpc.simulation.forecasts import empty_forecast, holes
from thermoforce_mpc.simulation.journal.journal import NAME, Entry, JournalError, making_sense, read_run
from thermoforce_mpc.simulation.journal.journal_values import (
    block_of,
    boundary_of,
    margins_of,
    measurement_of,
    names_of,
    planned_of,
    record_of,
    repeated_rows,
)
from thermoforce_mpc.simulation.kept_steps import KeptSteps

Json = Mapping[str, Any]
_TEXTS = ("why", "refused", "solver_status", "news", "status")
_MOST_SHOWN = 2_000


@dataclass(frozen=True)
class ToldStep:
    """One step.

    `told` is its record of kind `step`; `before` the readings it began with; `given` the forecast as the plant gave it,
    None where it gave none; `advances` what was asked of the plant in it, and its answers, in order; `done` the record
    that closed it, None while it goes on or where the run ended in it. `past` is the plant's record, where it was asked
    for between the step before and this one.
    """

    told: Json
    names: Names
    before: Measurement | None
    given: Boundary | None = None
    advances: tuple[Json, ...] = ()
    done: Json | None = None
    past: Json | None = None

    @property
    def time_s(self) -> float:
        """Its begin, s since 1 January."""
        return float(self.told["time_s"])

    @property
    def blocks(self) -> tuple[Block, ...]:
        """What the plant was asked to apply, in order."""
        return tuple(block_of(advance["asked"]) for advance in self.advances)

    @property
    def after(self) -> tuple[Measurement, ...]:
        """The readings at the end of each block."""
        return tuple(measurement_of(advance["answer"], self.names) for advance in self.advances)

    @property
    def record(self) -> Record | None:
        """The plant's record of `past`."""
        return None if self.past is None else record_of(self.past, self.names)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was in doubt."""
        return () if self.done is None else tuple(safe_text(note, _MOST_SHOWN) for note in self.done["notes"])


def _safe(decision: Json) -> dict[str, str]:
    """The texts of a decision as a terminal may show them; they name every actuator, so they may be long."""
    return {key: safe_text(decision[key], _MOST_SHOWN) for key in _TEXTS if isinstance(decision.get(key), str)}


def told_loops(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """The records of each closed loop, by controller."""
    loops: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry.kind == "loop":
            loops[safe_text(entry.content["controller"])] = []
        elif loops:
            next(reversed(loops.values())).append(entry)
    return loops


class StepReader:
    """Puts the steps of a closed loop together from its records, as they come."""

    def __init__(self) -> None:
        self.names: Names = SINGLE
        self.before: Measurement | None = None
        """The latest readings of a step that is closed."""
        self._past: Json | None = None
        self._rows: Array | None = None  # of the last forecast
        self._step: Json | None = None
        self._advances: list[Json] = []

    @property
    def under_way(self) -> ToldStep | None:
        """The step that was decided and is not closed."""
        if self._step is None:
            return None
        return self._told(tuple(self._advances), None)

    def read(self, entry: Entry) -> ToldStep | None:
        """Take the next record; the step that it closes, if it does."""
        content = entry.content
        if entry.kind == "reset":
            self.names = names_of(content["answer"]["names"])
            self.before = measurement_of(content["answer"], self.names)
        elif entry.kind == "past":
            self._past = content["answer"]
        elif entry.kind == "step":
            self._step, self._advances = {**content, **_safe(content)}, []
            if content["forecast"] is not None:
                self._rows = repeated_rows(content["forecast"], self._rows)
        elif entry.kind == "advance":
            self._advances.append(content)
        elif entry.kind == "done" and self._step is not None:
            step = self._told((*self._advances, *content["advances"]), content)
            self.before, self._past, self._step = (step.after or (self.before,))[-1], None, None
            return step
        return None

    def _told(self, advances: tuple[Json, ...], done: Json | None) -> ToldStep:
        assert self._step is not None
        given = None
        if self._rows is not None and self._step["forecast"] is not None:
            given = boundary_of(self._rows, self.names)
        return ToldStep(self._step, self.names, self.before, given, advances, done, self._past)


def told_steps(entries: Sequence[Entry]) -> Iterator[ToldStep]:
    """The steps of a closed loop, in order; the last may be under way."""
    reader = StepReader()
    for entry in entries:
        step = reader.read(entry)
        if step is not None:
            yield step
    if reader.under_way is not None:
        yield reader.under_way


def history_before(steps: Sequence[ToldStep]) -> Record:
    """The record that the last of `steps` (all of a loop until then) was decided on, implausible readings left out.

    Raises:
        JournalError: the journal does not hold the plant's record before the loop.
    """
    first = max((i for i, step in enumerate(steps) if step.past is not None), default=None)
    if first is None:
        raise JournalError("the journal does not hold the record that the run began with")
    record = steps[first].record
    assert record is not None
    ends = [_readings_at_end(step) for step in steps[first:-1]]
    if ends:
        columns = {
            name: np.concatenate(
                [getattr(record, name), np.stack([np.asarray(getattr(end, name)) for end in ends], axis=-1)], axis=-1
            )
            for name in SIGNALS
        }
        record = Record(**columns, names=record.names)
    # Limits that need a model or a floor area are left to the notes of the run.
    return screened_history(record, Limits(lowest=-1.0))[0]


def forecast_of(steps: Sequence[ToldStep]) -> Boundary:
    """The forecast of the last of `steps` (all of a loop until then), its gaps filled as in the run.

    Raises:
        JournalError: as `history_before`.
    """
    # Gaps are filled from the forecast before: what came before one without gaps does not count.
    first = next((i for i in range(len(steps) - 1, 0, -1) if not _has_gaps(steps[i])), 0)
    last_forecast = None
    for i in range(first, len(steps)):
        forecast, last_forecast = next_forecast(steps[: i + 1], last_forecast)
    return forecast


def next_forecast(steps: Sequence[ToldStep], last: Boundary | None) -> tuple[Boundary, Boundary | None]:
    """The forecast of the last of `steps` as in the run (`Forecasts`), and what gaps of the next are filled from.

    `last`: what gaps of this one are filled from, None at the begin of a loop. Raises as `history_before`.
    """
    forecast = _lengthened(steps[-1])
    if forecast is None:
        history = history_before(steps)
        step_s, n_steps = _forecast_grid(steps[-1])
        return completed(empty_forecast(history, n_steps, step_s), history, last)[0], last
    if holes(forecast):
        forecast = completed(forecast, history_before(steps), last)[0]
    return forecast, forecast


def _has_gaps(step: ToldStep) -> bool:
    forecast = _lengthened(step)
    return forecast is None or bool(holes(forecast))


def _lengthened(step: ToldStep) -> Boundary | None:
    """The forecast of a step as the run had it before gaps were filled; None where the plant gave none."""
    step_s, n_steps = _forecast_grid(step)
    return None if step.given is None else lengthened(step.given, n_steps, step_s)


def _forecast_grid(step: ToldStep) -> tuple[float, int]:
    """Step, s, and number of steps of the forecast that was asked for."""
    step_s = float(step.told["asked"]["interval_s"])
    return step_s, round(float(step.told["asked"]["horizon_s"]) / step_s)


def _readings_at_end(step: ToldStep) -> Measurement:
    """The readings at the end of a step, with its mean levels, as the run saw them."""
    parts = [(b.duration_s, with_level(reading, b)) for b, reading in zip(step.blocks, step.after, strict=True)]
    return parts[-1][1].averaged_with(parts)


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
