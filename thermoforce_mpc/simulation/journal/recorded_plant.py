"""A plant whose answers are written to a journal; whoever repeats its requests is first given the answers of then."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any, TypeVar, cast

from thermoforce_mpc.data import SINGLE, Bands, Block, Boundary, Levels, Measurement, Period, PlantInfo, Record
from thermoforce_mpc.protocols import OutlivingPlant, Plant, RestartingPlant, RoomSetpointPlant
from thermoforce_mpc.simulation.folder.run_folder import plain_json
from thermoforce_mpc.simulation.journal.journal import Entry, Journal, JournalError, making_sense
from thermoforce_mpc.simulation.journal.journal_values import (
    Json,
    block_json,
    boundary_of,
    boundary_rows,
    measurement_json,
    measurement_of,
    names_of,
    number,
    pack,
    record_json,
    record_of,
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
