"""Files of a journal: its parts, and how they are kept once the run has ended.

A part is text of JSON lines. The parts of a run that has ended are deflated by gzip where they are long.
"""

from __future__ import annotations

import gzip
import os
import re
import zlib
from functools import lru_cache
from pathlib import Path

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import read_pieces, storage_errors
from thermoforce_mpc.simulation.folder.plain_files import open_plain, write_plain

PART_BYTES = 32_000_000
# A part ends with the record that makes it too long; that of the longest plant's past is some 10 MB.
_MOST_BYTES = 2 * PART_BYTES + 50_000_000
# Shorter parts stay as they are, for people to read.
PACKED_BYTES = 1_000_000
_PACKED = ".gz"


class JournalError(InputError):
    """A journal is missing, damaged, of another version, or not that of the run it is resumed with."""


def part_of(path: Path, number: int) -> Path:
    """File of a part of the journal that begins at `path`; the first is 1. It is there, packed or not, or has the
    name that it would have.
    """
    part = path if number == 1 else path.with_name(f"{path.stem}.{number:04d}{path.suffix}")
    packed = part.with_name(part.name + _PACKED)
    return packed if packed.exists() and not part.exists() else part


def later_parts(path: Path, number: int) -> list[Path]:
    """The parts after number `number`, in order; there may be gaps."""
    found = re.compile(rf"{re.escape(path.stem)}\.(\d{{4,}}){re.escape(path.suffix)}(?:{re.escape(_PACKED)})?")
    numbers = {int(match[1]) for part in path.parent.iterdir() if (match := found.fullmatch(part.name))}
    return [part_of(path, n) for n in sorted(numbers) if n > number]


def pack(path: Path) -> None:
    """Deflate the long parts of a journal that has ended.

    Raises:
        JournalError: it cannot be read.
        StorageError: it cannot be written.
    """
    for part in (part_of(path, 1), *later_parts(path, 1)):
        if part.suffix != _PACKED and len(content := text_of(part)) > PACKED_BYTES:
            write_plain(part.with_name(part.name + _PACKED), gzip.compress(content))
            _remove(part)


def unpack(path: Path) -> None:
    """Undo `pack`, so that the journal can go on; raises as `pack`."""
    for part in (part_of(path, 1), *later_parts(path, 1)):
        if part.suffix == _PACKED:
            write_plain(part.with_suffix(""), text_of(part))
            _remove(part)


def _remove(part: Path) -> None:
    with storage_errors(part):
        part.unlink()


def text_of(path: Path, at: int = 0, size: int | None = None) -> bytes:
    """What a part holds from byte `at` of its text on: `size` bytes, or all.

    Raises:
        JournalError: it cannot be read, or is longer than any part.
    """
    try:
        with os.fdopen(open_plain(path, os.O_RDONLY), "rb") as file:
            if path.suffix == _PACKED:
                content = _inflated(path, os.fstat(file.fileno()).st_mtime_ns)[at:][:size]
            else:
                file.seek(at)
                content = read_pieces(file, _MOST_BYTES) if size is None else file.read(size)
    except (OSError, ValueError, EOFError, zlib.error) as error:  # ValueError: a NUL in the name
        raise JournalError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if len(content) > _MOST_BYTES:
        raise JournalError(f"{path}: more than {_MOST_BYTES:,} bytes, longer than any part of a journal")
    return content


@lru_cache(maxsize=1)  # whoever reads record by record would inflate it for each
def _inflated(path: Path, changed_ns: int) -> bytes:
    """The text of a packed part, as it was `changed_ns`."""
    with os.fdopen(open_plain(path, os.O_RDONLY), "rb") as file, gzip.GzipFile(fileobj=file) as text:
        return read_pieces(text, _MOST_BYTES)


def opened(path: Path, size: int) -> int:
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
