"""Files that are whole or absent: written aside and renamed. What cannot be is a `StorageError` (exit code 6)."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from thermoforce_mpc.errors import ArtifactError, StorageError


def check_replaceable(folder: Path, mark: str, what: str, *, overwrite: bool) -> None:
    """Check that `folder` may be written: it is not there, or `overwrite` and its file `mark` says it is a `what`.

    Raises:
        ArtifactError: it may not.
    """
    if not folder.exists():
        return
    if not overwrite:
        raise ArtifactError(f"{folder}: exists already; choose another folder or ask to overwrite it")
    if not (folder / mark).is_file():
        raise ArtifactError(f"{folder}: not overwritten, since it holds no {mark} and so is not a saved {what}")


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


def write_folder(folder: Path, files: Mapping[str, bytes], *, keep: bool = False) -> None:
    """Write a folder with `files` by name; whole or absent.

    Args:
        folder: where to.
        files: content by name.
        keep: leave a folder with files that is there, as where another process wrote it meanwhile; else it is replaced.

    Raises:
        StorageError: the disk is full, or nothing can be written there.
    """
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            made, former = aside / "new", aside / "former"
            made.mkdir()
            made.chmod(0o755)
            for name, content in files.items():
                with (made / name).open("wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            while not _moved(made, folder):
                if keep:
                    return
                # Another process may replace it too: who comes last stays.
                with suppress(FileNotFoundError):
                    os.rename(folder, former)
                shutil.rmtree(former, ignore_errors=True)
        finally:
            shutil.rmtree(aside, ignore_errors=True)


def _moved(made: Path, folder: Path) -> bool:
    """Move the folder `made` to `folder`; False where a folder with files is there."""
    try:
        os.rename(made, folder)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            return False
        raise
    return True


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Convert `OSError` to a `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"{path}: cannot be written ({error.strerror or error}); make room or choose a folder that can be written"
        ) from error
