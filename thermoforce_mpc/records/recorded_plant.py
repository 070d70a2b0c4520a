"""Plants whose answers are written to a journal; whoever repeats their requests is first given the answers of then.

Everything that a controller gets passes through here, and the same observations give the same plans. A resumed run
therefore plans again what was planned, and its state is that of the run that was killed, whatever controller it is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, TypeVar, cast

from thermoforce_mpc.data import (
    SINGLE,
    Array,
    Block,
    Boundary,
    Commands,
    Levels,
    Measurement,
    Period,
    Plan,
    PlantInfo,
    Record,
)
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.loop.closed_loop import StepRecord, advanced
from thermoforce_mpc.protocols import OutlivingPlant, Plant, RestartingPlant
from thermoforce_mpc.records import journal_values as values
from thermoforce_mpc.records.journal import Journal, JournalEntry, JournalError, making_sense
from thermoforce_mpc.records.journal_values import Json, block_json, measurement_of, repeated_rows
from thermoforce_mpc.records.run_folder import plain_json

_Answer = TypeVar("_Answer")


class RecordedPlant:
    """`Plant` with a record per request.

    While there are records left to catch up with, a simulated plant is advanced again and its answers are compared with
    the journal; a plant that outlives the process (a service) is left alone until the first new request.
    """

    def __init__(
        self, plant: Plant, journal: Journal, entries: Iterable[JournalEntry] = (), *, cut: bool = False
    ) -> None:
        """Wrap `plant`; `entries` are the records to catch up with, `cut`: later ones are lost."""
        self.inside = plant
        """The plant itself, for what is not journaled here."""
        self._journal, self._names = journal, SINGLE
        self._entries = deque(entries)
        self._outlives = isinstance(plant, OutlivingPlant)
        self._away, self._cut = self._outlives and bool(self._entries), cut
        self._periods: dict[str, Period] = {}
        self._reset: Json = {}
        self._last: Measurement | None = None

    @property
    def catching_up(self) -> bool:
        """Whether there are records left."""
        return bool(self._entries)

    @property
    def info(self) -> PlantInfo:
        """That of the plant."""
        return self.inside.info

    def period(self, name: str) -> Period:
        """See `Plant.period`."""
        period = self._answer(
            "period", {"name": name}, lambda: asdict(self.inside.period(name)), lambda told: Period(**told)
        )
        self._periods[name] = period
        return period

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        request: Json = {"start_s": float(start_s), "warmup_s": float(warmup_s), "price": price}

        def call() -> Json:
            measurement = self.inside.reset(start_s, warmup_s, price)
            return self._told(measurement) | {"names": plain_json(asdict(measurement.names))}

        def read(told: Mapping[str, Any]) -> Measurement:
            return measurement_of(told, values.names_of(told["names"]))

        self._last = self._answer("reset", request, call, read)
        self._names, self._reset = self._last.names, request
        return self._last

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """See `Plant.advance` and `RoomSetpointPlant.advance`."""
        block = Block(u, duration_s, command)
        answer = self._advanced(block_json(block), lambda: self._told(advanced(self.inside, block)))
        self._last = measurement_of(answer, self._names)
        return self._last

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        return self._answer(
            "forecast",
            {"horizon_s": float(horizon_s), "interval_s": float(interval_s)},
            lambda: values.pack(values.boundary_rows(self.inside.forecast(horizon_s, interval_s))),
            lambda told: values.boundary_of(values.unpack(told), self._names),
        )

    def past(self, step_s: float) -> Record:
        """See `Plant.past`."""
        return self._answer(
            "past",
            {"step_s": float(step_s)},
            lambda: values.record_json(self.inside.past(step_s)),
            lambda told: values.record_of(told, self._names),
        )

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; asked for once, at the end of a loop."""
        return self._answer("kpis", {}, lambda: values.kpis_json(self.inside.kpis()), values.kpis_of)

    def leave(self) -> None:
        """Leave a plant that outlives us where it stands; nothing for another."""
        if isinstance(self.inside, OutlivingPlant):
            self.inside.leave()

    def close(self) -> None:
        """Close the plant."""
        self.inside.close()

    def noted(self, kind: str, make: Callable[[], Json]) -> Mapping[str, Any]:
        """Record a fact of the run that `make` finds out, or give that of the journal."""
        if self._entries:
            return self._next_entry(kind, {}).content
        content = make()
        self._journal.write(kind, content)
        return content

    def _advanced(self, request: Json, call: Callable[[], Json]) -> Mapping[str, Any]:
        return self._answer("advance", request, call, dict)

    def _answer(
        self,
        kind: str,
        request: Mapping[str, Any],
        call: Callable[[], Json],
        read: Callable[[Mapping[str, Any]], _Answer],
    ) -> _Answer:
        """The answer to a request: the journal's while catching up, else the plant's, which is then recorded."""
        if self._entries:
            entry = self._next_entry(kind, request)
            with making_sense(entry.where):
                recorded = entry.content["answer"]
                answer = read(recorded)
            self._compare(entry, kind, recorded, call)
            return answer
        self._catch_up()
        content = call()
        self._journal.write(kind, {"asked": request, "answer": content})
        return read(content)

    def _told(self, measurement: Measurement) -> Json:
        """A measurement, with how the plant was started again since its reset."""
        restarts = self.inside.restarts if isinstance(self.inside, RestartingPlant) else ()
        return values.measurement_json(measurement) | ({"restarts": list(restarts)} if restarts else {})

    def _compare(self, entry: JournalEntry, kind: str, recorded: object, call: Callable[[], object]) -> None:
        """Have a simulated plant answer again, as it did then; one that outlives the process is not asked.

        One that was started again then is started again now, whether it fails once more or not.
        """
        if isinstance(self.inside, RestartingPlant):
            restarts = recorded.get("restarts", ()) if isinstance(recorded, Mapping) else ()
            with making_sense(entry.where):
                self.inside.restart_as([str(words) for words in restarts])
        if not self._outlives and call() != recorded:
            raise JournalError(
                f"{entry.where}: the plant answers '{kind}' otherwise than it did then. "
                "Was the run made with another version, weather file or machine? Start it again"
            )

    def _catch_up(self) -> None:
        """Take up a plant that outlived the process, before the first new request."""
        if self._away:
            assert isinstance(self.inside, OutlivingPlant)
            if self._last is not None:
                self.inside.go_on(self._last, periods=self._periods, anywhere=self._cut, **self._reset)
            self._away = False

    def _next_entry(self, kind: str, request: Mapping[str, Any]) -> JournalEntry:
        entry = self._entries.popleft()
        if entry.kind != kind or entry.content.get("asked", {}) != request:
            raise self._mismatch(entry, f"'{kind}' {dict(request)}")
        return entry

    def _mismatch(self, entry: JournalEntry, now: str) -> JournalError:
        then = f"'{entry.kind:.20}' {entry.content.get('asked', '')!s:.200}"
        return JournalError(
            f"{entry.where}: then it was {then}, now it is {now}: the run does not repeat "
            "itself. Was it made with another version or other files? Start it again"
        )


