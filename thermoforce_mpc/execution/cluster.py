"""Tasks on the workers of a Dask cluster (extra `[fleet]`): the same tasks, on machines that share no disk.

Dask places tasks, and begins those of a worker that dies elsewhere (`allowed-failures` times, a setting of its
scheduler). Here is what it leaves open: that workers have this code, and that a scheduler may restart.
"""

from __future__ import annotations

import asyncio
import functools
import os
import queue
import sys
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.errors import ConfigError, EngineError, counted
from thermoforce_mpc.execution.execute import Begun, Ended, Event, Lost, Told, WorkerAnswer, answer_to
from thermoforce_mpc.execution.keys import source_fingerprint
from thermoforce_mpc.execution.local import LocalEngine
from thermoforce_mpc.files import no_secret_in
from thermoforce_mpc.version import VERSION, installed

# So long an attempt to connect takes at least, and the pause after it.
_LEAST_S = 1.0
_MOST_NAMED = 3
# So many more tasks than threads wait at the scheduler that a cluster that grows with its work does grow.
_IN_HAND = 20
# A task may bring files along, such as an FMU: no reason for a warning.
_LARGE_IS_MEANT = {"distributed.admin.large-graph-warning-threshold": "1 GB"}
_PACKAGES = ("casadi", "distributed", "numpy", "torch")


@functools.cache
def environment() -> dict[str, str]:
    """Versions in this process, by name; `source` is the fingerprint of this package's code."""
    versions = {"thermoforce-mpc": VERSION, "source": source_fingerprint()}
    versions["python"] = f"{sys.version_info.major}.{sys.version_info.minor}"
    return versions | installed(_PACKAGES)


def misfit(expected: Mapping[str, str], dask_worker: Any) -> str:
    """Runs on a worker: what is wrong with it for a client of the environment `expected`; empty if nothing is."""
    actual, n, omp = environment(), dask_worker.state.nthreads, os.environ.get("OMP_NUM_THREADS", "")
    differs = [
        f"{name} {actual.get(name, 'unknown')} instead of {version}"
        for name, version in expected.items()
        if actual.get(name) != version
    ]
    if differs:
        return f"has {', '.join(differs)}; start it in the environment of the client"
    if n == 1 and omp == "1":
        return ""
    return (
        f"computes on {n} threads with OMP_NUM_THREADS '{omp}', so that results depend on it: start workers "
        "with --nthreads 1 and OMP_NUM_THREADS=1 (a nanny sets it)"
    )


@dataclass(frozen=True)
class Order:
    """A task for a worker: what to run, where to tell, and the environment of the client."""

    key: str
    payload: bytes
    topic: str
    environment: Mapping[str, str]


class WrongWorker(Exception):
    """The worker has other versions or source code than the client, or more than one thread: another one is taken."""


class _Cancelled(BaseException):
    """The client no longer wants the task; raised where the task tells how far it is, so that it releases its plant."""


def perform(order: Order) -> WorkerAnswer:
    """Run a task on this worker; raises `WrongWorker`."""
    from distributed import get_worker

    worker = get_worker()
    # The client has seen only the workers that were there when it came.
    if wrong := misfit(order.environment, worker):
        raise WrongWorker(f"worker {worker.address} {wrong}")
    mine = worker.get_current_task()

    def report(share: float) -> None:
        state: Any = worker.state.tasks.get(mine)
        if state is None or state.state == "cancelled":
            raise _Cancelled
        worker.log_event(order.topic, {"key": order.key, "share": share})

    worker.log_event(order.topic, {"key": order.key})
    return answer_to(order.payload, report)


@dataclass(frozen=True)
class Patience:
    """How long things may take, s."""

    connect_s: float = 10.0  # until a scheduler answers
    back_s: float = 120.0  # until one that is gone is back
    look_s: float = 2.0  # between two looks at the workers
    repeat_s: float = 60.0  # between two messages of why nothing goes on


