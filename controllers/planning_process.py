"""A process that plans for some of the buildings of a portfolio."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from controllers.many import Known, Together, Wanted
from thermoforce_mpc.execution.local import Remembering, one_thread_each


class PlanningProcess:
    """A process that plans for some buildings, started when it is first asked and again after its end."""

    def __init__(self, known: Known, grace_s: float) -> None:
        self._begin = (known, grace_s)
        self._context = Remembering()
        self._pool: ProcessPoolExecutor | None = None

    def asked(self, wanted: list[Wanted]) -> Future[bytes]:
        """The pickled plans of buildings, to come; raises `BrokenProcessPool` from its result."""
        try:
            return self._started().submit(_plans_of, pickle.dumps(wanted, pickle.HIGHEST_PROTOCOL))
        except BrokenProcessPool:  # it died since its last plans
            self.end()
            return self._started().submit(_plans_of, pickle.dumps(wanted, pickle.HIGHEST_PROTOCOL))

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # Spawned: a fork would copy the locks of compiled code in whatever state they are.
            self._context = Remembering()
            self._pool = ProcessPoolExecutor(1, self._context, _begin, self._begin)
            with one_thread_each():
                self._pool.submit(os.getpid)  # starts the process
        return self._pool

    def end(self) -> None:
        """End the process at once, even while it starts: it holds nothing that outlives it.

        What it was asked for ends with `BrokenProcessPool`.
        """
        if self._pool is not None:
            for process in self._context.started:
                process.kill()
            self._pool.shutdown()
        self._pool = None


_together: Together | None = None


def _begin(known: Known, grace_s: float) -> None:
    """In the process: an interrupt is for the parent, whose end is that of the process."""
    global _together
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _together = Together(known, grace_s)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _plans_of(wanted: bytes) -> bytes:
    assert _together is not None
    return pickle.dumps(list(_together.plans(pickle.loads(wanted))), pickle.HIGHEST_PROTOCOL)
