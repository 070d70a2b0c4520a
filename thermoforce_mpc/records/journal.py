"""Journal of a run: an append-only file of JSON lines, each with a checksum that goes on from the line before.

A line is `{"n":…,"kind":…,…,"crc":"…"}`; `crc` is the CRC-32 of the text before it, begun with the checksum of
the line before, so that a changed, missing or exchanged line is found. A record is written at once and handed to the
system: a killed process loses none. What a crash left half-written at the end is dropped when the journal is read.

A journal that is damaged in the middle holds until there: what comes after is a consequence of what cannot be read. It
can be cut there (`read_journal` with `most`, `set_aside`), and goes on from its last good record.

What travels between plant and controller is JSON there: exact, with null where there is no number. Long arrays are
packed: float64 by rows, zlib, base64.
"""

from __future__ import annotations

import base64
import json
import math
import os
import shlex
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from boptest_client import safe_text
from thermoforce_mpc.data import (
    ACTING,
    AT_THE_METER,
    CONDITIONS,
    SIGNALS,
    Array,
    Block,
    Boundary,
    HotWaterPlan,
    Measurement,
    Names,
    Plan,
    PlannedSaving,
    Record,
)
from thermoforce_mpc.errors import DataError, InputError, StorageError, counted
from thermoforce_mpc.files import open_plain, storage_errors, written
from thermoforce_mpc.version import VERSION

Json = dict[str, Any]

_MOST_VALUES = 20_000_000

