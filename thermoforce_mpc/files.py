"""Files within bounds: what is written is whole or absent, what is read ends in a named error.

What people give us may be a device, a pipe or a file of any size. A folder that may come from elsewhere holds plain
files and folders only, opened without following links. What this user gave on this machine is noted in the cache
folder, which no file from elsewhere forges.
"""

from __future__ import annotations

import errno
import hashlib
import io
import ipaddress
import json
import logging
import math
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NoReturn

from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.errors import ConfigError, InputError, StorageError


def configs_folder() -> Path:
    """Return the `configs` folder: beside the package in a source tree, inside it when installed from a wheel."""
    package = Path(__file__).resolve().parent
    for folder in (package.parent / "configs", package / "configs"):
        if (folder / "testcases").is_dir():
            return folder
    raise ConfigError(f"configs folder not found beside or inside {package}: reinstall thermoforce-mpc")


def named_configs(kind: str) -> dict[str, Path]:
    """Return the shipped YAML files of one kind (`testcases`, `scenarios`, …), by name."""
    return {path.stem: path for path in sorted((configs_folder() / kind).glob("*.yaml"))}


@contextmanager
def written(path: Path, *, follow: bool = True) -> Iterator[Path]:
    """A file beside `path`, of the same suffix, to write to; it takes the place of `path` when all went well.

    Otherwise `path` is as before. With `follow` a device or pipe, such as /dev/stdout, is written directly, and what a
    link leads to is replaced; else the file takes its place. Raises `StorageError`.
    """
    with storage_errors(path):
        if follow and path.exists() and not path.is_file():
            yield path
            return
        target = Path(os.path.realpath(path)) if follow else path
        sweep(target.parent)
        handle, name = tempfile.mkstemp(prefix=_own_prefix(), suffix=f".part{target.suffix}", dir=target.parent)
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


def write_whole(path: Path, content: str | bytes, *, follow: bool = True) -> None:
    """Write `content` (text as UTF-8, with `\\udcff` for half a surrogate) by `written`; raises `StorageError`."""
    with written(path, follow=follow) as aside:
        aside.write_bytes(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, content: Any, *, follow: bool = False) -> None:
    """Write standard JSON: NaN and infinities become null; `follow` as of `written`."""
    text = json.dumps(plain_json(content), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(path, text + "\n", follow=follow)


def write_folder(folder: Path, files: Mapping[str, bytes], *, keep: bool = False) -> None:
    """Write a folder with the content of `files` by name; whole or absent. Raises `StorageError`.

    One with files that is there is replaced, or left with `keep`, as where another process wrote it meanwhile.
    """
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        sweep(folder.parent)
        aside = Path(tempfile.mkdtemp(prefix=_own_prefix(), suffix=".part", dir=folder.parent))
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


_MOST_SECRET = 8192
_PART = re.compile(r"\.([0-9]+)-[a-z0-9_]{8}\.part(\..*)?")
# A process of another machine, whose number says nothing here, is done with a file by then, s.
_LEFT_OVER_S = 600.0
_swept: set[Path] = set()


def _own_prefix() -> str:
    return f".{os.getpid()}-"


def sweep(folder: Path, *, sole: bool = False) -> None:
    """Remove what processes that were killed left half-written in a folder, once a process; at once where it is `sole`.

    Else only what is ten minutes old and of a process that is not there: others may be writing.
    """
    if folder in _swept and not sole:
        return
    _swept.add(folder)
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            match = _PART.fullmatch(entry.name)
            if match is None or int(match[1]) == os.getpid():
                continue
            with suppress(OSError):
                old = time.time() - entry.stat(follow_symlinks=False).st_mtime > _LEFT_OVER_S
                if not sole and not (old and _is_gone(int(match[1]))):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    os.unlink(entry.path)


def _is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # somebody else's, or no number of a process
        return False
    return False


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
    except (FileExistsError, NotADirectoryError) as error:
        file = next((one for one in (path, *path.parents) if one.exists() and not one.is_dir()), path)
        raise StorageError(f"{path}: cannot be written: {file} is a file, no folder; choose another name") from error
    except FileNotFoundError as error:
        folder = next((one for one in reversed(path.absolute().parents) if not one.exists()), path)
        raise StorageError(f"{path}: cannot be written: there is no {folder}; make it, or name another") from error
    except IsADirectoryError as error:
        raise StorageError(f"{path}: cannot be written: it is a folder; name a file") from error
    except OSError as error:
        raise StorageError(
            f"{path}: cannot be written ({error.strerror or error}); make room or choose a folder that can be written"
        ) from error


def check_writable(path: Path) -> None:
    """Raise `StorageError` where a file or folder `path` cannot be written, before its content is computed."""
    there = next(one for one in (path, *path.absolute().parents) if one.exists())
    if there != path and not there.is_dir():
        raise StorageError(f"{path}: cannot be written: {there} is a file")
    if not os.access(there, os.W_OK):
        raise StorageError(f"{path}: cannot be written: no right to write to {there}; choose another folder")


_PIECE = 1 << 20


class DoubtfulInput(UserWarning):
    """Input that is possible, but more often a mistake; the message names the file and the reason."""


def check_regular(path: Path, error: type[InputError]) -> None:
    """Raise `error` unless `path` is a file or a link to one: a device may have no end, and a pipe waits for one."""
    try:
        regular = stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError) as problem:  # ValueError: a NUL in the name
        raise error(f"{path}: cannot be read ({getattr(problem, 'strerror', None) or problem})") from problem
    if not regular:
        raise error(f"{path}: not a file")


