"""Journal of a run: an append-only file of JSON lines, each with a checksum that goes on from the line before.

A line is `{"n": …, "kind": …, …, "crc": "…"}`; `crc` is the CRC-32 of the text before it, begun with the checksum of
the line before, so that a changed, missing or exchanged line is found. A record is written at once and handed to the
system: a killed process loses none. What a crash left half-written at the end is dropped when the journal is read.

A file that has grown to `PART_BYTES` is closed, and the journal goes on in the next part: `journal.jsonl`,
`journal.0002.jsonl`, … Counts and checksums go on through all parts.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from thermoforce_mpc.errors import DataError, InputError, StorageError
from thermoforce_mpc.files import read_bounded, read_pieces, storage_errors

NAME = "journal.jsonl"
FORMAT = 2
PART_BYTES = 32_000_000
# A part ends with the record that makes it too long; that of the longest plant's past is some 10 MB.
_MOST_BYTES = 2 * PART_BYTES + 50_000_000
_CRC = ', "crc": "'


class JournalError(InputError):
    """A journal is missing, damaged, of another version, or not that of the run it is resumed with."""


class Entry(NamedTuple):
    """One record: its line in its file, from 1; its kind; what it says; and the file."""

    line: int
    kind: str
    content: Mapping[str, Any]
    path: Path = Path(NAME)

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


def part_of(path: Path, number: int) -> Path:
    """File of a part of the journal that begins at `path`; the first is 1."""
    return path if number == 1 else path.with_name(f"{path.stem}.{number:04d}{path.suffix}")


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
        self._file = _opened(self.path, self._size)

    @property
    def records(self) -> int:
        """Number of records."""
        return self._n

    def write(self, kind: str, content: Mapping[str, Any]) -> None:
        """Append one record.

        Raises:
            StorageError: the disk is full, or the file was removed; the journal ends with the record before.
        """
        text = json.dumps({"n": self._n, "kind": kind, **content}, ensure_ascii=False, allow_nan=False)[:-1]
        crc = zlib.crc32(text.encode(), self._crc)
        line = f'{text}{_CRC}{crc:08x}"}}\n'.encode()
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
        file = _opened(path, 0)
        os.close(self._file)
        self._file, self.path, self._part, self._size = file, path, self._part + 1, 0

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_run(path: Path) -> JournalText:
    """Read the journal of a run, as `read_journal`, and check that this release can make sense of it.

    Raises:
        JournalError: as `read_journal`, or it holds no run, or one of another format.
    """
    journal = read_journal(path)
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


def read_journal(path: Path) -> JournalText:
    """Read and check all parts of the journal at `path`; a last record that is not whole is left out.

    Raises:
        JournalError: there is no journal, a part is missing, or a record before the last is damaged; names the place.
    """
    entries: list[Entry] = []
    number, crc = 1, 0
    while True:
        part, last = part_of(path, number), not part_of(path, number + 1).exists()
        size, crc, torn = _read_part(part, entries, crc, may_be_torn=last)
        if last:
            _check_none_missing(path, number)
            return JournalText(tuple(entries), number, size, crc, torn)
        number += 1


def _check_none_missing(path: Path, last: int) -> None:
    """Raise `JournalError` where there are parts after one that is not there, behind the `last` that is."""
    numbers = (part.name.split(".")[-2] for part in path.parent.glob(f"{path.stem}.*{path.suffix}"))
    if any(number.isdecimal() and int(number) > last for number in numbers):
        raise JournalError(
            f"{part_of(path, last + 1)}: is not there, but later parts are, which cannot be relied on without it: put "
            "it back, or start the run again"
        )


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
        try:
            with path.open("rb") as file:
                file.seek(self._at)
                new = read_pieces(file, _MOST_BYTES)
        except OSError as error:
            raise JournalError(f"{path}: cannot be read ({error.strerror or error})") from error
        return new.split(b"\n")[:-1]


def _read_part(path: Path, entries: list[Entry], crc: int, *, may_be_torn: bool) -> tuple[int, int, bool]:
    """Append the records of one part to `entries`; size and checksum at the last whole one, and whether it is torn."""
    raw = read_bounded(path, _MOST_BYTES, JournalError)
    lines = raw.split(b"\n")
    size = 0
    last = len(lines) - (2 if lines[-1] == b"" else 1)
    for i, line in enumerate(lines[: last + 1]):
        record = _checked_record(line, crc, len(entries)) if i < len(lines) - 1 else None
        if record is None:
            if i < last or not may_be_torn:
                raise JournalError(
                    f"{path}, line {i + 1}: the record is damaged, its checksum does not hold; what comes after cannot "
                    "be relied on: start the run again"
                )
            return size, crc, True
        content, crc = record
        entries.append(Entry(i + 1, str(content.pop("kind")), content, path))
        size += len(line) + 1
    return size, crc, False


def _opened(path: Path, size: int) -> int:
    """Descriptor of a file to append to, cut to `size` bytes; made where it is not there, in a folder that knows it."""
    with storage_errors(path):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.ftruncate(file, size)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    return file


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
