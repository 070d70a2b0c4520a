"""Plants whose answers are written to a journal; whoever repeats their requests is first given the answers of then.

Everything that a controller gets passes through here, and the same observations give the same plans. A resumed run
therefore plans again what was planned, and its state is that of the run that was killed, whatever controller it is.

A probing is kept in a journal of its own: `probing/NAME.jsonl` begins with what was probed and how (`probing`) and ends
with why probing ended (`end`). With an end it is a record that a model can be identified from again; without one, the
probing can go on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

from thermoforce_mpc.data import (
    DAY_S,
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
from thermoforce_mpc.errors import ConfigError, NoForecast
from thermoforce_mpc.files import check_plain, plain_json, storage_errors
from thermoforce_mpc.loop.closed_loop import StepRecord, advanced
from thermoforce_mpc.loop.probing import Probed
from thermoforce_mpc.protocols import Plant, can_restart, outlives
from thermoforce_mpc.records.journal import (
    DamagedJournal,
    Journal,
    JournalEntry,
    JournalError,
    JournalText,
    Json,
    block_json,
    block_of,
    boundary_of,
    boundary_rows,
    kpis_json,
    making_sense,
    measurement_json,
    measurement_of,
    names_of,
    numbers_of,
    pack,
    plan_json,
    read_journal,
    record_json,
    record_of,
    repeated_rows,
    rows_json,
    unpack,
)
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.version import VERSION

_Answer = TypeVar("_Answer")


class RecordedPlant:
    """`Plant` with a record per request.

    While there are records left to catch up with, a simulated plant is advanced again and its answers are compared with
    the journal; a plant that outlives the process (a service) is left alone until the first new request.
    """

    _cut = False
    """Whether records after those to catch up with are lost."""

    def __init__(self, plant: Plant, journal: Journal, entries: Iterable[JournalEntry]) -> None:
        """Wrap `plant`; `entries` are the records to catch up with."""
        self.inside = plant
        """The plant itself, for what is not journaled here."""
        self._journal, self._names = journal, SINGLE
        self._entries = deque(entries)
        self._outlives = outlives(plant)
        self._restarting = plant if can_restart(plant) else None
        self._away = self._outlives and bool(self._entries)
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
            return measurement_of(told, names_of(told["names"]))

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
            lambda: pack(boundary_rows(self.inside.forecast(horizon_s, interval_s))),
            lambda told: boundary_of(unpack(told), self._names),
        )

    def past(self, step_s: float) -> Record:
        """See `Plant.past`."""
        return self._answer(
            "past",
            {"step_s": float(step_s)},
            lambda: record_json(self.inside.past(step_s)),
            lambda told: record_of(told, self._names),
        )

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; asked for once, at the end of a loop."""
        return self._answer("kpis", {}, lambda: kpis_json(self.inside.kpis()), numbers_of)

    def leave(self) -> None:
        """Leave a plant that outlives us where it stands; nothing for another."""
        if outlives(self.inside):
            self.inside.leave()

    def close(self) -> None:
        """Close the plant."""
        self.inside.close()

    def next_told(self, kind: str) -> Mapping[str, Any] | None:
        """The fact that the journal tells next; None where it has to be found out, and `noted`."""
        return self._next_entry(kind, {}).content if self._entries else None

    def noted(self, kind: str, content: Json) -> Mapping[str, Any]:
        """Record a fact of the run, or give that of the journal."""
        told = self.next_told(kind)
        if told is None:
            self._journal.write(kind, content)
        return content if told is None else told

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
        restarts = () if self._restarting is None else self._restarting.restarts
        return measurement_json(measurement) | ({"restarts": list(restarts)} if restarts else {})

    def _compare(self, entry: JournalEntry, kind: str, recorded: object, call: Callable[[], object]) -> None:
        """Have a simulated plant answer again, as it did then; one that outlives the process is not asked.

        One that was started again then is started again now, whether it fails once more or not.
        """
        if self._restarting is not None:
            restarts = recorded.get("restarts", ()) if isinstance(recorded, Mapping) else ()
            with making_sense(entry.where):
                self._restarting.restart_as([str(words) for words in restarts])
        if not self._outlives and call() != recorded:
            raise JournalError(
                f"{entry.where}: the plant answers '{kind}' otherwise than it did then. "
                "Was the run made with another version, weather file or machine? Start it again"
            )

    def _catch_up(self) -> None:
        """Take up a plant that outlived the process, before the first new request."""
        if self._away:
            assert outlives(self.inside)
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
        """See `RecordedPlant`; `cut`: later records are lost."""
        super().__init__(plant, journal, entries)
        self._cut = cut
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

        rows: Array | None = None

        def call() -> Json:
            nonlocal rows
            try:
                rows = boundary_rows(self.inside.forecast(horizon_s, interval_s))
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
        # What was just recorded is what was answered.
        self._rows = repeated_rows(self._ahead["forecast"], self._rows) if rows is None else rows
        return boundary_of(self._rows, self._names)

    def kpis_so_far(self) -> dict[str, float]:
        """The plant's KPIs for the display; none while a service is not asked."""
        return {} if self._away else self.inside.kpis()

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