def read_bounded(path: Path, most_bytes: int, error: type[InputError]) -> bytes:
    """Return the content of a regular file of at most `most_bytes`; raises `error` naming the file and the reason."""
    check_regular(path, error)
    try:
        with path.open("rb") as file:
            content = read_pieces(file, most_bytes)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror or problem})") from problem
    if len(content) > most_bytes:
        raise error(f"{path}: more than {most_bytes:,} bytes, the most that is read here; is it the right file?")
    return content


def read_pieces(file: IO[bytes] | io.BufferedIOBase, most_bytes: int) -> bytes:
    """Return what `file` holds, or a little more than `most_bytes` of it.

    In pieces: one `read(n)` takes n bytes of memory, and of a packed member as much as it unpacks to.
    """
    found = io.BytesIO()
    while found.tell() <= most_bytes and (piece := file.read(_PIECE)):
        found.write(piece)
    return found.getvalue()


def plain_json(value: Any) -> Any:
    """`value` in JSON types, arrays as lists; numbers that are not finite become null, since JSON has no NaN."""
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # NumPy's arrays and scalars
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def parse_json(content: bytes, where: str, error: type[InputError]) -> dict[str, Any]:
    """Return the object of a JSON document of finite numbers; raises `error` naming `where` and the reason."""
    try:
        document = json.loads(content, parse_constant=_not_finite, parse_float=_finite)
    except (ValueError, RecursionError) as problem:  # ValueError: also of the encoding, and integers of 5,000 digits
        raise error(f"{where}: not valid JSON ({problem!s:.200})") from problem
    if not isinstance(document, dict):
        raise error(f"{where}: holds a {type(document).__name__}, expected an object")
    return document


def read_json(path: Path, most_bytes: int, error: type[InputError] = InputError) -> dict[str, Any]:
    """The object of a JSON file; raises `error` as `read_bounded` and `parse_json`."""
    return parse_json(read_bounded(path, most_bytes, error), str(path), error)


def _not_finite(text: str) -> NoReturn:
    raise ValueError(f"{text:.40} is not a finite number")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _not_finite(text)


_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def plain_number(text: str) -> float:
    """Return the finite number that `text` is; raises `ValueError` for anything else, also what Python would take.

    To Python '1_0' is ten, and so is '١٠'; 'infinity' and 'nan' are numbers.
    """
    if not _NUMBER.fullmatch(text.strip(" \t")):
        raise ValueError(f"{text!r:.60} is not a number")
    return _finite(text)


