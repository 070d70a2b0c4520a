"""One controller at a time: a lock on what a connection sets, whoever sets it, from wherever."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.errors import ConfigError, StorageError
from thermoforce_mpc.files import read_bounded

if TYPE_CHECKING:  # it loads numpy, and the watchdog none
    from thermoforce_mpc.protocols import Connection

_MOST_BYTES = 10_000
Sets = Path | str | tuple[str, ...]
"""What is set: a file, or the text of each thing that two controllers must not share."""


class SetByAnother(ConfigError):
    """Another process sets what is asked for."""


def set_by(connection: Connection, name: str = "", options: Mapping[str, Any] | None = None) -> Sets:
    """What a connection sets, see `Connection`; where it does not say, its `name` and `options`, '' without a name."""
    says = getattr(connection, "sets", None)
    if says is None:
        return f"connection '{name}' {dict(options or {})}" if name else ""
    what = says()
    if isinstance(what, tuple) and all(isinstance(one, str) and one for one in what):
        return what
    if not isinstance(what, Path | str) or not str(what):
        raise ConfigError(
            f"connection {name or type(connection).__name__}: sets() is {what!r}, expected a path, text or texts"
        )
    return what


def _place(what: Path | str) -> Path:
    if isinstance(what, Path):
        what = what.resolve()
        return what.with_name(f".{what.name}.lock")
    return cache_folder() / "control" / f"{hashlib.sha256(what.encode()).hexdigest()[:32]}.lock"


def last_to_set(what: Path | str) -> str:
    """Who sets `what`, or failed or died while it did, as `process 123 since …`; '' where the last one ended well.

    Raises `ConfigError` where that cannot be read.
    """
    place = _place(what)
    return read_bounded(place, _MOST_BYTES, ConfigError).decode("utf-8", "replace").strip() if place.exists() else ""


@contextmanager
def sole_control(what: Sets, process: int | None = None) -> Iterator[None]:
    """Keep other controllers from setting `what`, of `set_by`, while the block lasts; a process that dies releases it.

    Of several texts each is locked: two controllers may share one of their topics. A file is locked beside it, for
    every user of the machine; all else in the user's cache folder, for this user. `process`: for whom it is set, by
    default this one; `last_to_set` says it yet where the block ends by an exception.

    Raises:
        SetByAnother: another process sets it; names that one.
        StorageError: it cannot be locked.
    """
    each = sorted(set(what)) if isinstance(what, tuple) else [what]
    with ExitStack() as held:
        places = [held.enter_context(_locked(one)) for one in each]
        since = datetime.now(UTC).isoformat(timespec="seconds")
        who = f"process {os.getpid() if process is None else process} since {since}, in {Path.cwd()}\n"
        for place in places:
            place.write_text(who, encoding="utf-8", errors="replace")
        yield
        # The files stay: one that waits for one while it is removed would lock what nobody sees.
        for place in places:
            place.write_text("", encoding="utf-8")


@contextmanager
def _locked(what: Path | str) -> Iterator[Path]:
    """The file that is locked for `what` while the block lasts."""
    what = what.resolve() if isinstance(what, Path) else what
    place = _place(what)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        # Before: some releases of filelock empty the file where they cannot lock it.
        other = last_to_set(what)
        lock = FileLock(place, timeout=0)
        lock.acquire()
    except Timeout as error:
        raise SetByAnother(
            f"{what} is set by another controller ({other or 'a process that does not say which'}), and two would undo "
            "one another: end that one first"
        ) from error
    except OSError as error:
        raise StorageError(f"{what}: {place} cannot be locked ({error.strerror or error})") from error
    try:
        yield place
    finally:
        lock.release()
