"""What an engine is, and what its workers do."""

from __future__ import annotations

import pickle
import time
import traceback
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol

from thermoforce_mpc.errors import ThermoForceError

_SHARE_EVERY_S = 0.5


@dataclass(frozen=True)
class WorkerAnswer:
    """What a worker sends back: the pickled `value`, or the `reason` of a failure (see `Outcome`)."""

    value: bytes = b""
    reason: str = ""
    seconds: float = 0.0
    error: type[ThermoForceError] | None = None
    details: str = ""


@dataclass(frozen=True)
class Begun:
    """A worker has begun the task of `key`."""

    key: str


@dataclass(frozen=True)
class Told:
    """A task has told that a `share` of it, 0 to 1, is done."""

    key: str
    share: float


@dataclass(frozen=True)
class Ended:
    """A worker has answered."""

    key: str
    answer: WorkerAnswer


@dataclass(frozen=True)
class Lost:
    """The worker of a task died, at each of `attempts` attempts."""

    key: str
    why: str
    attempts: int = 1


Event = Begun | Told | Ended | Lost


class Engine(Protocol):
    """Runs `answer_to(payload)` on workers. Thread safety is not asked for."""

    @property
    def width(self) -> int:
        """How many tasks it computes at once, as of now."""

    @property
    def room(self) -> int:
        """How many more tasks to submit now; positive where nothing is under way."""

    def submit(self, key: str, title: str, payload: bytes) -> None:
        """Run `payload`; events name it by `key`."""

    def wait(self) -> Event:
        """The next event; blocks."""

    def cancel(self) -> None:
        """End what is under way; no event of it comes any more."""


def payload_of(function: Callable[..., Any], inputs: Any, results: tuple[Any, ...]) -> bytes:
    """Pickle a call; raises what `pickle` does."""
    return pickle.dumps((function, inputs, results), protocol=pickle.HIGHEST_PROTOCOL)


def answer_to(payload: bytes, report: Callable[[float], None]) -> WorkerAnswer:
    """Make the call of `payload_of` in this process; every error becomes an answer."""
    began = time.perf_counter()
    told_s = time.monotonic()

    def tell_now(share: float) -> None:
        nonlocal told_s
        if time.monotonic() - told_s >= _SHARE_EVERY_S:
            told_s = time.monotonic()
            report(float(share))

    token = _teller.set(tell_now)
    try:
        function, inputs, results = pickle.loads(payload)
        value = pickle.dumps(function(inputs, *results), protocol=pickle.HIGHEST_PROTOCOL)
        return WorkerAnswer(value, seconds=time.perf_counter() - began)
    except ThermoForceError as error:
        # The nearest class that the caller has too: a plugin's own may be known here only.
        kind = next(kind for kind in type(error).__mro__ if kind.__module__ == ThermoForceError.__module__)
        return WorkerAnswer(reason=str(error) or kind.__name__, seconds=time.perf_counter() - began, error=kind)
    except Exception as error:
        reason, details = f"{type(error).__name__}: {error}", traceback.format_exc()
        return WorkerAnswer(reason=reason, seconds=time.perf_counter() - began, details=details)
    finally:
        _teller.reset(token)


def tell(share: float) -> None:
    """Tell from inside a task that a `share` of it, 0 to 1, is done; elsewhere nothing happens, nor twice in 0.5 s."""
    _teller.get()(share)


_teller: ContextVar[Callable[[float], None]] = ContextVar("teller", default=lambda share: None)
