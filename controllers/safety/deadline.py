"""Calls with a deadline on the wall clock: what has not answered by then is left behind, and the step goes on.

A call is made in a worker thread. One that is past its deadline cannot be stopped from outside; its thread is abandoned
with it, its result is dropped, and the object it belongs to is not called again before it has returned. Few may be left
behind at a time; beyond that nothing is started any more. Native code that holds the interpreter's lock cannot be
bounded this way: solvers get limits of their own as well.
"""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from thermoforce_mpc.errors import ThermoForceError

Result = TypeVar("Result")


class Overdue(ThermoForceError):
    """A call had not returned at its deadline, or an earlier one of the same object still has not."""


class Crashed(ThermoForceError):
    """A call ended with what is no `Exception`: an exit, or the panic of a compiled library."""


@dataclass(eq=False)
class _Job:
    call: Callable[[], Any]
    done: threading.Event = field(default_factory=threading.Event)
    result: Any = None
    error: BaseException | None = None


@dataclass(eq=False)
class _AbandonedCall:
    """A call that was left behind: the object it was made on, the job, and when it began, s (monotonic)."""

    owner: object
    job: _Job
    began_s: float


class BoundedCalls:
    """Makes calls one at a time, each within a time where one is given; `most_abandoned` may be left behind."""

    def __init__(self, most_abandoned: int) -> None:
        self._most = most_abandoned
        self._jobs: queue.SimpleQueue[_Job | None] | None = None
        self._thread: threading.Thread | None = None
        self._abandoned: list[_AbandonedCall] = []

    def __call__(self, owner: object, call: Callable[[], Result], seconds: float | None = None) -> Result:
        """Return what `call` returns, or raise what it raises.

        `owner`: the object whose method is called, not again while a call on it is left behind; `seconds`: how long to
        wait, s; None: for ever.

        Raises:
            Overdue: there was no answer in time, an earlier call of `owner` has not returned, or too many calls have
                not.
            Crashed: the call raised what is no `Exception`.
        """
        self._abandoned = [abandoned for abandoned in self._abandoned if not abandoned.job.done.is_set()]
        for abandoned in self._abandoned:
            if abandoned.owner is owner:
                waiting_s = time.monotonic() - abandoned.began_s
                raise Overdue(f"its call of {waiting_s:.0f} s ago has not returned")
        if len(self._abandoned) >= self._most:
            raise Overdue(f"{len(self._abandoned)} calls have not returned: no more are started")
        job, began_s = _Job(call), time.monotonic()
        if seconds is not None and seconds <= 0.0:
            raise Overdue("no time is left in this step")
        self._worker().put(job)
        answered = False
        try:
            answered = job.done.wait(seconds)
        finally:
            if not answered:  # also where the wait was interrupted
                self._abandoned.append(_AbandonedCall(owner, job, began_s))
                self._dismiss()
        if not answered:
            raise Overdue(f"no answer within {seconds:.3g} s")
        if job.error is None:
            return job.result
        if not isinstance(job.error, Exception):
            raise Crashed(f"it ended with {type(job.error).__name__} ({job.error})") from job.error
        raise job.error

    def _worker(self) -> queue.SimpleQueue[_Job | None]:
        """The queue of a living worker thread; a process that was forked has to start its own."""
        if self._jobs is None or self._thread is None or not self._thread.is_alive():
            self._jobs = queue.SimpleQueue()
            self._thread = threading.Thread(target=_work, args=(self._jobs,), name="bounded calls", daemon=True)
            self._thread.start()
            weakref.finalize(self, self._jobs.put, None)
        return self._jobs

    def _dismiss(self) -> None:
        if self._jobs is not None:
            self._jobs.put(None)
        self._jobs = self._thread = None


def _work(jobs: queue.SimpleQueue[_Job | None]) -> None:
    while (job := jobs.get()) is not None:
        try:
            job.result = job.call()
        except BaseException as error:  # raised again where the call was made
            job.error = error
        job.done.set()
        del job  # a waiting thread must not keep what it was called for
