"""Bounded reading of files that people give us: a device, a pipe or a file of any size ends in a named error."""

from __future__ import annotations

import io
import json
import math
import stat
from pathlib import Path
from typing import IO, Any, NoReturn

from thermoforce_mpc.errors import InputError

_PIECE = 1 << 20


class DoubtfulInput(UserWarning):
    """Input that is possible, but more often a mistake; the message names the file and the reason."""


def read_bounded(path: Path, most_bytes: int, error: type[InputError]) -> bytes:
    """Return the content of a regular file of at most `most_bytes`; raises `error` naming the file and the reason."""
    try:
        # Checked before opening: opening a pipe without a writer waits for one.
        if not stat.S_ISREG(path.stat().st_mode):
            raise error(f"{path}: not a file")
        with path.open("rb") as file:
            content = read_pieces(file, most_bytes)
    except (OSError, ValueError) as problem:  # ValueError: a NUL in the name
        raise error(f"{path}: cannot be read ({getattr(problem, 'strerror', None) or problem})") from problem
    if len(content) > most_bytes:
        raise error(f"{path}: more than {most_bytes:,} bytes, the most that is read here; is it the right file?")
    return content


def read_pieces(file: IO[bytes] | io.BufferedIOBase, most_bytes: int) -> bytes:
    """Return what `file` holds, or a little more than `most_bytes` of it.

    In pieces: one `read(n)` of a file takes n bytes of memory, and one of a packed member as much as it unpacks to,
    whatever size it states.
    """
    found = io.BytesIO()
    while found.tell() <= most_bytes and (piece := file.read(_PIECE)):
        found.write(piece)
    return found.getvalue()


def parse_json(content: bytes, where: str, error: type[InputError]) -> dict[str, Any]:
    """Return the object of a JSON document of finite numbers; raises `error` naming `where` and the reason."""
    try:
        document = json.loads(content, parse_constant=_not_finite, parse_float=_finite)
    except (ValueError, RecursionError) as problem:  # ValueError: also of the encoding, and integers of 5,000 digits
        raise error(f"{where}: not valid JSON ({problem!s:.200})") from problem
    if not isinstance(document, dict):
        raise error(f"{where}: holds a {type(document).__name__}, expected an object")
    return document


def _not_finite(text: str) -> NoReturn:
    raise ValueError(f"{text:.40} is not a finite number")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _not_finite(text)