class DaskEngine:
    """Tasks on the cluster of the scheduler at `address`, such as tcp://host:8786; a context manager.

    `say` is told what a user may want to know, `warn` (by default `say`) why nothing goes on.

    Raises:
        ConfigError: the extra is missing, no scheduler answers, or a worker has other versions, other source code or
            more than one thread.
    """

    def __init__(
        self,
        address: str,
        *,
        patience: Patience | None = None,
        say: Callable[[str], None] = lambda line: None,
        warn: Callable[[str], None] | None = None,
    ) -> None:
        self._address, self._patience, self._say, self._warn = address, patience or Patience(), say, warn or say
        self._topic = f"thermoforce-mpc-{uuid.uuid4().hex}"
        self._orders: dict[str, Order] = {}
        self._futures: dict[str, Any] = {}
        self._events: queue.SimpleQueue[Event | tuple[str, Any]] = queue.SimpleQueue()
        self._threads: dict[str, int] = {}  # of each worker
        self._unfit: dict[str, str] = {}  # workers that came later and do not fit, and why
        self._only: dict[str, frozenset[str]] = {}  # to which workers a task may go, where some do not fit
        self._checked_s, self._working_s, self._asked = 0.0, time.monotonic(), 0
        try:
            self._client = self._connect(self._patience.connect_s)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {address}: no Dask scheduler answers there ({_first_line(error)}); start one by "
                "`dask scheduler`, and workers by `dask worker ADDRESS --nthreads 1 --nworkers N`"
            ) from error
        try:
            n = self._check_workers()
        except BaseException:
            self._close()
            raise
        say(f"Dask scheduler {address}: {counted(n, 'worker')}")
        if not n:
            self._warn(self._no_worker())

    def __enter__(self) -> DaskEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()
        self._close()

    def _close(self) -> None:
        with suppress(OSError):
            self._client.close(timeout=self._patience.connect_s)

    @property
    def width(self) -> int:
        """Number of workers, which have one thread each."""
        if time.monotonic() - self._checked_s > self._patience.look_s:
            self._update_workers()
        return sum(n for worker, n in self._threads.items() if worker not in self._unfit)

    @property
    def room(self) -> int:
        """Tasks for every thread twice, and some more; what waits, waits at the scheduler."""
        return 2 * self.width + _IN_HAND - len(self._orders)

    def submit(self, key: str, title: str, payload: bytes) -> None:
        """Run `payload` on a worker."""
        self._orders[key] = Order(key, payload, self._topic, environment())
        if self._client.status == "running":
            self._send(key, title)
        else:
            self._reconnect()

    def _send(self, key: str, title: str) -> None:
        import dask

        name = f"{title}-{uuid.uuid4().hex}"  # the dashboard shows what comes before the last hyphen
        with dask.config.set(_LARGE_IS_MEANT):
            fit = [worker for worker in self._threads if worker not in self._unfit] if self._unfit else None
            future = self._client.submit(perform, self._orders[key], key=name, pure=False, workers=fit)
        self._only.pop(key, None)
        if fit is not None:
            self._only[key] = frozenset(fit)
        self._futures[key] = future
        future.add_done_callback(lambda done: self._events.put((key, done)))

    def wait(self) -> Event:
        """The next event; raises `EngineError` if the scheduler does not come back, or no worker fits."""
        while True:
            if self._client.status == "running" and time.monotonic() - self._checked_s > self._patience.look_s:
                self._update_workers()
            try:
                event = self._events.get(timeout=self._patience.look_s)
            except queue.Empty:
                if self._client.status != "running":
                    self._reconnect()
                continue
            if not isinstance(event, tuple):
                return event
            key, future = event
            if self._futures.get(key) is future:  # else it was cancelled, or sent again
                ended = self._ended(key, future)
                if ended is not None:
                    del self._orders[key], self._futures[key]
                    self._only.pop(key, None)
                    return ended

    def _ended(self, key: str, future: Any) -> Event | None:
        from distributed import KilledWorker

        try:
            answer: WorkerAnswer = future.result()
        except KilledWorker as error:
            return Lost(key, f"worker {error.last_worker.address}", error.allowed_failures + 1)
        except Exception as error:
            if future.status != "error":
                self._reconnect()
                return None
            wrong = isinstance(error, WrongWorker)
            if not self._leave_out_misfits() and not wrong:
                raise EngineError(f"a worker cannot run tasks of this version: {_first_line(error)}") from error
            self._send(key, key)
            return None
        return Ended(key, answer)

    def _leave_out_misfits(self) -> bool:
        """Give no more tasks to workers that came later and do not fit; whether there are any.

        Raises:
            EngineError: none fits.
        """
        wrong = self._misfits()
        self._update_workers()
        for worker, why in wrong.items():
            if worker not in self._unfit:
                self._warn(f"worker {worker} {why}; it gets no tasks")
        self._unfit = wrong
        if wrong and not self._threads.keys() - wrong.keys():
            worker, why = next(iter(wrong.items()))
            raise EngineError(f"worker {worker} {why}; there is no other")
        return bool(wrong)

    def _misfits(self) -> dict[str, str]:
        """Workers that do not fit, and why."""
        answers = self._client.run(misfit, environment(), on_error="return")
        self._asked = len(answers)
        said = {
            worker: f"cannot load thermoforce-mpc of this version: {_first_line(wrong)}"
            if isinstance(wrong, BaseException)
            else wrong
            for worker, wrong in answers.items()
        }
        return {worker: wrong for worker, wrong in said.items() if wrong}

    def cancel(self) -> None:
        """Forget what is under way; a task that has begun ends when it next tells how far it is."""
        futures = list(self._futures.values())
        self._futures.clear()
        self._orders.clear()
        self._only.clear()
        if futures and self._client.status == "running":
            with suppress(OSError):
                self._client.cancel(futures, force=True)

    def _connect(self, within_s: float) -> Any:
        """A client; raises `OSError` where no scheduler answers in time, `ValueError` for what is no address."""
        try:
            from distributed import Client
        except ImportError:
            raise ConfigError("--scheduler needs the extra [fleet]: pip install 'thermoforce-mpc[fleet]'") from None
        no_secret_in(self._address, "--scheduler", "Dask has none in an address")
        _check_scheduler(self._address, within_s)
        client = Client(self._address, timeout=self._patience.connect_s, set_as_default=False)
        client.subscribe_topic(self._topic, self._hear)
        return client

    def _hear(self, event: tuple[float, dict[str, Any]]) -> None:
        key, share = event[1]["key"], event[1].get("share")
        self._events.put(Begun(key) if share is None else Told(key, share))

    def _check_workers(self) -> int:
        """Compare the workers there are with this process; returns their number, raises `ConfigError`.

        Those that come later compare themselves, with each task, and get none where they do not fit.
        """
        for worker, wrong in self._misfits().items():
            raise ConfigError(f"worker {worker} {wrong}")
        return self._asked

    def _update_workers(self) -> None:
        """Read which workers there are now; report those that are gone, and where there are none for long."""
        try:
            # The client may not have noticed yet that its scheduler is gone, and something silent be in its place.
            within_s = min(self._patience.connect_s, self._patience.back_s)
            former, self._threads = self._threads, self._client.nthreads(callback_timeout=within_s)
            self._report_gone(sorted(former.keys() - self._threads.keys()))
            problem = "" if self._threads else self._no_worker()
        except OSError:
            problem = f"the Dask scheduler at {self._address} does not answer; waiting for it"
        self._checked_s = time.monotonic()
        # Those that a task was meant for may have been started again, under other names.
        for key in [key for key, only in self._only.items() if not only & self._threads.keys()]:
            if key in self._orders and self._threads.keys() - self._unfit.keys():
                self._send(key, key)
        if not problem:
            self._working_s = self._checked_s
        elif self._checked_s - self._working_s > self._patience.repeat_s:
            self._working_s = self._checked_s
            self._warn(problem)

    def _report_gone(self, workers: list[str]) -> None:
        if workers:
            names = ", ".join(workers[:_MOST_NAMED]) + (", …" if len(workers) > _MOST_NAMED else "")
            gone, left = counted(len(workers), "worker"), counted(len(self._threads), "worker")
            self._say(f"{gone} gone ({names}), {left} left; what was under way there is begun again")

    def _no_worker(self) -> str:
        return f"no worker is connected to {self._address}; waiting for one"

    def _reconnect(self) -> None:
        self._warn(f"the Dask scheduler at {self._address} is gone; waiting {self._patience.back_s:.0f} s for it")
        self._futures.clear()
        until = time.monotonic() + self._patience.back_s
        with suppress(Exception):  # it may be in any state
            self._client.close(timeout=1.0)
        while True:
            try:
                self._client = self._connect(max(min(self._patience.connect_s, until - time.monotonic()), _LEAST_S))
                break
            except OSError as error:
                if time.monotonic() + _LEAST_S > until:
                    raise EngineError(
                        f"the Dask scheduler at {self._address} did not come back in {self._patience.back_s:.0f} s; "
                        "results until here are kept: start it and repeat the command"
                    ) from error
                time.sleep(_LEAST_S)
        self._threads = {}  # they ended with their scheduler
        self._update_workers()
        self._warn(f"the Dask scheduler is back; {counted(len(self._orders), 'task')} sent again")
        for key in self._orders:
            self._send(key, key)


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _check_scheduler(address: str, within_s: float) -> None:
    """Ask who is at `address`: a `Client` that finds nobody leaves a thread behind, or waits for ever.

    Raises:
        OSError: no scheduler answers within `within_s`.
        ValueError: this is no address.
    """
    answer: Future[None] = Future()

    def ask() -> None:
        try:
            answer.set_result(asyncio.run(_check(address, within_s)))
        except BaseException as error:
            answer.set_exception(error)

    # Elsewhere, since this thread may have an event loop, as in a notebook; as a daemon, so that signals need not wait.
    threading.Thread(target=ask, name="tf-mpc asks a scheduler", daemon=True).start()
    answer.result(within_s + 1.0)  # looking up a name cannot be cancelled


