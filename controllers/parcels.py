"""What one process writes for another of the same machine: in a file that is mapped, which costs a tenth of a pipe."""

from __future__ import annotations

import io
import mmap
import os
import tempfile
from collections.abc import Callable
from typing import IO, NamedTuple


class Parcel(NamedTuple):
    """What was written: in the file `path`, or, where there was no room for it, `data`."""

    path: str
    data: bytes = b""


def sent(write: Callable[[IO[bytes]], None], folder: str) -> Parcel:
    """What `write` writes to a file it is given; `write` is called again where `folder` has no room."""
    try:
        handle, path = tempfile.mkstemp(dir=folder)
        try:
            with open(handle, "wb") as file:
                write(file)
        except BaseException:
            os.unlink(path)
            raise
        return Parcel(path)
    except OSError:
        memory = io.BytesIO()
        write(memory)
        return Parcel("", memory.getvalue())


def received(parcel: Parcel) -> memoryview:
    """The content; its file is gone then. Raises `FileNotFoundError` where it was already."""
    if not parcel.path:
        return memoryview(parcel.data)
    with open(parcel.path, "rb") as file:
        view = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    os.unlink(parcel.path)
    return view
