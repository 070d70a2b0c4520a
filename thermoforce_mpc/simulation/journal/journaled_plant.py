"""A plant whose answers are written to the journal of a run; a resumed run first catches up with what is told there.

Everything that a controller is told passes through here, and the same observations give the same plans. A resumed run
therefore plans again what was planned, and its state is that of the run that was killed, whatever controller it is.

A step has two records: `step`, the forecast and the decision, written before it acts, and `done`, what came of it. One
would not do: who resumes must know what a plant that outlives the process was told to do. There, each block of a step
but the last has a record `advance` of its own between the two, so that the plant is never more than one ahead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar, cast

from thermoforce_mpc.data import (
    SINGLE,
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
from thermoforce_mpc.protocols import OutlivingPlant, Plant, RoomSetpointPlant
from thermoforce_mpc.simulation.closed_loop import StepRecord
from thermoforce_mpc.simulation.journal.journal import Entry, Journal, JournalError, making_sense
from thermoforce_mpc.simulation.journal.journal_values import (
    Json,
    block_json,
    block_of,
    boundary_json,
    boundary_of,
    measurement_json,
    measurement_of,
    names_json,
    names_of,
    number,
    period_json,
    plan_json,
    record_json,
    record_of,
)

_Answer = TypeVar("_Answer")


class JournaledPlant:
    """`Plant` and `StepKeeper` of a closed loop.

    While there are records left to catch up with, a simulated plant is advanced again and its answers are compared with
    the journal; a plant that outlives the process (a service) is left alone until the first new request.
    """

    def __init__(self, plant: Plant, journal: Journal, told: Iterable[Entry] = ()) -> None:
        """Wrap `plant`; `told` are the records to catch up with."""
        self._plant, self._journal, self._names = plant, journal, SINGLE
        self._told = deque(told)
        self._outlives = isinstance(plant, OutlivingPlant)
        self._away = self._outlives and bool(self._told)
        self._periods: dict[str, Period] = {}
        self._reset: Json = {}
        self._last: Measurement | None = None
        self._ahead: Json = {}
        self._to_come = 0
        self._answers: list[Json] = []
        self.differing = 0
        """Steps that were planned again otherwise than then: a solve that the clock had cut."""

    @property
    def inside(self) -> Plant:
        """The plant itself, for what is not journaled."""
        return self._plant

    @property
    def catching_up(self) -> bool:
        """Whether there are records left."""
        return bool(self._told)

    @property
    def info(self) -> PlantInfo:
        """That of the plant."""
        return self._plant.info

    def period(self, name: str) -> Period:
        """See `Plant.period`."""
        found = self._answered(
            "period", {"name": name}, lambda: self._plant.period(name), period_json, lambda told: Period(**told)
        )
        self._periods[name] = found
        return found

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        asked: Json = {"start_s": float(start_s), "warmup_s": float(warmup_s), "price": price}

        def to_json(measurement: Measurement) -> Json:
            return measurement_json(measurement) | {"names": names_json(measurement.names)}

        def from_json(told: Mapping[str, Any]) -> Measurement:
            return measurement_of(told, names_of(told["names"]))

        self._last = self._answered(
            "reset", asked, lambda: self._plant.reset(start_s, warmup_s, price), to_json, from_json
        )
        self._names, self._reset = self._last.names, asked
        return self._last

    def advance(self, u: Levels, duration_s: float, band_C: Bands = None) -> Measurement:
        """See `Plant.advance` and `RoomSetpointPlant.advance`."""

        def ask() -> Measurement:
            if band_C is None:
                return self._plant.advance(u, duration_s)
            return cast(RoomSetpointPlant, self._plant).advance(u, duration_s, band_C)

        asked = block_json(Block(u, duration_s, band_C))
        done = self._told[0] if self._told and self._told[0].kind == "done" else None
        if done or (not self._told and (self._to_come <= 1 or not self._outlives)):
            answer = self._closing(asked, ask, done)
        else:
            answer = self._answered("advance", asked, lambda: measurement_json(ask()), dict, dict)
        self._to_come -= 1
        self._last = measurement_of(answer, self._names)
        return self._last

    def _closing(self, asked: Json, ask: Callable[[], Measurement], done: Entry | None) -> Mapping[str, Any]:
        """The answer to a block that is recorded where the step is `done`, from there while catching up."""
        if done is None:
            self._catch_up()
            self._answers.append({"asked": asked, "answer": measurement_json(ask())})
            return cast(Mapping[str, Any], self._answers[-1]["answer"])
        with making_sense(done.where):
            told = (list(done.content["advances"])[len(self._answers) :] or [{}])[0]
            if told.get("asked") != asked:
                raise self._another(done, f"'advance' {asked}")
            measurement_of(told["answer"], self._names)
        self._compared(done, "advance", told["answer"], lambda: measurement_json(ask()))
        self._answers.append(told)
        return cast(Mapping[str, Any], told["answer"])

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`; recorded with the decision that it is made for, also where there was none."""
        asked = {"horizon_s": float(horizon_s), "interval_s": float(interval_s)}

        def ask() -> Json:
            try:
                return {"asked": asked, "forecast": boundary_json(self._plant.forecast(horizon_s, interval_s))}
            except NoForecast as error:
                return {"asked": asked, "forecast": None, "no_forecast": str(error)}

        if self._told:
            entry = self._told[0]
            if entry.kind != "step" or entry.content.get("asked") != asked:
                raise self._another(entry, f"'forecast' {asked}")
            with making_sense(entry.where):
                then = entry.content["forecast"]
                then is None or boundary_of(then, self._names)
            self._compared(entry, "forecast", then, lambda: ask()["forecast"])
            self._ahead = {name: entry.content.get(name) for name in ("asked", "forecast", "no_forecast")}
        else:
            self._catch_up()
            self._ahead = ask()
        if self._ahead["forecast"] is None:
            raise NoForecast(str(self._ahead["no_forecast"]), past=bool(self._told))
        return boundary_of(self._ahead["forecast"], self._names)

    def past(self, step_s: float) -> Record:
        """See `Plant.past`."""

        def ask() -> Record:
            return self._plant.past(step_s)

        asked = {"step_s": float(step_s)}
        return self._answered("past", asked, ask, record_json, lambda told: record_of(told, self._names))

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; asked for once, at the end of a loop."""

        def to_json(kpis: Mapping[str, float]) -> Json:
            return {name: number(value) for name, value in kpis.items()}

        def from_json(told: Mapping[str, Any]) -> dict[str, float]:
            return {name: float("nan") if value is None else float(value) for name, value in told.items()}

        return self._answered("kpis", {}, self._plant.kpis, to_json, from_json)

    def kpis_so_far(self) -> dict[str, float]:
        """The plant's KPIs for the display; none while a service is not asked."""
        return {} if self._away else self._plant.kpis()

    def close(self) -> None:
        """Close the plant."""
        self._plant.close()

    def noted(self, kind: str, make: Callable[[], Json]) -> Mapping[str, Any]:
        """Record a fact of the run that `make` finds out, or give that of the journal."""
        if self._told:
            return self._next(kind, {}).content
        content = make()
        self._journal.write(kind, content)
        return content

    def decided(self, index: int, time_s: float, plan: Plan, blocks: Sequence[Block], refused: str) -> Sequence[Block]:
        """Record a decision before it acts; while catching up, what acted then acts again."""
        said = {"index": index, "time_s": float(time_s), **self._ahead, **plan_json(plan, blocks, refused)}
        self._answers, self._to_come = [], len(blocks)
        if not self._told:
            self._journal.write("step", said)
            return blocks
        entry = self._next("step", self._ahead["asked"])
        if entry.content.get("index") != index or entry.content.get("time_s") != said["time_s"]:
            raise self._another(entry, f"step {index} at {time_s:.10g} s")
        with making_sense(entry.where):
            then = tuple(block_of(told) for told in entry.content["blocks"])
        if entry.content["blocks"] != said["blocks"]:
            self.differing += 1
        self._to_come = len(then)
        return then

    def ended(self, record: StepRecord) -> StepRecord:
        """Record how a step ended; while catching up, give it the computing times of then."""
        seconds = {name: getattr(record, name) for name in ("plan_seconds", "forecast_seconds", "plant_seconds")}
        if not self._told:
            parts = {name: float(value) for name, value in record.plan.seconds.items()}
            said = {"index": record.index, "advances": self._answers, "notes": list(record.notes)}
            self._journal.write("done", {**said, **seconds, "seconds": parts})
            return record
        entry = self._next("done", {})
        with making_sense(entry.where):
            plan = replace(record.plan, seconds={name: float(s) for name, s in entry.content["seconds"].items()})
            then: dict[str, Any] = {name: float(entry.content[name]) for name in seconds}
        return replace(record, plan=plan, **then)

    def _answered(
        self,
        kind: str,
        asked: Mapping[str, Any],
        ask: Callable[[], _Answer],
        to_json: Callable[[_Answer], Json],
        from_json: Callable[[Mapping[str, Any]], _Answer],
    ) -> _Answer:
        """The answer to a request: the journal's while catching up, else the plant's, which is then recorded."""
        if self._told:
            entry = self._next(kind, asked)
            with making_sense(entry.where):
                found = from_json(entry.content["answer"])
            self._compared(entry, kind, entry.content["answer"], lambda: to_json(ask()))
            return found
        self._catch_up()
        answer = to_json(ask())
        self._journal.write(kind, {"asked": asked, "answer": answer})
        return from_json(answer)

    def _compared(self, entry: Entry, kind: str, then: object, ask: Callable[[], object]) -> None:
        """Have a simulated plant answer again, as it did then; one that outlives the process is not asked."""
        if not self._outlives and ask() != then:
            raise JournalError(
                f"{entry.where}: the plant answers '{kind}' otherwise than it did then. "
                "Was the run made with another version, weather file or machine? Start it again"
            )

    def _catch_up(self) -> None:
        """Take up a plant that outlived the process, before the first new request."""
        if self._away:
            assert isinstance(self._plant, OutlivingPlant)
            if self._last is not None:
                self._plant.go_on(self._last, periods=self._periods, **self._reset)
            self._away = False

    def _next(self, kind: str, asked: Mapping[str, Any]) -> Entry:
        """The next record, which must be of `kind` and answer what is asked."""
        entry = self._told.popleft()
        if entry.kind != kind or entry.content.get("asked", {}) != asked:
            raise self._another(entry, f"'{kind}' {dict(asked)}")
        return entry

    def _another(self, entry: Entry, now: str) -> JournalError:
        then = f"'{entry.kind:.20}' {entry.content.get('asked', '')!s:.200}"
        return JournalError(
            f"{entry.where}: then it was {then}, now it is {now}: the run does not repeat "
            "itself. Was it made with another version or other files? Start it again"
        )
