"""Tasks on the cores of this machine: processes of the standard library's pool, one pool a process.

In a pool of several, the death of one process breaks the tasks of all; so each has its own, and what dies takes one
task with it. Processes compute on one thread, so that they do not compete for cores and results do not depend on their
number.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import synchronize
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from thermoforce_mpc.errors import EngineError, left_to_parent
from thermoforce_mpc.execution.execute import Begun, Ended, Event, Lost, Told, WorkerAnswer, answer_to

Result = TypeVar("Result")
_GUARD = 'A program that starts processes needs `if __name__ == "__main__":` around all that is not a definition'
_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class LocalEngine:
    """Tasks in `jobs` processes, started when first needed and used again; a context manager.

    Spawned, not forked: a fork would copy locks of compiled code in an undefined state. A process has `leave_s`, s, to
    leave its task when that is cancelled; then it is killed.
    """

    def __init__(self, jobs: int, *, leave_s: float = 5.0) -> None:
        self._jobs, self._leave_s = jobs, leave_s
        self._idle: list[_Process] = []
        self._busy: dict[str, _Process] = {}
        self._events: queue.SimpleQueue[Event | tuple[str, _Process, Future[WorkerAnswer]]] = queue.SimpleQueue()

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()
        for process in self._idle:
            process.close()
        while self._idle:
            self._idle.pop().leave()

    @property
    def width(self) -> int:
        """Number of processes."""
        return self._jobs

    @property
    def room(self) -> int:
        """Processes without a task."""
        return self._jobs - len(self._busy)

    def submit(self, key: str, title: str, payload: bytes) -> None:
        """Run `payload` in a process."""
        # Known as busy before it is: an interrupt may come as soon as it has the task.
        process = self._busy[key] = self._idle.pop() if self._idle else _Process(self._events)
        try:
            future = process.run(key, payload)
        except BrokenProcessPool:  # it died since its last task
            process.leave()
            process = self._busy[key] = _Process(self._events)
            future = process.run(key, payload)
        self._events.put(Begun(key))
        future.add_done_callback(lambda done: self._events.put((key, process, done)))

    def wait(self) -> Event:
        """The next event."""
        while True:
            event = self._events.get()
            if not isinstance(event, tuple):
                return event
            key, process, future = event
            if self._busy.get(key) is process:  # else it was cancelled
                del self._busy[key]
                return self._ended(key, process, future)

    def _ended(self, key: str, process: _Process, future: Future[WorkerAnswer]) -> Event:
        try:
            answer = future.result()
        except BrokenProcessPool:
            how = process.leave()
            if reason := process.never_began():
                raise EngineError(f"task '{key}': {reason}") from None
            return Lost(key, how)
        self._idle.append(process)
        return Ended(key, answer)

    def cancel(self) -> None:
        """End processes that have a task: first by SIGTERM, so that they release what they hold."""
        for process in self._busy.values():
            process.terminate()
        until = time.monotonic() + self._leave_s
        while self._busy:
            self._busy.popitem()[1].leave(max(0.0, until - time.monotonic()))


class OneProcess:
    """A pool of one spawned process that computes on one thread; its first call starts it.

    Raises `EngineError` in a process that is itself being started.
    """

    def __init__(self, initializer: Callable[..., None], *initargs: Any) -> None:
        refuse_while_starting()
        self._context = _Remembering()
        self._began = self._context.Event()
        self._pool = ProcessPoolExecutor(1, self._context, _first, (self._began, initializer, *initargs))

    def submit(self, function: Callable[..., Result], *args: Any) -> Future[Result]:
        """The result of a call there, to come; raises `BrokenProcessPool` where the process has ended."""
        with _one_thread_each(), _interrupts_blocked():
            return self._pool.submit(function, *args)

    def close(self) -> None:
        """Let the process end."""
        self._pool.shutdown(wait=False)

    def terminate(self) -> None:
        """Ask the process to end, by SIGTERM."""
        for process in self._context.started:
            process.terminate()

    def leave(self, patience_s: float | None = None) -> str:
        """Wait for the end of the process, kill it after `patience_s`; returns how it ended."""
        for process in self._context.started:
            if patience_s is not None:
                process.join(patience_s)
                process.kill()
        self._pool.shutdown()
        return ", ".join(_how_ended(process.exitcode or 0) for process in self._context.started)

    def never_began(self) -> str:
        """Why every other process would end as this one, which has ended, did: by an error while it started, or ""."""
        # A pool asks for the code of a process that has ended in a thread of its own; asked for by two, one has none.
        self._pool.shutdown()
        codes = [process.exitcode for process in self._context.started if process.exitcode]
        if self._began.is_set() or not codes:
            return ""
        # Killed: there may be room for another one. What is left of a process that ended, the pool ends by SIGTERM.
        if codes[-1] < 0 and codes[-1] != -signal.SIGTERM:
            return ""
        return f"its process ended as it started ({_how_ended(codes[-1])}; what it said is above). {_GUARD}"


def refuse_while_starting() -> None:
    """Raise `EngineError` where this process is being started by another one, and runs the program for its names."""
    # What multiprocessing itself looks at as it starts a process; it has no public name.
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise EngineError(f"a process that is being started would start processes in turn. {_GUARD}")


class _Process(OneProcess):
    """A process for tasks, and what its task tells."""

    def __init__(self, events: queue.SimpleQueue[Any]) -> None:
        receiver, self._sender = SpawnContext().Pipe(duplex=False)
        super().__init__(_begin, self._sender)
        threading.Thread(target=_listen, args=(receiver, events), daemon=True).start()

    def run(self, key: str, payload: bytes) -> Future[WorkerAnswer]:
        """Run `payload`; raises `BrokenProcessPool`."""
        future = self.submit(work, key, payload)
        self._sender.close()  # so that the pipe ends with the process
        return future


def _how_ended(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"signal {-code}"


class _Remembering(SpawnContext):
    """Remembers its processes: a pool neither ends nor describes them."""

    def __init__(self) -> None:
        self.started: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        """A process that is remembered."""
        self.started.append(SpawnProcess(*args, **kwargs))
        return self.started[-1]


def _first(began: synchronize.Event, initializer: Callable[..., None], *initargs: Any) -> None:
    """What the process does first: all that could fail in its start is behind it."""
    began.set()
    initializer(*initargs)


def _listen(channel: Connection, events: queue.SimpleQueue[Any]) -> None:
    with channel, suppress(EOFError, OSError):
        while True:
            events.put(Told(*channel.recv()))


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Set the variables that limit processes started inside to one thread (read when libraries are loaded)."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_TERMINATED = 143

_channel: Connection | None = None


def _begin(channel: Connection) -> None:
    """Prepare the process: interrupts are for the parent, which ends this process by SIGTERM; so does its own end."""
    global _channel
    _channel = channel
    left_to_parent()
    signal.signal(signal.SIGTERM, _terminate)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _terminate(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not cut the release short
    sys.exit(_TERMINATED)


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def work(key: str, payload: bytes) -> WorkerAnswer:
    """Make the call of `payload`, the task of `key`, in a process of the engine."""

    def tell(share: float) -> None:
        if _channel is not None:
            with suppress(OSError):  # the parent has ended
                _channel.send((key, share))

    try:
        return answer_to(payload, tell)
    except SystemExit:  # what the task held is released; the pool would go on
        for child in multiprocessing.active_children():
            child.terminate()
        os._exit(_TERMINATED)
