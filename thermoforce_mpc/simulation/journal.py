"""Journal of a run: an append-only file of JSON lines, each with a checksum that goes on from the line before.

A line is `{"n": …, "kind": …, …, "crc": "…"}`; `crc` is the CRC-32 of the text before it, begun with the checksum of
the line before, so that a changed, missing or exchanged line is found. A record is written at once and handed to the
system: a killed process loses none. What a crash left half-written at the end is dropped when the journal is read.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from thermoforce_mpc.errors import InputError, StorageError
from thermoforce_mpc.files import storage_errors

NAME = "journal.jsonl"
FORMAT = 1
_CRC = ', "crc": "'


class JournalError(InputError):
    """A journal is missing, damaged, of another version, or not that of the run it is resumed with."""


class Entry(NamedTuple):
    """One record: its line in the file, from 1; its kind; and what it says."""

    line: int
    kind: str
    content: Mapping[str, Any]


class JournalText(NamedTuple):
    """The records of a journal file; `size` in bytes and `crc` are those at the end of the last whole record."""

    entries: tuple[Entry, ...]
    size: int
    crc: int
    torn: bool


class Journal:
    """Appends records to a journal file."""

    def __init__(self, path: Path, after: JournalText | None = None, *, durable: bool = False) -> None:
        """Begin a journal, or go on `after` what was read from it; a torn end is cut off.

        Args:
            durable: wait for the disk after every record, so that a power failure loses none either.

        Raises:
            StorageError: the file cannot be opened.
        """
        self.path, self._durable = path, durable
        self._n, self._size, self._crc = (len(after.entries), after.size, after.crc) if after else (0, 0, 0)
        with storage_errors(path):
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            os.ftruncate(self._file, self._size)

    def write(self, kind: str, content: Mapping[str, Any]) -> None:
        """Append one record.

        Raises:
            StorageError: the disk is full, or the file was removed; the journal ends with the record before.
        """
        text = json.dumps({"n": self._n, "kind": kind, **content}, ensure_ascii=False, allow_nan=False)[:-1]
        crc = zlib.crc32(text.encode(), self._crc)
        line = f'{text}{_CRC}{crc:08x}"}}\n'.encode()
        with storage_errors(self.path):
            if os.fstat(self._file).st_nlink == 0:
                raise StorageError(f"{self.path}: was removed during the run; what follows cannot be recorded")
            try:
                left = memoryview(line)
                while left:
                    left = left[os.write(self._file, left) :]
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


def read_journal(path: Path) -> JournalText:
    """Read and check a journal; a last record that is not whole is left out.

    Raises:
        JournalError: there is no journal, or a record before the last is damaged; names the line.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise JournalError(f"{path}: cannot be read ({error.strerror or error})") from error
    lines = raw.split(b"\n")
    entries: list[Entry] = []
    size, crc = 0, 0
    last = len(lines) - (2 if lines[-1] == b"" else 1)
    for i, line in enumerate(lines[: last + 1]):
        found = _checked(line, crc, i) if i < len(lines) - 1 else None
        if found is None:
            if i < last:
                raise JournalError(
                    f"{path}, line {i + 1}: the record is damaged, its checksum does not hold; what comes after cannot "
                    "be relied on: start the run again"
                )
            return JournalText(tuple(entries), size, crc, True)
        content, crc = found
        entries.append(Entry(i + 1, str(content.pop("kind")), content))
        size += len(line) + 1
    return JournalText(tuple(entries), size, crc, False)


def _checked(line: bytes, before: int, n: int) -> tuple[dict[str, Any], int] | None:
    """The record of a line and its checksum; None where it does not hold."""
    try:
        text = line.decode()
        body, mark, told = text.rpartition(_CRC)
        crc = zlib.crc32(body.encode(), before)
        if not mark or told != f'{crc:08x}"}}':
            return None
        content = json.loads(f"{body}}}")
        return (content, crc) if content["n"] == n and "kind" in content else None
    except (ValueError, RecursionError, KeyError, TypeError):
        return None
