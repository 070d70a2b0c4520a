"""Files that are whole or absent: written aside and renamed. What cannot be is a `StorageError` (exit code 6)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from thermoforce_mpc.errors import StorageError


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """A file beside `path`, of the same suffix, to write to; it takes the place of `path` when all went well.

    Otherwise `path` is as before. A device or pipe, such as /dev/stdout, is written directly.

    Raises:
        StorageError: the disk is full, the folder is read-only or not there.
    """
    with storage_errors(path):
        if path.exists() and not path.is_file():
            yield path
            return
        target = Path(os.path.realpath(path))
        handle, name = tempfile.mkstemp(prefix=".", suffix=f".part{target.suffix}", dir=target.parent)
        os.close(handle)
        aside = Path(name)
        try:
            yield aside
            with aside.open("rb") as file:
                os.fsync(file.fileno())
            os.chmod(aside, 0o644)
            os.replace(aside, target)
        finally:
            aside.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write `content` (text as UTF-8) by `written`; raises `StorageError`."""
    with written(path) as aside:
        aside.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Convert `OSError` to a `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"{path}: cannot be written ({error.strerror or error}); make room or choose a folder that can be written"
        ) from error
