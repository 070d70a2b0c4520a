"""What this user gave on this machine, a line each in the cache folder, which no file from elsewhere forges."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import read_bounded

_LOG = logging.getLogger(__name__)
NAME, _MOST_BYTES = "given.jsonl", 10_000_000


def known_marks() -> set[str]:
    """All that was noted."""
    try:
        file = cache_folder() / NAME
        if file.exists():
            return set(read_bounded(file, _MOST_BYTES, ConfigError).decode("utf-8", "replace").splitlines())
    except RuntimeError:  # who runs this has no home
        pass
    return set()


def note_marks(marks: Iterable[str]) -> None:
    """Note lines; where that cannot be written, they have to be given again some day."""
    new = sorted(set(marks) - known_marks())
    if not new:
        return
    try:
        file = cache_folder() / NAME
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a", encoding="utf-8", errors="backslashreplace") as notes:
            notes.write("".join(f"{mark}\n" for mark in new))
    except (OSError, RuntimeError) as error:  # RuntimeError: who runs this has no home
        _LOG.info("what was given is not noted (%s): it has to be given again", error)
