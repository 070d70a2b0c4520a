"""The steps of a run: the latest in memory, the others in a file that ends with the process."""

from __future__ import annotations

import pickle
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar, overload

from thermoforce_mpc.files import storage_errors

# Steps in memory: a scored window of two weeks in steps of a quarter of an hour, some 50 kB each.
_IN_MEMORY = 1344

_Step = TypeVar("_Step")


class KeptSteps(Sequence[_Step]):
    """Steps that are appended and read in order.

    The file has no name and is written and read by this object alone.
    """

    def __init__(self, folder: Path | None = None, in_memory: int = _IN_MEMORY, steps: Iterable[_Step] = ()) -> None:
        """Keep `steps`; `folder` is where the file is made if there are more than `in_memory`, by default the
        system's for temporary files.
        """
        self._folder, self._most = folder, in_memory
        self._recent: list[_Step] = [*steps]
        self._places: list[int] = []
        self._file: Any = None

    def append(self, step: _Step) -> None:
        """Append one; raises `StorageError` where the file cannot be written."""
        self._recent.append(step)
        if len(self._recent) > self._most:
            self._write_step(self._recent[0])
            del self._recent[0]

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._places) + len(self._recent)

    @overload
    def __getitem__(self, index: int) -> _Step: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[_Step, ...]: ...

    def __getitem__(self, index: int | slice) -> _Step | tuple[_Step, ...]:
        """One step, or those of a slice."""
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        at = range(len(self))[index]
        away = len(self._places)
        return self._recent[at - away] if at >= away else self._read_step(self._places[at])

    def __iter__(self) -> Iterator[_Step]:
        """All steps in order; those in the file are read one by one."""
        for place in self._places:
            yield self._read_step(place)
        yield from islice(self._recent, len(self._recent))

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process all of them go in memory."""
        return KeptSteps, (None, len(self), tuple(self))

    def _write_step(self, step: _Step) -> None:
        with storage_errors((self._folder or Path(tempfile.gettempdir())) / "steps of this run"):
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 (closed with this object)
                weakref.finalize(self, _closed, self._file)
            place = self._file.seek(0, 2)
            self._file.write(pickle.dumps(step, protocol=pickle.HIGHEST_PROTOCOL))
            self._file.flush()
        self._places.append(place)

    def _read_step(self, place: int) -> _Step:
        self._file.seek(place)
        step: _Step = pickle.load(self._file)
        return step


def _closed(file: Any) -> None:
    with suppress(OSError):  # what a full disk did not take is lost with the run
        file.close()