FOLDER = "probing"
_PROBING_FORMAT = 2


@dataclass(frozen=True)
class ToldProbing:
    """A probing as its journal at `path` tells it, whole or as far as it came."""

    path: Path
    entries: Sequence[JournalEntry]

    @property
    def head(self) -> Mapping[str, Any]:
        """What was probed and how; raises `JournalError` where it is another journal."""
        head = self.entries[0] if self.entries else None
        if head is None or head.kind != "probing" or head.content.get("format") != _PROBING_FORMAT:
            raise JournalError(f"{self.path}: holds no probing of format {_PROBING_FORMAT}; probe again")
        return head.content

    @property
    def days(self) -> float:
        """Days that were probed."""
        with making_sense(self.path):
            return sum(advance["asked"]["duration_s"] for advance in self._advances) / DAY_S

    @property
    def _advances(self) -> Iterator[Mapping[str, Any]]:
        return (entry.content for entry in self.entries if entry.kind == "advance")

    @property
    def has_ended(self) -> bool:
        """Whether it need not go on."""
        return self.entries[-1].kind == "end"

    @property
    def probed(self) -> Probed:
        """The probing; raises `JournalError` where no step was probed."""
        if not self.days:
            raise JournalError(f"{self.path}: was ended before its first step; name another run")
        plant, end = self.head["plant"], self.entries[-1].content
        with making_sense(self.path):
            why = str(end["why"]) if self.has_ended else "its run was ended before its time"
            reset = next(entry.content["answer"] for entry in self.entries if entry.kind == "reset")
            names = names_of(reset["names"])
            record, blocks = Record.beginning(measurement_of(reset, names)), []
            for advance in self._advances:
                record = record.extended(measurement_of(advance["answer"], names))
                blocks.append(block_of(advance["asked"]))
            return Probed(record, tuple(blocks), PlantInfo(**plant), why)


def told_probing(path: Path) -> ToldProbing | None:
    """The probing whose journal is at `path`; None where none has begun. Raises `JournalError` for a damaged one."""
    told = ToldProbing(path, _read(path).entries) if path.exists() else None
    return told if told and told.entries else None


def _read(path: Path) -> JournalText:
    try:
        return read_journal(path)
    except DamagedJournal as damage:
        raise JournalError(f"{damage}; move the file away, and it is probed again") from damage


def find_probing(place: Path, testcase: TestCase, how: Json) -> Probed:
    """The probing of an earlier run, as far as it came: that which was probed as `how` says, or the only one.

    `place`: folder of the run, its folder `probing`, or one of the journals in that; `how`: as of `how_probed`.

    Raises:
        ConfigError: there is none, or several and none is as `how` says.
        JournalError: it is damaged, holds no step, or is of another test case; names the file.
    """
    where = place_of_journals(place)
    if where.is_dir():
        check_plain(where)
    journals = [where] if where.is_file() else sorted(where.glob("*.jsonl"))
    found = [told for path in journals if (told := told_probing(path))]
    alike = [told for told in found if told.head["how"] == how] or found
    if not found:
        raise ConfigError(f"{place}: holds no probing ({FOLDER}/*.jsonl): name the folder of a run that has probed")
    if len(alike) > 1:
        files = ", ".join(str(told.path) for told in alike)
        raise ConfigError(f"{place}: holds several probings, none with the settings of this run: name one of {files}")
    told = alike[0]
    of = {name: told.head.get(name) for name in ("testcase", "names")}
    if of != _building(testcase):
        raise JournalError(
            f"{told.path}: is a probing of {of['testcase']}, not of {testcase.name} as it is now; probe again"
        )
    return told.probed


def place_of_journals(place: Path) -> Path:
    """What is read of a place: the folder `probing` of a run folder; that folder or a journal in it as it is."""
    return place if place.is_file() or place.name == FOLDER else place / FOLDER


@contextmanager
def keeping_probing(plant: Plant, path: Path | None, testcase: TestCase, how: Json) -> Iterator[Plant]:
    """`plant`, whose answers are written to the journal at `path`, if any, as they come, after those that are there.

    Raises:
        JournalError: the journal is damaged (names the line), or another one.
        StorageError: it cannot be written.
    """
    if path is None:
        yield plant
        return
    text = _read(path) if path.exists() else None
    with storage_errors(path):
        path.parent.mkdir(exist_ok=True)
    # A service goes on where a power failure ends us.
    with closing(Journal(path, text, durable=outlives(plant))) as journal:
        kept = RecordedPlant(plant, journal, text.entries if text else ())
        head = {"format": _PROBING_FORMAT, "version": VERSION, **_building(testcase), "how": how}
        kept.noted("probing", {**head, "plant": plain_json(asdict(plant.info))})
        yield kept


def note_end(kept: Plant, why: str) -> None:
    """Note in the journal, where there is one, that the probing has ended."""
    if isinstance(kept, RecordedPlant):
        kept.noted("end", {"why": why})


def _building(testcase: TestCase) -> Json:
    return {"testcase": testcase.name, "names": plain_json(asdict(testcase.layout.names))}