class JournaledPlant(RecordedPlant):
    """`Plant` and `StepKeeper` of a closed loop.

    A step has two records: `step`, the forecast and the decision, written before it acts, and `done`, what came of it.
    One would not do: who resumes must know what a plant that outlives the process was told to do. There, each block of
    a step but the last has a record `advance` of its own between the two, so that the plant is never more than one
    ahead.
    """

    def __init__(
        self, plant: Plant, journal: Journal, entries: Iterable[JournalEntry] = (), *, cut: bool = False
    ) -> None:
        """See `RecordedPlant`."""
        super().__init__(plant, journal, entries, cut=cut)
        self._ahead: Json = {}
        self._rows: Array | None = None  # of the last forecast
        self._to_come = 0
        self._advances: list[Mapping[str, Any]] = []
        self.differing = 0
        """Steps that were planned again otherwise than then: a solve that the clock had cut."""

    def _advanced(self, request: Json, call: Callable[[], Json]) -> Mapping[str, Any]:
        """The answer to a block; that to the last of a step is recorded, or read, where the step is `done`."""
        closes = not self._outlives or self._to_come <= 1
        self._to_come -= 1
        if not (self._entries[0].kind == "done" if self._entries else closes):
            return super()._advanced(request, call)
        if self._entries:
            done = self._entries[0]
            with making_sense(done.where):
                advance = (list(done.content["advances"])[len(self._advances) :] or [{}])[0]
                if advance.get("asked") != request:
                    raise self._mismatch(done, f"'advance' {request}")
                measurement_of(advance["answer"], self._names)
            self._compare(done, "advance", advance["answer"], call)
        else:
            self._catch_up()
            advance = {"asked": request, "answer": call()}
        self._advances.append(advance)
        return cast(Mapping[str, Any], advance["answer"])

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`; recorded with the decision that it is made for, also where there was none."""
        request = {"horizon_s": float(horizon_s), "interval_s": float(interval_s)}

        def call() -> Json:
            try:
                rows = values.boundary_rows(self.inside.forecast(horizon_s, interval_s))
                return {"asked": request, "forecast": values.rows_json(rows, self._rows)}
            except NoForecast as error:
                return {"asked": request, "forecast": None, "no_forecast": str(error)}

        if self._entries:
            entry = self._entries[0]
            if entry.kind != "step" or entry.content.get("asked") != request:
                raise self._mismatch(entry, f"'forecast' {request}")
            with making_sense(entry.where):
                recorded = entry.content["forecast"]
                recorded is None or values.boundary_of(repeated_rows(recorded, self._rows), self._names)
            self._compare(entry, "forecast", recorded, lambda: call()["forecast"])
            self._ahead = {name: entry.content.get(name) for name in ("asked", "forecast", "no_forecast")}
        else:
            self._catch_up()
            self._ahead = call()
        if self._ahead["forecast"] is None:
            raise NoForecast(str(self._ahead["no_forecast"]), past=bool(self._entries))
        self._rows = repeated_rows(self._ahead["forecast"], self._rows)
        return values.boundary_of(self._rows, self._names)

    def kpis_so_far(self) -> dict[str, float]:
        """The plant's KPIs for the display; none while a service is not asked."""
        return {} if self._away else self.inside.kpis()

    def decided(self, index: int, time_s: float, plan: Plan, blocks: Sequence[Block], refused: str) -> Sequence[Block]:
        """Record a decision before it acts; while catching up, what acted then acts again."""
        content = {"index": index, "time_s": float(time_s), **self._ahead, **values.plan_json(plan, blocks, refused)}
        self._advances, self._to_come = [], len(blocks)
        if not self._entries:
            self._journal.write("step", content)
            return blocks
        entry = self._next_entry("step", self._ahead["asked"])
        if entry.content.get("index") != index or entry.content.get("time_s") != content["time_s"]:
            raise self._mismatch(entry, f"step {index} at {time_s:.10g} s")
        with making_sense(entry.where):
            recorded = tuple(values.block_of(block) for block in entry.content["blocks"])
        self.differing += entry.content["blocks"] != content["blocks"]
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