def odd_number(text: str) -> bool:
    """Whether Python takes `text` for a number that nobody writes so: 1_0, or digits of another script."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" in text or not text.strip().isascii()


def pyarrow_for(what: object, error: type[InputError]) -> Any:
    """The package pyarrow, which reads and writes Parquet; raises `error` for `what` where it is not installed."""
    try:
        import pyarrow.parquet
    except ModuleNotFoundError as missing:
        raise error(f"{what}: Parquet needs {missing.name}: pip install 'thermoforce-mpc[parquet]'") from missing
    return pyarrow


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal; raises `OSError` where it cannot be read, as a device or pipe."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a file", str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def no_secret_in(address: str, key: str, instead: str) -> None:
    """Raise `ConfigError` where an address names a user or password (`user:password@host`); its message does not.

    `instead`: where the secret belongs.
    """
    if "@" in address:  # a password may hold a / too, after which no host could be told from a path
        raise ConfigError(f"{key}: a user or password in it would stand in logs: leave out what is before @; {instead}")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`, a name or an IP address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def secret_from(file: Path | None, variables: Sequence[str], key: str) -> str:
    """A password or token: what stands in `file`, which nobody else may read, else in the first of `variables` set.

    Raises `ConfigError`, naming the `key` that gives the file; no message holds the secret.
    """
    if file is None:
        for name in variables:
            if found := os.environ.get(name, "").strip():
                return found
        raise ConfigError(
            f"{key}: no secret is given: set the environment variable {variables[0]}, or this key to a file of mode 600"
        )
    try:
        mode = stat.S_IMODE(file.stat().st_mode)
        if mode & 0o077:
            raise ConfigError(f"{key}: {file} may be read by others (mode {mode:o}): chmod 600 {file}")
        text = read_bounded(file, _MOST_SECRET, ConfigError).decode("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{key}: {file} cannot be read ({type(error).__name__})") from error
    if not text or any(mark.isspace() for mark in text):
        raise ConfigError(f"{key}: {file} holds no secret: one line, without spaces")
    return text


HARD_LINK = "has another name elsewhere (a hard link), where it would be changed too; copy the folder (cp -r)"


def check_plain(folder: Path) -> None:
    """Refuse a folder of a run in which anything is a link, pipe, socket or device, at any depth; raises `ConfigError`.

    A link there could have another file read, or written over; a pipe could be waited for without end. The folder
    itself may be a link: its name is the user's. What is exchanged later is not seen here, but files are opened by
    `open_plain` and written by `write_plain`.
    """
    for where, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(where, name)
            try:
                mode = path.lstat().st_mode
            except FileNotFoundError:  # renamed meanwhile, by a run under way
                continue
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise ConfigError(
                    f"{path}: is {_kind(mode)}, and the folder of a run holds plain files only: look where it came "
                    "from, and remove it or put the file in its place"
                )


def open_plain(path: Path, flags: int) -> int:
    """Descriptor of a regular file (`flags` as of `os.open`), without following a link there or waiting for anything.

    One to be written has one name only: with another, a file elsewhere would be written too.

    Raises:
        OSError: it cannot be opened, or is something else; its text says what.
    """
    # A device may do something when it is opened; where there are no such flags, this is all that can be said.
    if os.path.lexists(path) and not stat.S_ISREG(mode := path.lstat().st_mode):
        raise OSError(0, f"is {_kind(mode)}, not a plain file", str(path))
    for flag in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, flag, 0)
    file = os.open(path, flags, 0o644)
    found = os.fstat(file)
    if stat.S_ISREG(mode := found.st_mode):
        if found.st_nlink > 1 and flags & (os.O_WRONLY | os.O_RDWR):
            os.close(file)
            raise OSError(0, HARD_LINK, str(path))
        return file
    os.close(file)
    raise OSError(0, f"is {_kind(mode)}, not a plain file", str(path))


def write_plain(path: Path, content: str | bytes) -> None:
    """Write a file as `write_whole`, but without following a link there: the file takes its place."""
    write_whole(path, content, follow=False)


def _kind(mode: int) -> str:
    kinds = {
        stat.S_IFLNK: "a link",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
        stat.S_IFDIR: "a folder",
        stat.S_IFBLK: "a device",
        stat.S_IFCHR: "a device",
    }
    return kinds.get(stat.S_IFMT(mode), "no file")


_LOG = logging.getLogger(__name__)
GIVEN, _MOST_GIVEN_BYTES = "given.jsonl", 10_000_000


def known_marks() -> set[str]:
    """All that was noted."""
    try:
        file = cache_folder() / GIVEN
        if file.exists():
            return set(read_bounded(file, _MOST_GIVEN_BYTES, ConfigError).decode("utf-8", "replace").splitlines())
    except RuntimeError:  # who runs this has no home
        pass
    return set()


def note_marks(marks: Iterable[str]) -> None:
    """Note lines; where that cannot be written, they have to be given again some day."""
    new = sorted(set(marks) - known_marks())
    if not new:
        return
    try:
        file = cache_folder() / GIVEN
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a", encoding="utf-8", errors="backslashreplace") as notes:
            notes.write("".join(f"{mark}\n" for mark in new))
    except (OSError, RuntimeError) as error:  # RuntimeError: who runs this has no home
        _LOG.info("what was given is not noted (%s): it has to be given again", error)
