"""Journal of a run: an append-only file of JSON lines, each with a checksum that goes on from the line before.

A line is `{"n":…,"kind":…,…,"crc":"…"}`; `crc` is the CRC-32 of the text before it, begun with the checksum of
the line before, so that a changed, missing or exchanged line is found. A record is written at once and handed to the
system: a killed process loses none. What a crash left half-written at the end is dropped when the journal is read.

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

from thermoforce_mpc.errors import DataError, InputError, StorageError, counted
from thermoforce_mpc.files import storage_errors, written
from thermoforce_mpc.records.plain_files import open_plain

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
        raise JournalError(
            f"{path}: is of format {version!r:.20}, written by thermoforce-mpc {first.content.get('version')!s:.20}; "
            f"this release reads format {FORMAT}: use that release, or start the run again"
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
