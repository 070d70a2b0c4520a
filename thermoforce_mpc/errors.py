"""Exceptions of the package: one base class, one branch per exit code of `tf-mpc`; and signals to end.

A message says what was wrong, where (file, key, endpoint), and what to do.
A failed solve is not an exception: it is reported by the status of the `Plan`.
"""

from __future__ import annotations

import difflib
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.machinery import ExtensionFileLoader
from types import FrameType


class ThermoForceError(Exception):
    """Base class of all exceptions of this package."""


class InputError(ThermoForceError):
    """User input is invalid (exit code 2)."""


class ConfigError(InputError):
    """A YAML file, an option or a `--set` value is invalid; names the file, the key and the allowed values."""


class OptionError(ConfigError, ValueError):
    """An option that a program gives to a class of options is invalid; told as those of files are."""


class HiddenPackage(InputError, ImportError):
    """A folder or file of the user's has the name of a package of ours and is found in its place."""


class WeatherError(InputError):
    """A weather file is missing, truncated, malformed, or does not cover the requested time."""


class DataError(InputError):
    """Data for identification or forecasting are unusable (too short, no excitation, wrong shape)."""


class ArtifactError(InputError):
    """A saved model is missing, damaged, of another version, or fails its self-check."""


class BackboneError(InputError):
    """A pretrained forecaster cannot be loaded from the given name or directory."""


class ControllerRaised(ThermoForceError):
    """A controller raised an exception of its own, or returned no plan (exit code 1)."""


class PlantError(ThermoForceError):
    """The plant or the service behind it failed (exit code 3)."""


class NoConnection(PlantError):
    """Nobody is at the address of a building's connection, or it takes no one in: waiting alone does not help."""


class NotAsTold(PlantError):
    """Devices answered what they were told with another value. `names`: theirs, by the connection's own."""

    def __init__(self, message: str, names: Iterable[str]) -> None:
        super().__init__(message)
        self.names = tuple(names)


class NoForecast(PlantError):
    """The plant gave no forecast, while it may still be controlled. `past`: read from the journal of a resumed run;
    `known`: the `Boundary` of what is known all the same, such as prices of a file of their own."""

    def __init__(self, message: str, *, past: bool = False, known: object = None) -> None:
        super().__init__(message)
        self.past, self.known = past, known


class StorageError(ThermoForceError):
    """A file could not be written: disk full, folder read-only or removed (exit code 6)."""


class NoSuchTest(ThermoForceError):
    """A run cannot be continued, since the service no longer has its test (exit code 5)."""


class EngineError(ThermoForceError):
    """The cluster that runs many tasks is gone or misfits, or no process can start (exit code 7)."""


class Terminated(BaseException):
    """A signal to end: ends as Ctrl-C does, with the plant released and the journal whole; exit code 128 + `number`."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


# The signals that asked this process to end.
_asked: list[int] = []

# What runs while a compiled module is being loaded.
_LOADING = (ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__)
_LOADED_S = 0.05


@contextmanager
def terminated_by(name: str) -> Iterator[None]:
    """Within it the first signal of this `name`, such as "SIGTERM", raises `Terminated` where the program is.

    A second one must not cut the plant's release short; "SIGINT" raises `KeyboardInterrupt`, each time. One that is
    ignored, as under nohup, or that this system has not changes nothing. Compiled modules are loaded to their end
    before: some crash, or are no more importable, where their loading is cut short.
    """
    number = getattr(signal, name, None)
    if number is None or (before := signal.getsignal(number)) is signal.SIG_IGN:
        yield
        return
    signal.signal(number, _terminate)
    try:
        yield
    finally:
        signal.signal(number, before)
        _asked[:] = [asked for asked in _asked if asked != number]


def _terminate(number: int, frame: FrameType | None) -> None:
    place = frame
    while place is not None:
        if place.f_code in _LOADING:
            again = threading.Timer(_LOADED_S, _raise_in_main_thread, (number,))
            again.daemon = True
            again.start()
            return
        place = place.f_back
    _asked.append(number)
    if number != signal.SIGINT:
        signal.signal(number, signal.SIG_IGN)
    raise_if_terminated()


def left_to_parent() -> None:
    """Ignore Ctrl-C and a closed terminal in this process: they reach its parent too, which then ends it."""
    for name in ("SIGINT", "SIGHUP"):
        if (number := getattr(signal, name, None)) is not None:
            signal.signal(number, signal.SIG_IGN)


def _raise_in_main_thread(number: int) -> None:
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:  # also out of a wait, which a signal to another thread does not end
        signal.pthread_kill(threading.main_thread().ident or 0, number)


def raise_if_terminated() -> None:
    """Raise what a signal raised that asked this process to end, whatever became of that.

    It may have come within a library that turns every exception into one of its own, or drops it, as Python does in a
    finalizer: who acts on a building for long asks for it once a step.
    """
    if _asked:
        raise KeyboardInterrupt if _asked[-1] == signal.SIGINT else Terminated(_asked[-1])


def interruption(error: BaseException) -> BaseException | None:
    """The Ctrl-C or signal to end in whose handling `error` was raised, as by a library that closes its files."""
    before: BaseException | None = error
    while before is not None:
        if isinstance(before, (KeyboardInterrupt, Terminated)):
            return before
        before = before.__cause__ or before.__context__
    return None


def out_of_memory(error: BaseException) -> bool:
    """Whether an error is, or came of, memory that could not be had; native libraries raise a `RuntimeError`."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return True
        if isinstance(cause, RuntimeError) and any(said in str(cause) for said in ("bad_alloc", "allocate memory")):
            return True
        cause = cause.__cause__
    return False


def check_kind(given: object, kind: type | tuple[type, ...], what: str, remedy: str = "") -> None:
    """Raise `DataError` where what a program gives as `what` is of no class of `kind`; `remedy`: what to do."""
    if not isinstance(given, kind):
        hint = f": {remedy}" if remedy else ""
        expected = " or ".join(one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,)))
        raise DataError(f"{what} is of class {type(given).__name__}, expected {expected}{hint}")


def check_path(given: object, what: str, remedy: str = "") -> None:
    """Raise `DataError` where what a program gives as `what` is no path; `remedy`: what to do."""
    check_kind(given, (str, os.PathLike), what, remedy)


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" if a known word is close, else an empty string."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def counted(n: int, one: str) -> str:
    """A number of things by the name of `one`: '1 run', '0 runs', '2 runs'."""
    return f"{n} {one}{'' if n == 1 else 's'}"
