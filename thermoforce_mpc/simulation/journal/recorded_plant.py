"""Plants whose answers are written to a journal; whoever repeats their requests is first given the answers of then."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, TypeVar, cast

from thermoforce_mpc.data import (
    SINGLE,
    Array,
    Bands,
    Block,
    Boundary,
    Levels,
    Measurement,
    Period,
    Plan,
    PlantInfo,
    Record,
)
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.protocols import OutlivingPlant, Plant, RestartingPlant, RoomSetpointPlant
from thermoforce_mpc.simulation.closed_loop import StepRecord
from thermoforce_mpc.simulation.folder.run_folder import plain_json
from thermoforce_mpc.simulation.journal.journal import Entry, Journal, JournalError, making_sense
from thermoforce_mpc.simulation.journal.journal_values import (
    Json,
    block_json,
    block_of,
    boundary_of,
    boundary_rows,
    measurement_json,
    measurement_of,
    names_of,
    number,
    pack,
    plan_json,
    record_json,
    record_of,
    repeated_rows,
    rows_json,
    unpack,
)

_Answer = TypeVar("_Answer")


class RecordedPlant:
    """`Plant` with a record per request.

    While there are records left to catch up with, a simulated plant is advanced again and its answers are compared with
    the journal; a plant that outlives the process (a service) is left alone until the first new request.
    """

    def __init__(self, plant: Plant, journal: Journal, entries: Iterable[Entry] = (), *, cut: bool = False) -> None:
        """Wrap `plant`; `entries` are the records to catch up with, `cut`: later ones are lost."""
        self._plant, self._journal, self._names = plant, journal, SINGLE
        self._entries = deque(entries)
        self._outlives = isinstance(plant, OutlivingPlant)
        self._away, self._cut = self._outlives and bool(self._entries), cut
        self._periods: dict[str, Period] = {}
        self._reset: Json = {}
        self._last: Measurement | None = None

    @property
    def inside(self) -> Plant:
        """The plant itself, for what is not journaled here."""
        return self._plant

    @property
    def catching_up(self) -> bool:
        """Whether there are records left."""
        return bool(self._entries)

    @property
    def info(self) -> PlantInfo:
        """That of the plant."""
        return self._plant.info

    def period(self, name: str) -> Period:
        """See `Plant.period`."""
        period = self._answer(
            "period", {"name": name}, lambda: self._plant.period(name), asdict, lambda content: Period(**content)
        )
        self._periods[name] = period
        return period

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        request: Json = {"start_s": float(start_s), "warmup_s": float(warmup_s), "price": price}

        def to_json(measurement: Measurement) -> Json:
            return self._told(measurement) | {"names": plain_json(asdict(measurement.names))}

        def from_json(content: Mapping[str, Any]) -> Measurement:
            return measurement_of(content, names_of(content["names"]))

        self._last = self._answer(
            "reset", request, lambda: self._plant.reset(start_s, warmup_s, price), to_json, from_json
        )
        self._names, self._reset = self._last.names, request
        return self._last

    def advance(self, u: Levels, duration_s: float, band_C: Bands = None) -> Measurement:
        """See `Plant.advance` and `RoomSetpointPlant.advance`."""
        request, call = block_json(Block(u, duration_s, band_C)), self._advancing(u, duration_s, band_C)
        answer: Json = self._answer("advance", request, call, dict, Json)
        return self._arrived(answer)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        request = {"horizon_s": float(horizon_s), "interval_s": float(interval_s)}

        def call() -> Boundary:
            return self._plant.forecast(horizon_s, interval_s)

        def to_json(boundary: Boundary) -> Json:
            return pack(boundary_rows(boundary))

        def from_json(content: Mapping[str, Any]) -> Boundary:
            return boundary_of(unpack(content), self._names)

        return self._answer("forecast", request, call, to_json, from_json)

    def past(self, step_s: float) -> Record:
        """See `Plant.past`."""

        def call() -> Record:
            return self._plant.past(step_s)

        request = {"step_s": float(step_s)}
        return self._answer("past", request, call, record_json, lambda content: record_of(content, self._names))

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; asked for once, at the end of a loop."""

        def to_json(kpis: Mapping[str, float]) -> Json:
            return {name: number(value) for name, value in kpis.items()}

        def from_json(content: Mapping[str, Any]) -> dict[str, float]:
            return {name: float("nan") if value is None else float(value) for name, value in content.items()}

        return self._answer("kpis", {}, self._plant.kpis, to_json, from_json)

    def leave(self) -> None:
        """Leave a plant that outlives us where it stands; nothing for another."""
        if isinstance(self._plant, OutlivingPlant):
            self._plant.leave()

    def close(self) -> None:
        """Close the plant."""
        self._plant.close()

    def noted(self, kind: str, make: Callable[[], Json]) -> Mapping[str, Any]:
        """Record a fact of the run that `make` finds out, or give that of the journal."""
        if self._entries:
            return self._next_entry(kind, {}).content
        content = make()
        self._journal.write(kind, content)
        return content

    def _advancing(self, u: Levels, duration_s: float, band_C: Bands) -> Callable[[], Json]:
        """What advances the plant."""

        def call() -> Json:
            if band_C is None:
                return self._told(self._plant.advance(u, duration_s))
            return self._told(cast(RoomSetpointPlant, self._plant).advance(u, duration_s, band_C))

        return call

    def _arrived(self, answer: Mapping[str, Any]) -> Measurement:
        """The measurement of an answer to `advance`, now the last."""
        self._last = measurement_of(answer, self._names)
        return self._last

    def _answer(
        self,
        kind: str,
        request: Mapping[str, Any],
        call: Callable[[], _Answer],
        to_json: Callable[[_Answer], Json],
        from_json: Callable[[Mapping[str, Any]], _Answer],
    ) -> _Answer:
        """The answer to a request: the journal's while catching up, else the plant's, which is then recorded."""
        if self._entries:
            entry = self._next_entry(kind, request)
            with making_sense(entry.where):
                recorded = entry.content["answer"]
                answer = from_json(recorded)
            self._compare(entry, kind, recorded, lambda: to_json(call()))
            return answer
        self._catch_up()
        content = to_json(call())
        self._journal.write(kind, {"asked": request, "answer": content})
        return from_json(content)

    def _told(self, measurement: Measurement) -> Json:
        """A measurement, with how the plant was started again since its reset."""
        restarts = self._plant.restarts if isinstance(self._plant, RestartingPlant) else ()
        return measurement_json(measurement) | ({"restarts": list(restarts)} if restarts else {})

    def _compare(self, entry: Entry, kind: str, recorded: object, call: Callable[[], object]) -> None:
        """Have a simulated plant answer again, as it did then; one that outlives the process is not asked.

        One that was started again then is started again now, whether it fails once more or not.
        """
        if isinstance(self._plant, RestartingPlant):
            restarts = recorded.get("restarts", ()) if isinstance(recorded, Mapping) else ()
            with making_sense(entry.where):
                self._plant.restart_as([str(words) for words in restarts])
        if not self._outlives and call() != recorded:
            raise JournalError(
                f"{entry.where}: the plant answers '{kind}' otherwise than it did then. "
                "Was the run made with another version, weather file or machine? Start it again"
            )

    def _catch_up(self) -> None:
        """Take up a plant that outlived the process, before the first new request."""
        if self._away:
            assert isinstance(self._plant, OutlivingPlant)
            if self._last is not None:
                self._plant.go_on(self._last, periods=self._periods, anywhere=self._cut, **self._reset)
            self._away = False

    def _next_entry(self, kind: str, request: Mapping[str, Any]) -> Entry:
        """The next record, which must be of `kind` and answer `request`."""
        entry = self._entries.popleft()
        if entry.kind != kind or entry.content.get("asked", {}) != request:
            raise self._mismatch(entry, f"'{kind}' {dict(request)}")
        return entry

    def _mismatch(self, entry: Entry, now: str) -> JournalError:
        then = f"'{entry.kind:.20}' {entry.content.get('asked', '')!s:.200}"
        return JournalError(
            f"{entry.where}: then it was {then}, now it is {now}: the run does not repeat "
            "itself. Was it made with another version or other files? Start it again"
        )


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