# Arrays of a plan that a journal keeps for people, and to what they are rounded: a resumed run plans again.
_KELVIN = ("T_free_now_C", "T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "lower_C", "upper_C", "slack_K")
_ROUNDED = {"u": 0.001, **dict.fromkeys(_KELVIN, 0.01), "power_W": 1.0}
_OF_TANK = {**dict.fromkeys(("command", "T_C", "low_C", "lower_C"), 0.01), "share": 0.001, "power_W": 1.0}
_OF_TANK_IN_ALL = ("cost", "cost_alone", "below_Kh", "below_alone_Kh", "solves", "gap", "T_now_C")
_NOTHING = -(2**31)
_READINGS = ("T_out_C", "solar_W_m2", "T_zone_C", *ACTING)


def _deflated(content: bytes, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> str:
    packing = zlib.compressobj(strategy=strategy)
    return base64.b64encode(packing.compress(content) + packing.flush()).decode()


def _inflated(text: str, shapes: Sequence[Sequence[int]], each: int) -> bytes:
    """The bytes of arrays of `shapes`, `each` a value; raises `ValueError` for more than any record holds."""
    size = sum(math.prod(shape) for shape in shapes)
    if not size <= _MOST_VALUES or any(n < 0 for shape in shapes for n in shape):
        raise ValueError(f"arrays of shapes {shapes}")
    return zlib.decompressobj().decompress(base64.b64decode(text), each * size + 1)


def pack(rows: Array) -> Json:
    """An array as JSON."""
    content = np.ascontiguousarray(rows, dtype="<f8").tobytes()
    return {"shape": list(rows.shape), "zlib": _deflated(content)}


def unpack(packed: Mapping[str, Any]) -> Array:
    """The array of `pack`; raises `ValueError` for what it did not make."""
    shape = [int(n) for n in packed["shape"]]
    content = _inflated(packed["zlib"], [shape], 8)
    return np.asarray(np.frombuffer(content, dtype="<f8").reshape(shape), dtype=np.float64)


def number(value: float) -> float | str | None:
    """A number as JSON: null for NaN, 'inf' and '-inf' in words."""
    value = float(value)
    return None if math.isnan(value) else value if math.isfinite(value) else str(value)


def kpis_json(kpis: Mapping[str, float]) -> Json:
    """KPIs by name."""
    return {name: number(value) for name, value in kpis.items()}


def numbers_of(content: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of `number`, by name, as `kpis_json` writes them."""
    return {name: math.nan if value is None else float(value) for name, value in content.items()}


def names_of(content: Mapping[str, Any]) -> Names:
    """The names (`Names`), as a terminal may show them."""
    zones, actuators, machines = (tuple(map(safe_text, content[key])) for key in ("zones", "actuators", "machines"))
    return Names(zones, actuators, machines)


def measurement_json(measurement: Measurement) -> Json:
    """A measurement without the plant's own points: its time, and its values as float64 in base64."""
    rows = [np.atleast_1d(getattr(measurement, name)) for name in _READINGS]
    values = np.concatenate(rows).astype("<f8").tobytes()
    return {"time_s": number(measurement.time_s), "values": base64.b64encode(values).decode()}


def measurement_of(content: Mapping[str, Any], names: Names) -> Measurement:
    """The measurement of `measurement_json`; raises `ValueError` where it is of other `names`."""
    values = np.frombuffer(base64.b64decode(content["values"]), "<f8")
    sizes = [1, 1, *(names.rows(name) for name in _READINGS[2:])]
    if values.size != sum(sizes):
        raise ValueError(f"{values.size} readings where there are {sum(sizes)}")
    signals: dict[str, Any] = dict(zip(_READINGS, np.split(values, np.cumsum(sizes)[:-1]), strict=True))
    signals |= {name: float(signals[name][0]) for name in _READINGS[:2]}
    return Measurement(float(content["time_s"]), names=names, **signals)


def record_json(record: Record) -> Json:
    """A record."""
    of_meter = ("meter_W",) if record.meter_W.size else ()
    return {name: pack(getattr(record, name)) for name in (*SIGNALS, *of_meter)}


def record_of(content: Mapping[str, Any], names: Names) -> Record:
    """The record of `record_json`."""
    of_meter = ("meter_W",) if "meter_W" in content else ()
    return Record(**{name: unpack(content[name]) for name in (*SIGNALS, *of_meter)}, names=names)


def boundary_rows(boundary: Boundary) -> Array:
    """Boundary conditions, all rows in one array (rows, N + 1); where there is anything at the meter, that too."""
    rows = [np.atleast_2d(getattr(boundary, name)) for name in CONDITIONS]
    at_meter = [getattr(boundary, name) for name in AT_THE_METER]
    if any(row.size for row in at_meter):
        rows += [row[None] if row.size else np.full((1, boundary.time_s.size), np.nan) for row in at_meter]
    return np.vstack(rows)


def boundary_of(rows: Array, names: Names) -> Boundary:
    """The boundary conditions of `boundary_rows`."""
    signals: dict[str, Any] = {}
    at = 0
    for name in CONDITIONS:
        single = name in ("time_s", "T_out_C", "solar_W_m2")
        n = 1 if single else names.rows(name)
        signals[name], at = rows[at] if single else rows[at : at + n], at + n
    at_meter = zip(AT_THE_METER, rows[at:], strict=rows.shape[0] > at)
    signals |= {name: row for name, row in at_meter if not np.isnan(row).all()}
    return Boundary(**signals, names=names)


def rows_json(rows: Array, before: Array | None) -> Json:
    """A forecast (`boundary_rows`): how many columns are those of the one `before` from which on, and the others."""
    at = n = 0
    if before is not None:
        at = int(np.searchsorted(before[0], rows[0, 0]))
        n = min(before.shape[1] - at, rows.shape[1])
        if not np.array_equal(before[:, at : at + n], rows[:, :n], equal_nan=True):
            at = n = 0
    return {"from": at, "same": n, "new": pack(rows[:, n:])}


def repeated_rows(content: Mapping[str, Any], before: Array | None) -> Array:
    """The rows of `rows_json`; raises `ValueError` where `before` is not what it was then."""
    new, at, n = unpack(content["new"]), int(content["from"]), int(content["same"])
    if not n:
        return new
    if before is None or not 0 <= at <= at + n <= before.shape[1]:
        there = 0 if before is None else before.shape[1]
        raise ValueError(f"a forecast that repeats {n} columns from {at} on of one of {there}")
    return np.hstack([before[:, at : at + n], new])


def block_json(block: Block) -> Json:
    """Levels, duration and, where there are any, commands: numbers, or room set-points as pairs."""
    content: Json = {"u": list(block.u), "duration_s": float(block.duration_s)}
    if any(command is not None for command in block.command):
        content["command"] = [
            [float(value) for value in command] if isinstance(command, tuple) else command for command in block.command
        ]
    return content


def block_of(content: Mapping[str, Any]) -> Block:
    """The block of `block_json`."""
    commands = [
        tuple(map(float, command)) if isinstance(command, list) else command for command in content.get("command") or ()
    ]
    return Block(content["u"], float(content["duration_s"]), commands or None)


def plan_json(plan: Plan, blocks: Sequence[Block], refused: str) -> Json:
    """A decision: who acted and why, what is applied, and the planned course."""
    content: Json = {
        "status": plan.status.value,
        "acting": [status.value for status in plan.acting],
        "why": plan.why,
        "refused": refused,
        "solver_status": plan.solver_status,
        "iterations": int(plan.iterations),
        "variables": int(plan.variables),
        "parameters": int(plan.parameters),
        "blocks": [block_json(block) for block in blocks],
    }
    if plan.news:
        content["news"] = plan.news
    if plan.margins:
        content["margins"] = {name: np.round(values, 4).tolist() for name, values in plan.margins.items()}
    if plan.u.size:
        content["plan"] = _courses_json(plan, _ROUNDED)
    if plan.saving is not None:
        content["saving"] = {name: number(round(value, 4)) for name, value in asdict(plan.saving).items()}
    if (tank := plan.hot_water) is not None:
        in_all = {name: number(round(getattr(tank, name), 4)) for name in _OF_TANK_IN_ALL}
        content["hot_water"] = in_all | {"courses": _courses_json(tank, _OF_TANK)}
    return content


def _courses_json(of: object, units: Mapping[str, float]) -> Json:
    """Courses by name, rounded to `units`: changes from value to value of all, their four bytes apart, in zlib."""
    courses = [np.asarray(getattr(of, name), dtype=np.float64) for name in units]
    values = np.concatenate([course.ravel() / unit for course, unit in zip(courses, units.values(), strict=True)])
    codes = np.where(np.abs(values) < -_NOTHING, np.rint(values), _NOTHING).astype(np.int32)
    change = np.diff(codes, prepend=np.int32(0))
    # Each row begins with its value itself.
    lengths = [n for course in courses for n in [course.shape[-1]] * (course.size // max(course.shape[-1], 1))]
    begins = np.cumsum([0, *lengths[:-1]])
    change[begins] = codes[begins]
    shapes = [list(course.shape) for course in courses]
    # Small changes of either sign become small numbers without one.
    octets = ((change << 1) ^ (change >> 31)).astype("<u4").view(np.uint8).reshape(-1, 4).T
    # Nearly all that repeats are runs: to look for them alone takes an eighth of the time of zlib's best effort, for
    # 861 bytes a plan instead of 853 (default run, two weeks, 2026-11-29).
    return {"shapes": shapes, "zlib": _deflated(octets.tobytes(), zlib.Z_RLE)}


def planned_of(told: Mapping[str, Any]) -> dict[str, Array]:
    """The planned courses of a decision by name, NaN where there is no number; empty where nothing was planned."""
    return _courses_of(told["plan"], _ROUNDED) if "plan" in told else {}


def saving_of(told: Mapping[str, Any]) -> PlannedSaving | None:
    """What the commands of a decision save; None where none were planned."""
    return PlannedSaving(**numbers_of(told["saving"])) if "saving" in told else None


def tank_of(told: Mapping[str, Any]) -> HotWaterPlan | None:
    """What a decision planned for the tank of hot water; None without one."""
    if "hot_water" not in told:
        return None
    courses: dict[str, Any] = _courses_of(told["hot_water"]["courses"], _OF_TANK)
    command = tuple(None if math.isnan(value) else value for value in courses.pop("command").tolist())
    in_all: dict[str, Any] = numbers_of({name: told["hot_water"][name] for name in _OF_TANK_IN_ALL})
    return HotWaterPlan(command, **courses, **in_all | {"solves": int(in_all["solves"])})


def _courses_of(content: Mapping[str, Any], units: Mapping[str, float]) -> dict[str, Array]:
    """The courses of `_courses_json`, NaN where there is no number."""
    shapes = [[int(n) for n in shape] for shape in content["shapes"]]
    octets = np.frombuffer(_inflated(content["zlib"], shapes, 4), np.uint8).reshape(4, -1)
    z = np.ascontiguousarray(octets.T).view("<u4").ravel().astype(np.uint32)
    change = (z >> 1).astype(np.int32) ^ -(z & 1).astype(np.int32)
    courses, at = {}, 0
    for name, shape in zip(units, shapes, strict=True):
        n = math.prod(shape)
        codes = np.cumsum(change[at : at + n].reshape(shape), axis=-1, dtype=np.int32)
        courses[name] = np.where(codes == _NOTHING, np.nan, codes * units[name])
        at += n
    return courses


def margins_of(told: Mapping[str, Any]) -> dict[str, Array]:
    """The margins of a decision (`Plan.margins`); empty where nothing was planned."""
    return {str(name): np.asarray(values, dtype=np.float64) for name, values in dict(told.get("margins", {})).items()}


NAME = "journal.jsonl"
FORMAT = 6
_CRC = ',"crc":"'
# The longest record, that of the longest plant's past, has some 10 MB.
MOST_LINE_BYTES = 100_000_000


class JournalError(InputError):
    """A journal is missing, damaged, of another version, or not that of the run it is resumed with."""


class DamagedJournal(JournalError):
    """A record before the last does not hold. `good`: what can be read before it."""

    def __init__(self, message: str, good: JournalText) -> None:
        super().__init__(message)
        self.good = good


@dataclass(frozen=True)
class JournalEntry:
    """One record: its line in its file, from 1; its kind; what it says, or its bytes in the file; and the file."""

    line: int
    kind: str
    told: Mapping[str, Any] | range
    path: Path = Path(NAME)

    @property
    def content(self) -> Mapping[str, Any]:
        """What it says, read anew each time: a long journal does not fit in memory. Raises `JournalError`."""
        if isinstance(self.told, Mapping):
            return self.told
        try:
            with os.fdopen(open_plain(self.path, os.O_RDONLY), "rb") as file:
                file.seek(self.told.start)
                content: dict[str, Any] = json.loads(file.read(len(self.told)))
            del content["kind"], content["crc"]
        except (OSError, ValueError, KeyError) as error:
            raise JournalError(f"{self.where}: cannot be read any more ({error}); was it changed meanwhile?") from error
        return content

    @property
    def where(self) -> str:
        """File and line, for an error message."""
        return f"{self.path}, line {self.line}"


@contextmanager
def making_sense(where: str | Path) -> Iterator[None]:
    """Refuse a record, of a journal that is whole, which does not hold what its kind holds; raises `JournalError`."""
    try:
        yield
    except (DataError, KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, zlib.error) as error:
        raise JournalError(
            f"{where}: cannot be made sense of ({type(error).__name__}: {str(error)[:200]}); was it edited? "
            "Start the run again"
        ) from error


class JournalText(NamedTuple):
    """The records of a journal; `size`, bytes, and `crc` are those at the end of the last. `torn`: more follows it."""

    entries: tuple[JournalEntry, ...]
    size: int
    crc: int
    torn: bool


class Journal:
    """Appends records to a journal."""

    def __init__(self, path: Path, after: JournalText | None = None, *, durable: bool = False) -> None:
        """Begin a journal at `path`, or go on `after` what was read from it; a torn end is cut off.

        `durable`: wait for the disk after every record, so that a power failure loses none either.
        """
        self.path, self._durable = path, durable
        after = after or JournalText((), 0, 0, False)
        self._n, self._size, self._crc = len(after.entries), after.size, after.crc
        self._file = _opened(path, self._size)

    @property
    def records(self) -> int:
        """Number of records."""
        return self._n

    def write(self, kind: str, content: Mapping[str, Any]) -> None:
        """Append one record; the journal ends with the one before where `StorageError` is raised."""
        record = {"n": self._n, "kind": kind, **content}
        text = json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":"))[:-1]
        body = text.encode(errors="backslashreplace")  # half a surrogate, as in the name of a file: \\udcff is JSON too
        crc = zlib.crc32(body, self._crc)
        line = body + f'{_CRC}{crc:08x}"}}\n'.encode()
        with storage_errors(self.path):
            if os.fstat(self._file).st_nlink == 0:
                raise StorageError(f"{self.path}: was removed during the run; what follows cannot be recorded")
            try:
                unwritten = memoryview(line)
                while unwritten:
                    unwritten = unwritten[os.write(self._file, unwritten) :]
                if self._durable:
                    os.fsync(self._file)
            except OSError:
                os.ftruncate(self._file, self._size)
                raise
        self._n, self._size, self._crc = self._n + 1, self._size + len(line), crc

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_run(path: Path, most: int | None = None) -> JournalText:
    """Read the journal of a run, as `read_journal`, and check that this release can make sense of it."""
    try:
        journal = read_journal(path, most)
    except DamagedJournal as damage:
        n = len(damage.good.entries) + 1
        if n == 1:
            raise JournalError(f"{damage}; nothing can be read before it: start the run again") from damage
        resume = f"`tf-mpc resume {shlex.quote(str(path.parent))} --from {n}`"
        raise DamagedJournal(f"{damage}; {resume} goes on from the last good one", damage.good) from damage
    first = journal.entries[0] if journal.entries else None
    if first is None or first.kind != "run":
        raise JournalError(f"{path}: holds no run: it was ended before it began; start it again")
    version = first.content.get("format")
    if version != FORMAT:
        wrote = first.content.get("version")
        raise JournalError(
            f"{path}: is of format {version!r:.20}, written by thermoforce-mpc {wrote!s:.20}; this release reads "
            f"format {FORMAT}: {'' if wrote == VERSION else 'use that release, or '}start the run again"
        )
    return journal


def read_journal(path: Path, most: int | None = None) -> JournalText:
    """Read and check the journal at `path`, or its first `most` records; a last record that is not whole is left out.

    Raises:
        JournalError: there is no journal.
        DamagedJournal: a record before the last is damaged; names the place and what is lost.
    """
    entries: list[JournalEntry] = []
    size = crc = 0
    lines = lines_of(path)
    for line in lines:
        record = None if len(entries) == most else _checked_record(line, crc, len(entries))
        if record is None:
            good = JournalText(tuple(entries), size, crc, True)
            if len(entries) != most and next(lines, None) is not None:
                raise _damaged(path, good)
            return good
        content, crc = record
        entries.append(JournalEntry(len(entries) + 1, str(content["kind"]), range(size, size + len(line) - 1), path))
        size += len(line)
    return JournalText(tuple(entries), size, crc, False)


def _damaged(path: Path, good: JournalText) -> DamagedJournal:
    """The error of a journal of which only `good` can be read, with what is lost."""
    closes = [b'"kind":"done"' in line for line in lines_of(path, good.size)]
    lost = f"{counted(len(closes), 'line')} from there on cannot be relied on"
    lost += f", with {sum(closes)} steps" * any(closes)
    where = f"{path}, line {len(good.entries) + 1}"
    return DamagedJournal(f"{where}: the record is damaged, its checksum does not hold; {lost}", good)


def lines_of(path: Path, at: int = 0) -> Iterator[bytes]:
    """The lines of a journal from byte `at` on, with their ends, which the last may lack; raises `JournalError`."""
    try:
        with os.fdopen(open_plain(path, os.O_RDONLY), "rb") as file:
            file.seek(at)
            while line := file.readline(MOST_LINE_BYTES + 1):
                if len(line) > MOST_LINE_BYTES:
                    raise JournalError(f"{path}: a line of more than {MOST_LINE_BYTES:,} bytes, longer than any record")
                yield line
    except FileNotFoundError as error:
        raise JournalError(f"{path}: no such file; give the folder of a run") from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise JournalError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def set_aside(path: Path, good: JournalText) -> Path:
    """Move what comes after `good` to a file beside the journal, and return that file; raises `StorageError`."""
    aside = path.with_name(f"{path.name}.lost")
    with written(aside, follow=False) as there, there.open("wb") as file:
        file.writelines(lines_of(path, good.size))
    os.close(_opened(path, good.size))
    return aside


class JournalTail:
    """Reads a journal that is being written: each time what is new and whole. It never writes.

    Raises `JournalError` as `read_journal`, also where the journal is another one than before.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._at, self._n, self._crc = path, 0, 0, 0

    def more(self, most: int | None = None) -> list[JournalEntry]:
        """The records that were written since the last call, `most` at a time."""
        entries: list[JournalEntry] = []
        for line in lines_of(self.path, self._at):
            if not line.endswith(b"\n") or len(entries) == most:
                break
            record = _checked_record(line, self._crc, self._n)
            if record is None:
                raise JournalError(
                    f"{self.path}, line {self._n + 1}: the record is damaged, its checksum does not hold, or another "
                    "run was begun in this folder"
                )
            content, self._crc = record
            self._at, self._n = self._at + len(line), self._n + 1
            entries.append(JournalEntry(self._n, str(content.pop("kind")), content, self.path))
        return entries


def _opened(path: Path, size: int) -> int:
    """Descriptor of a file to append to, cut to `size` bytes; made where it is not there, in a folder that knows it."""
    with storage_errors(path):
        file = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.ftruncate(file, size)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    return file


def _checked_record(line: bytes, crc_before: int, n: int) -> tuple[dict[str, Any], int] | None:
    """The record of a line, which ends, and its checksum; None where it does not hold."""
    try:
        text = line.decode()
        body, mark, checksum = text.rpartition(_CRC)
        crc = zlib.crc32(body.encode(), crc_before)
        if not mark or checksum != f'{crc:08x}"}}\n':
            return None
        content = json.loads(f"{body}}}")
        return (content, crc) if content["n"] == n and isinstance(content["kind"], str) else None
    except (ValueError, RecursionError, KeyError, TypeError):
        return None
