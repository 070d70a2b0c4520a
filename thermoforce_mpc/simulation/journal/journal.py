"""Journal of a run: an append-only file of JSON lines, each with a checksum that goes on from the line before.

A line is `{"n":…,"kind":…,…,"crc":"…"}`; `crc` is the CRC-32 of the text before it, begun with the checksum of
the line before, so that a changed, missing or exchanged line is found. A record is written at once and handed to the
system: a killed process loses none. What a crash left half-written at the end is dropped when the journal is read.

A file that has grown to `PART_BYTES` is closed, and the journal goes on in the next part: `journal.jsonl`,
`journal.0002.jsonl`, … Counts and checksums go on through all parts.

A journal that is damaged in the middle holds until there: what comes after is a consequence of what cannot be read. It
can be cut there (`read_journal` with `most`, `set_aside`), and goes on from its last good record.
"""

from __future__ import annotations

import json
import os
import shlex
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from thermoforce_mpc.errors import DataError, StorageError, counted
from thermoforce_mpc.files import storage_errors, written
from thermoforce_mpc.simulation.journal.parts import PART_BYTES, JournalError, later_parts, opened, part_of, text_of

NAME = "journal.jsonl"
FORMAT = 3
_CRC = ',"crc":"'


class DamagedJournal(JournalError):
    """A record before the last does not hold, or a part is missing. `good`: what can be read before it."""

    def __init__(self, message: str, good: JournalText) -> None:
        super().__init__(message)
        self.good = good


@dataclass(frozen=True)
class Entry:
    """One record: its line in its file, from 1; its kind; what it says, or its bytes in the file; and the file."""

    line: int
    kind: str
    told: Mapping[str, Any] | range
    path: Path = Path(NAME)

    @property
    def content(self) -> Mapping[str, Any]:
        """What it says; read anew each time from a file, since a long journal does not fit in memory.

        Raises:
            JournalError: the file cannot be read any more, or was changed.
        """
        if isinstance(self.told, Mapping):
            return self.told
        try:
            content: dict[str, Any] = json.loads(text_of(self.path, self.told.start, len(self.told)))
            del content["kind"], content["crc"]
        except (JournalError, ValueError, KeyError) as error:
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
    """The records of a journal; `part` is the number of its last part, from 1.

    `size` of that part, bytes, and `crc` are those at the end of the last whole record.
    """

    entries: tuple[Entry, ...]
    part: int
    size: int
    crc: int
    torn: bool


class Journal:
    """Appends records to a journal, part by part."""

    def __init__(self, path: Path, after: JournalText | None = None, *, durable: bool = False) -> None:
        """Begin a journal at `path`, or go on `after` what was read from it; a torn end is cut off.

        Args:
            durable: wait for the disk after every record, so that a power failure loses none either.

        Raises:
            StorageError: the file cannot be opened.
        """
        self._first, self._durable = path, durable
        after = after or JournalText((), 1, 0, 0, False)
        self._n, self._part, self._size, self._crc = len(after.entries), after.part, after.size, after.crc
        self.path = part_of(path, self._part)
        """File of the present part."""
        self._file = opened(self.path, self._size)

    @property
    def records(self) -> int:
        """Number of records."""
        return self._n

    def write(self, kind: str, content: Mapping[str, Any]) -> None:
        """Append one record.

        Raises:
            StorageError: the disk is full, or the file was removed; the journal ends with the record before.
        """
        record = {"n": self._n, "kind": kind, **content}
        text = json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":"))[:-1]
        body = text.encode(errors="backslashreplace")  # half a surrogate, as in the name of a file: \\udcff is JSON too
        crc = zlib.crc32(body, self._crc)
        line = body + f'{_CRC}{crc:08x}"}}\n'.encode()
        if self._size >= PART_BYTES:
            self._turn_over()
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

    def _turn_over(self) -> None:
        """Go on in the next part, once this one is safe on the disk: a part that is not the last is never torn."""
        path = part_of(self._first, self._part + 1)
        with storage_errors(self.path):
            os.fsync(self._file)
        file = opened(path, 0)
        os.close(self._file)
        self._file, self.path, self._part, self._size = file, path, self._part + 1, 0

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_run(path: Path, most: int | None = None) -> JournalText:
    """Read the journal of a run, as `read_journal`, and check that this release can make sense of it.

    Raises:
        JournalError: as `read_journal`, or it holds no run, or one of another format.
    """
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
        raise JournalError(
            f"{path}: is of format {version!r:.20}, written by thermoforce-mpc {first.content.get('version')!s:.20}; "
            f"this release reads format {FORMAT}: use that release, or start the run again"
        )
    return journal


