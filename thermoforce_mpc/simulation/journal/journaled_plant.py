"""The plant of a closed loop, recorded step by step in the journal of a run.

Everything that a controller gets passes through here, and the same observations give the same plans. A resumed run
therefore plans again what was planned, and its state is that of the run that was killed, whatever controller it is.

A step has two records: `step`, the forecast and the decision, written before it acts, and `done`, what came of it. One
would not do: who resumes must know what a plant that outlives the process was told to do. There, each block of a step
but the last has a record `advance` of its own between the two, so that the plant is never more than one ahead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from thermoforce_mpc.data import Array, Bands, Block, Boundary, Levels, Measurement, Plan
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.simulation.closed_loop import StepRecord
from thermoforce_mpc.simulation.journal.journal import Entry, Journal, making_sense
from thermoforce_mpc.simulation.journal.journal_values import (
    Json,
    block_json,
    block_of,
    boundary_of,
    boundary_rows,
    measurement_of,
    plan_json,
    repeated_rows,
    rows_json,
)
from thermoforce_mpc.simulation.journal.recorded_plant import RecordedPlant


class JournaledPlant(RecordedPlant):
    """`Plant` and `StepKeeper` of a closed loop."""

    def __init__(self, plant: Plant, journal: Journal, entries: Iterable[Entry] = (), *, cut: bool = False) -> None:
        """Wrap `plant`; `entries` are the records to catch up with, `cut`: later ones are lost."""
        super().__init__(plant, journal, entries, cut=cut)
        self._ahead: Json = {}
        self._rows: Array | None = None  # of the last forecast
        self._to_come = 0
        self._advances: list[Json] = []
        self.differing = 0
        """Steps that were planned again otherwise than then: a solve that the clock had cut."""

    def advance(self, u: Levels, duration_s: float, band_C: Bands = None) -> Measurement:
        """See `Plant.advance` and `RoomSetpointPlant.advance`."""
        call = self._advancing(u, duration_s, band_C)
        request = block_json(Block(u, duration_s, band_C))
        done_entry = self._entries[0] if self._entries and self._entries[0].kind == "done" else None
        if done_entry or (not self._entries and (self._to_come <= 1 or not self._outlives)):
            answer = self._closing_answer(request, call, done_entry)
        else:
            answer = self._answer("advance", request, call, dict, dict)
        self._to_come -= 1
        return self._arrived(answer)

    def _closing_answer(self, request: Json, call: Callable[[], Json], done: Entry | None) -> Mapping[str, Any]:
        """The answer to a block that is recorded where the step is `done`, from there while catching up."""
        if done is None:
            self._catch_up()
            self._advances.append({"asked": request, "answer": call()})
            return cast(Mapping[str, Any], self._advances[-1]["answer"])
        with making_sense(done.where):
            advance = (list(done.content["advances"])[len(self._advances) :] or [{}])[0]
            if advance.get("asked") != request:
                raise self._mismatch(done, f"'advance' {request}")
            measurement_of(advance["answer"], self._names)
        self._compare(done, "advance", advance["answer"], call)
        self._advances.append(advance)
        return cast(Mapping[str, Any], advance["answer"])

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`; recorded with the decision that it is made for, also where there was none."""
        request = {"horizon_s": float(horizon_s), "interval_s": float(interval_s)}

        def call() -> Json:
            try:
                rows = boundary_rows(self._plant.forecast(horizon_s, interval_s))
                return {"asked": request, "forecast": rows_json(rows, self._rows)}
            except NoForecast as error:
                return {"asked": request, "forecast": None, "no_forecast": str(error)}

        if self._entries:
            entry = self._entries[0]
            if entry.kind != "step" or entry.content.get("asked") != request:
                raise self._mismatch(entry, f"'forecast' {request}")
            with making_sense(entry.where):
                recorded = entry.content["forecast"]
                recorded is None or boundary_of(repeated_rows(recorded, self._rows), self._names)
            self._compare(entry, "forecast", recorded, lambda: call()["forecast"])
            self._ahead = {name: entry.content.get(name) for name in ("asked", "forecast", "no_forecast")}
        else:
            self._catch_up()
            self._ahead = call()
        if self._ahead["forecast"] is None:
            raise NoForecast(str(self._ahead["no_forecast"]), past=bool(self._entries))
        self._rows = repeated_rows(self._ahead["forecast"], self._rows)
        return boundary_of(self._rows, self._names)

    def kpis_so_far(self) -> dict[str, float]:
        """The plant's KPIs for the display; none while a service is not asked."""
        return {} if self._away else self._plant.kpis()

    def decided(self, index: int, time_s: float, plan: Plan, blocks: Sequence[Block], refused: str) -> Sequence[Block]:
        """Record a decision before it acts; while catching up, what acted then acts again."""
        content = {"index": index, "time_s": float(time_s), **self._ahead, **plan_json(plan, blocks, refused)}
        self._advances, self._to_come = [], len(blocks)
        if not self._entries:
            self._journal.write("step", content)
            return blocks
        entry = self._next_entry("step", self._ahead["asked"])
        if entry.content.get("index") != index or entry.content.get("time_s") != content["time_s"]:
            raise self._mismatch(entry, f"step {index} at {time_s:.10g} s")
        with making_sense(entry.where):
            recorded = tuple(block_of(block) for block in entry.content["blocks"])
        if entry.content["blocks"] != content["blocks"]:
            self.differing += 1
        self._to_come = len(recorded)
        return recorded

    def ended(self, record: StepRecord) -> StepRecord:
        """Record how a step ended; while catching up, give it the computing times of then."""
        seconds = {name: getattr(record, name) for name in ("plan_seconds", "forecast_seconds", "plant_seconds")}
        if not self._entries:
            parts = {name: float(value) for name, value in record.plan.seconds.items()}
            content = {"index": record.index, "advances": self._advances, "notes": list(record.notes)}
            self._journal.write("done", {**content, **seconds, "seconds": parts})
            return record
        entry = self._next_entry("done", {})
        with making_sense(entry.where):
            plan = replace(record.plan, seconds={name: float(s) for name, s in entry.content["seconds"].items()})
            recorded_seconds: dict[str, Any] = {name: float(entry.content[name]) for name in seconds}
        return replace(record, plan=plan, **recorded_seconds)
