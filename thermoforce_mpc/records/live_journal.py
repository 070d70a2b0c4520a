"""The journal of a run at a real building: it ends no control, and a controller that is started again goes on in it.

A step has its records as in a simulated run: what was given, decided and set (`step`), and what came of it (`done`),
which is known when the next one begins. What was measured is in it once: the whole record at each start and once a day
(`past`), between them what is new or was changed since (`tail`).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import ACTING, DAY_S, SAMPLED, Array, Block, Boundary, Layout, Measurement, Record
from thermoforce_mpc.errors import StorageError
from thermoforce_mpc.files import plain_json, storage_errors
from thermoforce_mpc.loop.loop import CLOCK_TOLERANCE_S, Decided
from thermoforce_mpc.records.journal import (
    FORMAT,
    NAME,
    DamagedJournal,
    Journal,
    JournalError,
    JournalText,
    Json,
    block_json,
    boundary_rows,
    making_sense,
    measurement_json,
    plan_json,
    read_journal,
    read_run,
    record_json,
    rows_json,
    set_aside,
)
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.version import VERSION

_LOG = logging.getLogger(__name__)
# How often the whole record is written again, s: between, `explain` puts it together from what was new in each step.
_WHOLE_S = DAY_S
# Readings that differ by less are the same, as a share and in their unit.
_SAME = 1e-9

UNNAMED_CURRENCY = "currency"
"""That of a building whose map does not name it."""


@dataclass(frozen=True)
class RealRun:
    """What is run at a real building: `name` of the building, its `zone` of time, `currency`, and the `scenario` that
    says which controller with which options; `command`: the words that began it; `models`: as the record `models`.
    """

    name: str
    zone: str
    currency: str
    scenario: Scenario
    command: tuple[str, ...]
    connection: str
    models: Mapping[str, Any]


@dataclass(frozen=True)
class Given:
    """What a step was decided on: the record as it was read, and the forecast; None and why where there was none."""

    as_read: Record | None
    forecast: Boundary | None
    no_forecast: str = ""


class LiveJournal:
    """Keeps the journal in the folder of a run; whatever fails is in the log, once, and control goes on without it."""

    def __init__(self, folder: Path, run: RealRun) -> None:
        self._folder, self._path, self._run = folder, folder / NAME, run
        self._journal: Journal | None = None
        self._failed = False
        self._index = 0
        self._open_step: Json | None = None
        self._applied: list[Json] = []
        self._loop = self._models = ""
        self._loops: set[str] = set()
        self._forget()

    def origin(self) -> str | None:
        """The instant from which the seconds of the journal that is there count, ISO 8601; None where there is none."""
        try:
            return str(_head(self._path)["building"]["origin"])
        except (JournalError, KeyError, TypeError):
            return None

    def _forget(self) -> None:
        """Begin the next step with all that is known: what was written before may not be."""
        self._seen: Record | None = None
        self._whole_s = float("-inf")
        self._rows: Array | None = None
        self._open_step = None

    def decided(
        self,
        decided: Decided,
        time_s: float,
        given: Given,
        asked: tuple[float, float],
        origin: str,
        layout: Layout,
        *,
        acts: bool = True,
    ) -> None:
        """Write what came of the step before, what is known now, and the decision, before it acts, if it `acts`.

        `asked`: horizon and step of the forecast, s. `origin`, `layout`: as of `LiveBuilding`.
        """
        with self._guarded():
            if self._journal is None:
                self._begin(origin, layout)
            now = self._now(given.as_read, time_s, layout)
            self._close_step(given.as_read, time_s, layout)
            if self._loop != (controller := self._run.scenario.controller.name):
                self._write("loop", {"controller": controller, "goes_on": controller in self._loops})
                self._write("reset", {"asked": {}, "answer": now | {"names": plain_json(asdict(layout.names))}})
                self._loop = controller
                self._loops.add(controller)
            if given.as_read is not None:
                self._write_record(given.as_read)
            rows = None if given.forecast is None else boundary_rows(given.forecast)
            horizon_s, interval_s = asked
            content: Json = {
                "index": self._index,
                "time_s": float(time_s),
                "at": _now(),
                "asked": {"horizon_s": float(horizon_s), "interval_s": float(interval_s)},
                "forecast": None if rows is None else rows_json(rows, self._rows),
                "before": now,
                "notes": list(decided.notes),
                "plan_seconds": float(decided.plan_seconds),
                "forecast_seconds": float(decided.forecast_seconds),
                "seconds": {name: float(value) for name, value in decided.plan.seconds.items()},
                **({"no_forecast": given.no_forecast} if rows is None else {}),
                **({} if acts else {"acts": False}),
                **plan_json(decided.plan, decided.blocks, decided.refused),
            }
            self._write("step", content)
            self._rows = self._rows if rows is None else rows
            self._open_step, self._applied, self._index = content, [], self._index + 1

    def applied(self, block: Block, start_s: float) -> None:
        """Note a block that was set from `start_s` on, s; one that was not taken is one of native control."""
        self._applied.append({"asked": block_json(block), "start_s": float(start_s)})

    def ended(self, why: str) -> None:
        """Note that control has ended, and close."""
        if self._journal is not None:
            with self._guarded():
                self._write("ended", {"at": _now(), "why": why})
        if self._journal is not None:  # a file that was removed is closed already
            self._journal.close()
            self._journal = None

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # a record that cannot be written is no reason to leave a building alone
            self._forget()
            if not self._path.exists() and self._journal is not None:
                self._journal.close()
                self._journal = None
            if not self._failed:
                expected = isinstance(error, StorageError | JournalError)
                _LOG.warning(
                    "the journal is not written, and explain, watch and report do not know of what follows; control "
                    "goes on: %s", error, exc_info=None if expected else error,
                )  # fmt: skip
            self._failed = True
        else:
            if self._failed:
                _LOG.warning("the journal is written again")
            self._failed = False

    def _write(self, kind: str, content: Json) -> None:
        assert self._journal is not None
        self._journal.write(kind, content)

    def _begin(self, origin: str, layout: Layout) -> None:
        """Begin the journal, or go on in the one that is there; one that is of something else is moved aside."""
        building = {
            "name": self._run.name,
            "zone": self._run.zone,
            "currency": self._run.currency,
            "origin": origin,
            "layout": plain_json(asdict(layout)),
        }
        text = self._text_before(building)
        with storage_errors(self._path):
            journal = Journal(self._path, text, durable=True)
        try:
            if text is None:
                head = {"format": FORMAT, "version": VERSION, "command": list(self._run.command), "building": building}
                journal.write("run", head | {"scenario": self._run.scenario.model_dump(mode="json")})
                details = {"connection": self._run.connection}
                info: Json = {"kind": "real", "testcase": self._run.name, "version": VERSION, "weather": "measured"}
                info |= {"description": f"by the connection {self._run.connection}", "details": details}
                journal.write("plant", {"info": info})
            begun = {"at": _now(), "version": VERSION, "command": list(self._run.command)}
            journal.write("begun", begun | {"scenario": self._run.scenario.model_dump(mode="json")})
            if self._models != (models := str(dict(self._run.models))):
                journal.write("models", {"models": dict(self._run.models)})
                self._models = models
        except BaseException:
            journal.close()
            raise
        self._journal = journal

    def _text_before(self, building: Json) -> JournalText | None:
        """What is read of the journal that is there; None where one is begun anew."""
        self._loops, self._loop, self._models, self._index = set(), "", "", 0
        self._forget()
        if not self._path.exists():
            return None
        try:
            text = read_run(self._path)
        except DamagedJournal as damage:
            if not damage.good.entries:
                self._move_aside(str(damage))
                return None
            text = damage.good
            lost = set_aside(self._path, text)
            _LOG.warning("%s. It goes on from there; the rest is in %s", str(damage).split(";")[0], lost)
        except JournalError as error:
            self._move_aside(str(error))
            return None
        with making_sense(self._path):
            there = text.entries[0].content.get("building")
            if there != building:
                self._move_aside(f"{self._path}: is of another building, or of a simulated one")
                return None
            for entry in text.entries:
                if entry.kind == "loop":
                    self._loop = str(entry.content["controller"])
                    self._loops.add(self._loop)
                elif entry.kind == "models":
                    self._models = str(dict(entry.content["models"]))
                elif entry.kind == "step":
                    last = entry
                    self._index += 1
                    self._open_step = {}
                elif entry.kind == "done":
                    self._open_step = None
            if self._open_step is not None:
                self._open_step = dict(last.content)
                self._applied = []
        return text

    def _move_aside(self, why: str) -> None:
        """Move the journal to a name of its own: what is there is not lost."""
        n = next(n for n in range(1, 10_000) if not self._path.with_name(f"{NAME}.{n}").exists())
        aside = self._path.with_name(f"{NAME}.{n}")
        with storage_errors(self._path):
            self._path.rename(aside)
        _LOG.warning("%s: begun anew, the other one is %s now", why, aside)

    def _close_step(self, record: Record | None, time_s: float, layout: Layout) -> None:
        """Write what came of the step that is open, unless it is decided once more; `record`: what is known now."""
        told, self._open_step = self._open_step, None
        if told is None or float(told["time_s"]) >= time_s - CLOCK_TOLERANCE_S:
            return
        applied = self._applied or _as_decided(told)
        ends = [float(one["start_s"]) + float(one["asked"]["duration_s"]) for one in applied]
        advances = []
        for one, end_s in zip(applied, ends, strict=True):
            answer = _measured(record, float(told["time_s"]), end_s, len(applied) > 1, layout)
            advances.append({"asked": one["asked"], "answer": measurement_json(answer)})
        content = {name: told[name] for name in ("index", "notes", "plan_seconds", "forecast_seconds", "seconds")}
        self._write("done", {**content, "advances": advances, "plant_seconds": 0.0})

    def _now(self, record: Record | None, time_s: float, layout: Layout) -> Json:
        """The readings that a step begins with."""
        if record is None:
            nothing = np.full(len(layout.names.zones), np.nan)
            return measurement_json(Measurement(time_s, nothing, np.nan, np.nan, names=layout.names))
        acting: dict[str, Any] = {name: getattr(record, name)[:, -1] for name in ACTING if record.n_steps}
        return measurement_json(
            Measurement(
                float(record.time_s[-1]),
                record.T_zone_C[:, -1],
                float(record.T_out_C[-1]),
                float(record.solar_W_m2[-1]),
                names=record.names,
                **acting,
            )
        )

    def _write_record(self, record: Record) -> None:
        """Write what is new of the record, or was changed since the last one; once a day all of it."""
        now_s = float(record.time_s[-1])
        since = None if self._seen is None or now_s - self._whole_s >= _WHOLE_S else _changed(self._seen, record)
        if since is None:
            self._write("past", {"asked": {"step_s": record.step_s}, "answer": record_json(record)})
            self._whole_s = now_s
        elif since < record.n_steps:
            self._write("tail", {"answer": record_json(record.slice(since, record.n_steps))})
        self._seen = record


def _as_decided(told: Mapping[str, Any]) -> list[Json]:
    """The blocks of a step as they were decided, or of native control where nothing was to be set: of a process that
    was ended in it, nothing else is known.
    """
    start_s, blocks = float(told["time_s"]), list[Json]()
    for block in told["blocks"]:
        native = {"u": [None] * len(block["u"]), "duration_s": float(block["duration_s"])}
        blocks.append({"asked": dict(block) if told.get("acts", True) else native, "start_s": start_s})
        start_s += float(block["duration_s"])
    return blocks


def _measured(record: Record | None, begin_s: float, end_s: float, shared: bool, layout: Layout) -> Measurement:
    """What was measured at the end of a block of the step from `begin_s` on; temperatures between two readings lie on a
    line. `shared`: the step has other blocks, so that its mean level is not that of this one.
    """
    unknown = np.full(len(layout.names.zones), np.nan)
    at = None if record is None else int(np.searchsorted(record.time_s, begin_s - 1.0))
    if record is None or at is None or at >= record.n_steps or abs(float(record.time_s[at]) - begin_s) > 1.0:
        return Measurement(end_s, unknown, np.nan, np.nan, names=layout.names)
    share = float(np.clip((end_s - record.time_s[at]) / (record.time_s[at + 1] - record.time_s[at]), 0.0, 1.0))

    def between(signal: Array) -> Any:
        now, then = signal[..., at], signal[..., at + 1]
        return then if share > 1.0 - 1e-6 else (1.0 - share) * now + share * then

    acting: dict[str, Any] = {name: getattr(record, name)[:, at] for name in ACTING}
    if shared:
        acting["u"] = np.full(len(record.names.actuators), np.nan)
    return Measurement(
        end_s,
        between(record.T_zone_C),
        float(between(record.T_out_C)),
        float(between(record.solar_W_m2)),
        names=record.names,
        **acting,
    )


def _changed(before: Record, now: Record) -> int | None:
    """The first step of `now` that is not as `before` had it; None where `now` does not go on from it."""
    if before.names != now.names or not (before.n_steps and now.n_steps) or before.step_s != now.step_s:
        return None
    shift = before.nearest(float(now.time_s[0]))
    if not 0 <= shift <= before.n_steps or abs(float(before.time_s[shift] - now.time_s[0])) > CLOCK_TOLERANCE_S:
        return None
    first = min(before.n_steps - shift, now.n_steps)
    for names, n in ((SAMPLED, first + 1), (ACTING, first)):
        for name in names:
            old, new = getattr(before, name)[..., shift : shift + n], getattr(now, name)[..., :n]
            # Means over a table that begins later differ in their last digits.
            same = np.isclose(old, new, rtol=_SAME, atol=_SAME, equal_nan=True)
            if not same.all():
                first = min(first, int(np.argmin(np.atleast_2d(same).all(axis=0))))
    return first


def _head(path: Path) -> Mapping[str, Any]:
    """What the first record of a journal says; raises `JournalError`."""
    try:
        entries: Sequence[Any] = read_journal(path, 1).entries
    except DamagedJournal as damage:
        entries = damage.good.entries
    return entries[0].content if entries else {}


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
