"""Calls that go on beside the steps of a run, one after another in a thread of this process, answered by their keys.

A thread takes the interpreter in turns with the steps, so that these go on. A process of its own would run the user's
program again, as it starts.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

# Calls that are remembered, more than buildings are planned in one process; answers are small.
_KEPT = 1000


@dataclass(eq=False)
class _Call:
    make: Callable[[], Any] | None
    began_s: float | None = None
    done: bool = False
    answer: Any = None
    error: Exception | None = None


class CallsBeside:
    """Calls that wait, run or are answered, by keys: the same key stands for the same call."""

    def __init__(self) -> None:
        self._calls: dict[str, _Call] = {}
        self._waiting: deque[_Call] = deque()
        self._running: _Call | None = None
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def begin(self, key: str, call: Callable[[], Any]) -> None:
        """Make `call` when those before it are made; nothing where one of this key was begun."""
        with self._changed:
            if key in self._calls:
                return
            for old in [old for old, one in self._calls.items() if one.done][: len(self._calls) + 1 - _KEPT]:
                del self._calls[old]
            self._calls[key] = _Call(call)
            self._waiting.append(self._calls[key])
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="beside the steps", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def began(self, key: str) -> bool:
        """Whether there is a call of this key in this process: waiting, running or answered."""
        with self._changed:
            return key in self._calls

    def answered(self, key: str, seconds: float) -> bool:
        """Whether the call of a key is answered, waited for at most so long, s.

        Nor is it waited for any longer than until the call that runs has taken so long.
        """
        with self._changed:
            call, until_s = self._calls[key], time.monotonic() + seconds
            while not call.done:
                now_s = time.monotonic()
                runs_s = now_s if self._running is None or self._running.began_s is None else self._running.began_s
                left_s = min(until_s, runs_s + seconds) - now_s
                if left_s <= 0.0:
                    return False
                self._changed.wait(left_s)
            return True

    def answer(self, key: str) -> Any:
        """What the call of a key, which is `answered`, returned; raises what it raised."""
        with self._changed:
            call = self._calls[key]
        if call.error is not None:
            raise call.error
        return call.answer

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._waiting:
                    self._changed.wait()
                call = self._running = self._waiting.popleft()
                call.began_s = time.monotonic()
                self._changed.notify_all()
            assert call.make is not None
            try:
                call.answer = call.make()
            except BaseException as error:  # raised where the answer is asked for
                call.error = error if isinstance(error, Exception) else RuntimeError(f"it ended with {error!r}")
            with self._changed:
                call.done, call.make, self._running = True, None, None
                self._changed.notify_all()
            del call  # a waiting thread keeps nothing of it


_of_process: tuple[int, CallsBeside] | None = None


def beside() -> CallsBeside:
    """The calls beside the steps of this process; one that was forked begins with none."""
    global _of_process
    if _of_process is None or _of_process[0] != os.getpid():
        _of_process = os.getpid(), CallsBeside()
    return _of_process[1]
