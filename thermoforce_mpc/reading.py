"""Bounded reading of files that people give us: a device, a pipe or a file of any size ends in a named error."""

from __future__ import annotations

import stat
from pathlib import Path

from thermoforce_mpc.errors import InputError


class DoubtfulInput(UserWarning):
    """Input that is possible, but more often a mistake; the message names the file and the reason."""


def read_bounded(path: Path, most_bytes: int, error: type[InputError]) -> bytes:
    """Return the content of a regular file of at most `most_bytes`; raises `error` naming the file and the reason."""
    try:
        # Checked before opening: opening a pipe without a writer waits for one.
        if not stat.S_ISREG(path.stat().st_mode):
            raise error(f"{path}: not a file")
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except (OSError, ValueError) as problem:  # ValueError: a NUL in the name
        raise error(f"{path}: cannot be read ({getattr(problem, 'strerror', None) or problem})") from problem
    if len(content) > most_bytes:
        raise error(f"{path}: more than {most_bytes:,} bytes, the most that is read here; is it the right file?")
    return content
