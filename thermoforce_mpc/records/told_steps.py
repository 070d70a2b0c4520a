"""The closed loops of a run as its journal tells them, step by step, whole or as far as they came."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from boptest_client import safe_text
from thermoforce_mpc.data import (
    ACTING,
    DAY_S,
    SAMPLED,
    SINGLE,
    Array,
    Block,
    Boundary,
    Layout,
    Measurement,
    Names,
    Period,
    Plan,
    PlanStatus,
    Record,
)
from thermoforce_mpc.data.clock import CLOCK_TOLERANCE_S, seconds_of, words_of
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord, sample_of, time_rat, with_level
from thermoforce_mpc.loop.inputs import empty_forecast, holes
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.model.forecast_gaps import completed, lengthened
from thermoforce_mpc.model.screening import ReadingLimits, screened_history
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.journal import (
    NAME,
    JournalEntry,
    JournalError,
    block_of,
    boundary_of,
    making_sense,
    margins_of,
    measurement_of,
    names_of,
    numbers_of,
    planned_of,
    read_run,
    record_of,
    repeated_rows,
    saving_of,
    tank_of,
)
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate

Json = Mapping[str, Any]
_TEXTS = ("why", "refused", "solver_status", "news", "status")
_MOST_SHOWN = 2_000


@dataclass(frozen=True)
class ToldStep:
    """One step.

    `told` is its record of kind `step`; `before` the readings it began with; `given` the forecast as the plant gave it,
    None where it gave none; `advances` what was asked of the plant in it, and its answers, in order; `done` the record
    that closed it, None while it goes on or where the run ended in it. `past` is the plant's record, where it was asked
    for between the step before and this one; `tail` what is new or was changed of the record of a real building.
    """

    told: Json
    names: Names
    before: Measurement | None
    given: Boundary | None = None
    advances: tuple[Json, ...] = ()
    done: Json | None = None
    past: Json | None = None
    tail: Json | None = None

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
    def notes(self) -> tuple[str, ...]:
        """What was in doubt."""
        notes = self.told.get("notes", ()) if self.done is None else self.done["notes"]
        return tuple(safe_text(note, _MOST_SHOWN) for note in notes)

    @property
    def plan(self) -> Plan:
        """The decision, as far as its record tells it."""
        told, seconds = self.told, self.done["seconds"] if self.done else {}
        plan = Plan(
            blocks=self.blocks,
            status=PlanStatus(told["status"]),
            why=str(told["why"]),
            news=str(told.get("news", "")),
            solver_status=str(told["solver_status"]),
            iterations=int(told["iterations"]),
            variables=int(told["variables"]),
            parameters=int(told["parameters"]),
            seconds={name: float(s) for name, s in seconds.items()},
            margins=margins_of(told),
            names=self.names,
            acting=tuple(PlanStatus(status) for status in told["acting"]),
            saving=saving_of(told),
            hot_water=tank_of(told),
        )
        courses: dict[str, Any] = planned_of(told)
        return replace(plan, **courses)

    def record(self, boundary: Boundary) -> StepRecord:
        """The step, which has ended, as its run kept it; `boundary`: its forecast without gaps."""
        assert self.before is not None
        assert self.done is not None
        samples, now_s = [], self.time_s
        for block, reading in zip(self.blocks, self.after, strict=True):
            samples.append(sample_of(now_s, block, reading, boundary))
            now_s = reading.time_s
        return StepRecord(
            index=int(self.told["index"]),
            time_s=self.time_s,
            T_zone_C=self.before.T_zone_C,
            boundary=boundary,
            plan=self.plan,
            refused=str(self.told["refused"]),
            plan_seconds=float(self.done["plan_seconds"]),
            forecast_seconds=float(self.done["forecast_seconds"]),
            plant_seconds=float(self.done["plant_seconds"]),
            samples=tuple(samples),
            notes=self.notes,
        )

    def forecast(self) -> tuple[Boundary | None, float, int]:
        """The forecast as the run had it before gaps were filled, None where there was none; its step, s, and steps."""
        asked = self.told["asked"]
        step_s = float(asked["interval_s"])
        n_steps = round(float(asked["horizon_s"]) / step_s)
        return None if self.given is None else lengthened(self.given, n_steps, step_s), step_s, n_steps


def told_loops(entries: Sequence[JournalEntry]) -> dict[str, list[JournalEntry]]:
    """The records of each closed loop, by controller."""
    loops: dict[str, list[JournalEntry]] = {}
    current: list[JournalEntry] = []
    for entry in entries:
        if entry.kind == "loop":
            name = safe_text(entry.content["controller"])
            # A controller of a real building may take over again from another one.
            current = loops[name] = loops[name] if entry.content.get("goes_on") and name in loops else []
        elif loops:
            current.append(entry)
    return loops


class StepReader:
    """Puts the steps of a closed loop together from its records, as they come."""

    def __init__(self) -> None:
        self.names: Names = SINGLE
        self.before: Measurement | None = None
        """The latest readings of a step that is closed."""
        self._past: Json | None = None
        self._tail: Json | None = None
        self._rows: Array | None = None  # of the last forecast
        self._step: Json | None = None
        self._advances: list[Json] = []

    @property
    def under_way(self) -> ToldStep | None:
        """The step that was decided and is not closed."""
        return None if self._step is None else self._told(tuple(self._advances), None)

    def read(self, entry: JournalEntry) -> ToldStep | None:
        """Take the next record; the step that it closes, if it does."""
        content = entry.content
        if entry.kind == "reset":
            self.names = names_of(content["answer"]["names"])
            self.before = measurement_of(content["answer"], self.names)
        elif entry.kind == "past":
            self._past, self._tail = content["answer"], None
        elif entry.kind == "tail":
            self._tail = content["answer"]
        elif entry.kind == "step":
            # Texts as a terminal may show them; they name every actuator, so they may be long.
            texts = {key: content[key] for key in _TEXTS if isinstance(content.get(key), str)}
            self._step, self._advances = {**content, **{k: safe_text(v, _MOST_SHOWN) for k, v in texts.items()}}, []
            if content["forecast"] is not None:
                self._rows = repeated_rows(content["forecast"], self._rows)
            if "before" in content:
                self.before = measurement_of(content["before"], self.names)
        elif entry.kind == "advance":
            self._advances.append(content)
        elif entry.kind == "done" and self._step is not None:
            step = self._told((*self._advances, *content["advances"]), content)
            self.before, self._past, self._tail, self._step = (step.after or (self.before,))[-1], None, None, None
            return step
        return None

    def _told(self, advances: tuple[Json, ...], done: Json | None) -> ToldStep:
        assert self._step is not None
        given = None
        if self._rows is not None and self._step["forecast"] is not None:
            given = boundary_of(self._rows, self.names)
        return ToldStep(self._step, self.names, self.before, given, advances, done, self._past, self._tail)


def told_steps(entries: Sequence[JournalEntry]) -> Iterator[ToldStep]:
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
    first = max((i for i, step in enumerate(steps) if step.past is not None), default=-1)
    if (past := steps[first].past) is None:
        raise JournalError("the journal does not hold the record that the run began with")
    record = record_of(past, steps[first].names)
    if any("before" in step.told or step.tail is not None for step in steps[first:]):  # of a real building
        for step in steps[first + 1 :]:
            record = record if step.tail is None else spliced(record, record_of(step.tail, step.names))
        return screened_history(record, ReadingLimits(u_min=-1.0))[0]
    ends = []
    for step in steps[first:-1]:
        parts = [(b.duration_s, with_level(reading, b)) for b, reading in zip(step.blocks, step.after, strict=True)]
        ends.append(parts[-1][1].averaged_with(parts))
    # Limits that need a model or a floor area are left to the notes of the run.
    return screened_history(record.extended(*ends), ReadingLimits(u_min=-1.0))[0]


def forecast_of(steps: Sequence[ToldStep]) -> Boundary:
    """The forecast of the last of `steps` (all of a loop until then), its gaps filled as in the run."""

    def is_whole(step: ToldStep) -> bool:
        forecast, _, _ = step.forecast()
        return forecast is not None and not holes(forecast)

    # Gaps are filled from the forecast before: what came before one without gaps does not count.
    first = next((i for i in range(len(steps) - 1, 0, -1) if is_whole(steps[i])), 0)
    last_forecast = None
    for i in range(first, len(steps)):
        forecast, last_forecast = _next_forecast(steps[: i + 1], last_forecast)
    return forecast


def _next_forecast(steps: Sequence[ToldStep], last: Boundary | None) -> tuple[Boundary, Boundary | None]:
    """The forecast of the last of `steps` as in the run (`Forecasts`), and what gaps of the next are filled from.

    `last`: what gaps of this one are filled from, None at the begin of a loop.
    """
    forecast, step_s, n_steps = steps[-1].forecast()
    if forecast is None:
        history = history_before(steps)
        return completed(empty_forecast(history, n_steps, step_s), history, last)[0], last
    no_weather = not np.isfinite(forecast.T_out_C).any()  # as where there is no forecast
    if holes(forecast):
        forecast = completed(forecast, history_before(steps), last)[0]
    return forecast, last if no_weather else forecast


def spliced(record: Record, tail: Record) -> Record:
    """`record`, from the begin of `tail` on as that has it; raises `ValueError` where it does not go on there."""
    at = int(np.searchsorted(record.time_s, float(tail.time_s[0]) - CLOCK_TOLERANCE_S))
    if at >= record.time_s.size or abs(float(record.time_s[at] - tail.time_s[0])) > CLOCK_TOLERANCE_S:
        raise ValueError(f"a record that goes on at {float(tail.time_s[0]):.10g} s, where there is none")
    joined = {
        name: np.concatenate([getattr(record, name)[..., :at], getattr(tail, name)], axis=-1)
        for name in (*SAMPLED, *ACTING)
    }
    meter_W = np.append(record.meter_W[:at], tail.meter_W) if record.meter_W.size and tail.meter_W.size else np.empty(0)
    return Record(**joined, meter_W=meter_W, origin=record.origin, names=record.names)


@dataclass(frozen=True)
class ToldBuilding:
    """The building of a run: that of a test case, or a real one, whose seconds count from `origin`."""

    name: str
    layout: Layout
    currency: str
    area_m2: float
    origin: pd.Timestamp | None = None

    @property
    def is_real(self) -> bool:
        """Whether it is a building that goes on without us."""
        return self.origin is not None

    def in_words(self, time_s: float) -> str:
        """A time for people: day from 0 and clock, at a real building the date."""
        if self.origin is None:
            return words_of(time_s)
        return f"{self.origin + pd.Timedelta(seconds=time_s):%a %d %b %Y %H:%M}"

    def seconds_of(self, at: str) -> float:
        """The seconds of a time as people write it; at a real building also a date with its year.

        Raises `InputError` for what is none.
        """
        if self.origin is not None and len(at) > 10 and at[:4].isdigit():
            try:
                there = pd.Timestamp(at)
                there = there.tz_localize(self.origin.tz) if there.tz is None else there
                return float((there - self.origin).total_seconds())
            except ValueError as error:
                raise InputError(f"--at {at}: not a time; write '2026-01-17 06:30'") from error
        return seconds_of(at)


def told_building(head: Mapping[str, Any]) -> ToldBuilding:
    """The building of the run whose first record is `head`; raises `ConfigError` where its test case is not known."""
    content = head.get("building")
    if content is None:
        testcase = load_testcase(str(head["scenario"]["testcase"]))
        return ToldBuilding(testcase.name, testcase.layout, testcase.currency, testcase.area_m2)
    told = dict(content["layout"])
    names = names_of(told.pop("names"))
    areas = tuple(float("nan") if area is None else float(area) for area in told.pop("floor_area_m2"))
    exclusive = tuple(tuple(group) for group in told.pop("exclusive"))
    others: dict[str, Any] = {key: tuple(each) for key, each in told.items()}
    layout = Layout(names, floor_area_m2=areas, exclusive=exclusive, **others)
    origin = pd.Timestamp(content["origin"]).tz_convert(content["zone"])
    return ToldBuilding(safe_text(content["name"]), layout, safe_text(content["currency"]), sum(areas), origin)


@dataclass(frozen=True)
class ToldRun:
    """A run: its scenario, building, command and version, what the plant said of itself, models, and its loops.

    A loop that was cut off has no KPIs but those of its `time_rat`.
    """

    scenario: Scenario
    building: ToldBuilding
    command: tuple[str, ...]
    version: str
    plant: Json
    models: Json
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
        building = told_building(first.content)
        windows = [Period(**entry.content["answer"]) for entry in entries if entry.kind == "period"]
        results = {}
        for name, loop in told_loops(entries).items():
            if steps := _ended_steps(loop):
                reset = next(entry.content["answer"] for entry in loop if entry.kind == "reset")
                kpis = next((numbers_of(entry.content["answer"]) for entry in loop if entry.kind == "kpis"), {})
                kpis["time_rat"] = time_rat(steps, steps[0].boundary.step_s)
                if building.is_real:
                    last = steps[-1].samples[-1]
                    ended_s = last.start_s + last.duration_s
                    period = Period(name, steps[0].time_s, ended_s - steps[0].time_s, 0.0)
                else:
                    period = replace(windows[0], scored_s=scenario.days * DAY_S)
                start = measurement_of(reset, names_of(reset["names"]))
                results[name] = RunResult(period, name, kpis, steps, start)
        if not results:
            raise JournalError(f"{path}: no step has ended yet, so that there is nothing to show")
        return ToldRun(
            scenario,
            building,
            tuple(safe_text(word) for word in first.content["command"]),
            safe_text(first.content.get("version")),
            _plant(entries),
            models_before(entries),
            results,
        )


def models_before(entries: Sequence[JournalEntry]) -> Json:
    """The models by controller that are noted in `entries`, of several times the last; empty without any."""
    found: Json = {}
    for entry in entries:
        if entry.kind == "models":
            found = {**found, **entry.content["models"]}
    return found


def _plant(entries: Sequence[JournalEntry]) -> Json:
    """What the plant said of itself, and how it was started again."""
    info: Json = next((entry.content["info"] for entry in entries if entry.kind == "plant"), {})
    contents = (entry.content for entry in entries)
    answered = (told for content in contents for told in (content, *content.get("advances", ())))
    restarts = [words for told in answered for words in (told.get("answer") or {}).get("restarts", ())]
    said = {key: safe_text(value) if isinstance(value, str) else value for key, value in info.items()}
    return {**said, "description": safe_text("; ".join([str(info.get("description")), *dict.fromkeys(restarts)]))}


def _ended_steps(loop: Sequence[JournalEntry]) -> KeptSteps[StepRecord]:
    kept: KeptSteps[StepRecord] = KeptSteps()
    steps: list[ToldStep] = []
    last_forecast: Boundary | None = None
    for step in told_steps(loop):
        steps.append(step)
        if step.done is None:
            break
        boundary, last_forecast = _next_forecast(steps, last_forecast)
        kept.append(step.record(boundary))
        # Of steps before, only what was measured is asked for: their plans and forecasts would not fit in memory.
        steps[-1] = replace(step, told={}, given=None, done=None)
    return kept