async def _check(address: str, within_s: float) -> None:
    try:
        # The time limit of `connect` ends where the other side has accepted: it may be silent from there on.
        identity = await asyncio.wait_for(_identity(address, within_s), within_s)
    except TimeoutError:
        raise TimeoutError(f"no answer within {within_s:g} s") from None
    if "workers" not in identity:
        raise ConnectionError(f"this is the address of a {str(identity.get('type', 'stranger')).lower()}")


async def _identity(address: str, within_s: float) -> dict[str, Any]:
    from distributed import Security
    from distributed.comm import connect
    from distributed.core import send_recv

    comm = await connect(address, timeout=within_s, **Security().get_connection_args("client"))
    try:
        identity: dict[str, Any] = await send_recv(comm, op="identity")
        return identity
    finally:
        comm.abort()


def open_engine(
    jobs: int | None = None,
    scheduler: str | None = None,
    say: Callable[[str], None] = lambda line: None,
    warn: Callable[[str], None] | None = None,
) -> LocalEngine | DaskEngine:
    """The engine that a user asked for: the Dask workers of `scheduler`, else `jobs` processes (default: one a core).

    `say`, `warn` and `ConfigError` as of `DaskEngine`.
    """
    if scheduler is not None:
        return DaskEngine(scheduler, say=say, warn=warn)
    return LocalEngine(jobs or os.cpu_count() or 1)
