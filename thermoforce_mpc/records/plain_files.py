"""Files of a folder that may come from elsewhere: plain files and folders only, opened without following links."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import write_whole


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

    Raises:
        OSError: it cannot be opened, or is something else; its text says what.
    """
    # A device may do something when it is opened; where there are no such flags, this is all that can be said.
    if os.path.lexists(path) and not stat.S_ISREG(mode := path.lstat().st_mode):
        raise OSError(0, f"is {_kind(mode)}, not a plain file", str(path))
    for flag in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, flag, 0)
    file = os.open(path, flags, 0o644)
    if stat.S_ISREG(mode := os.fstat(file).st_mode):
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