def read_journal(path: Path, most: int | None = None) -> JournalText:
    """Read and check all parts of the journal at `path`, or its first `most` records.

    A last record that is not whole is left out.

    Raises:
        JournalError: there is no journal.
        DamagedJournal: a part is missing, or a record before the last is damaged; names the place and what is lost.
    """
    entries: list[Entry] = []
    number, crc = 1, 0
    while True:
        part, last = part_of(path, number), not part_of(path, number + 1).exists()
        size, crc, rest = _read_part(part, entries, crc, most)
        journal = JournalText(tuple(entries), number, size, crc, bool(rest))
        if len(entries) == most:
            return journal
        if rest and not (last and b"\n" not in rest[:-1]):
            line = entries[-1].line + 1 if entries and entries[-1].path == part else 1
            raise _damaged(f"{part}, line {line}: the record is damaged, its checksum does not hold", path, journal)
        if last:
            if later_parts(path, number):
                raise _damaged(f"{part_of(path, number + 1)}: is not there, but later parts are", path, journal)
            return journal
        number += 1


def _damaged(what: str, path: Path, good: JournalText) -> DamagedJournal:
    """The error of a journal of which only `good` can be read, with what is lost."""
    lines = [line for part in rest_of(path, good) for line in part.splitlines()]
    steps = sum(b'"kind":"done"' in line for line in lines)
    lost = f"{counted(len(lines), 'line')} from there on cannot be relied on" + (f", with {steps} steps" * (steps > 0))
    return DamagedJournal(f"{what}; {lost}", good)


def rest_of(path: Path, good: JournalText) -> Iterator[bytes]:
    """What comes after the records of `good` in the journal at `path`, part by part."""
    yield text_of(part_of(path, good.part), good.size)
    for part in later_parts(path, good.part):
        yield text_of(part)


def set_aside(path: Path, good: JournalText) -> Path:
    """Move what comes after `good` to a file beside the journal, so that it can go on from there; returns that file.

    Raises:
        StorageError: it cannot be written.
    """
    aside = path.with_name(f"{path.name}.lost")
    with written(aside, follow=False) as there, there.open("wb") as file:
        file.writelines(rest_of(path, good))
    with storage_errors(path):
        for part in reversed(later_parts(path, good.part)):
            part.unlink()
        os.close(opened(part_of(path, good.part), good.size))
    return aside


class JournalTail:
    """Reads a journal that is being written: each time what is new and whole. It never writes.

    Raises `JournalError` as `read_journal`, also where the journal is another one than before.
    """

    def __init__(self, path: Path) -> None:
        self._first, self._part, self._at, self._line, self._n, self._crc = path, 1, 0, 0, 0, 0

    @property
    def path(self) -> Path:
        """The part that is read."""
        return part_of(self._first, self._part)

    def more(self) -> list[Entry]:
        """The records that were written since the last call."""
        entries: list[Entry] = []
        while True:
            path = self.path
            ended = part_of(self._first, self._part + 1).exists()  # asked before reading: it is then whole
            for line in self._lines(path):
                record = _checked_record(line, self._crc, self._n)
                self._line += 1
                if record is None:
                    raise JournalError(
                        f"{path}, line {self._line}: the record is damaged, its checksum does not hold, or another run "
                        "was begun in this folder"
                    )
                content, self._crc = record
                entries.append(Entry(self._line, str(content.pop("kind")), content, path))
                self._at, self._n = self._at + len(line) + 1, self._n + 1
            if not ended:
                return entries
            self._part, self._at, self._line = self._part + 1, 0, 0

    def _lines(self, path: Path) -> list[bytes]:
        """The new lines of a part that have an end."""
        return text_of(path, self._at).split(b"\n")[:-1]


def _read_part(path: Path, entries: list[Entry], crc: int, most: int | None) -> tuple[int, int, bytes]:
    """Append the records of a part to `entries` until there are `most`; size and checksum at the last, and the rest."""
    raw, size, line = text_of(path), 0, 0
    while len(entries) != most and (end := raw.find(b"\n", size)) >= 0:
        record = _checked_record(raw[size:end], crc, len(entries))
        if record is None:
            break
        content, crc = record
        entries.append(Entry(line + 1, str(content["kind"]), range(size, end), path))
        size, line = end + 1, line + 1
    return size, crc, raw[size:]


def _checked_record(line: bytes, crc_before: int, n: int) -> tuple[dict[str, Any], int] | None:
    """The record of a line and its checksum; None where it does not hold."""
    try:
        text = line.decode()
        body, mark, checksum = text.rpartition(_CRC)
        crc = zlib.crc32(body.encode(), crc_before)
        if not mark or checksum != f'{crc:08x}"}}':
            return None
        content = json.loads(f"{body}}}")
        return (content, crc) if content["n"] == n and isinstance(content["kind"], str) else None
    except (ValueError, RecursionError, KeyError, TypeError):
        return None
