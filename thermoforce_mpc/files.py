"""Files that are whole or absent: written aside and renamed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from thermoforce_mpc.errors import StorageError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write `content` (text as UTF-8) to a file beside `path` and rename it: `path` is as before, or complete.

    Raises:
        StorageError: the disk is full, the folder is read-only or gone.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with storage_errors(path):
        if path.exists() and not path.is_file():  # a device or a pipe, such as /dev/stdout
            path.write_bytes(data)
            return
        target = Path(os.path.realpath(path))
        handle, aside = tempfile.mkstemp(prefix=".", suffix=".tmp", dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(aside, 0o644)
            os.replace(aside, target)
        except BaseException:
            Path(aside).unlink(missing_ok=True)
            raise


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Convert `OSError` to a `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"{path}: cannot be written ({error.strerror or error}); make room or choose a folder that can be written"
        ) from error
