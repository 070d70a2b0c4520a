"""What a worker of a Dask cluster does with a task."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.execution.engine import Answer, answer_to
from thermoforce_mpc.execution.keys import source_fingerprint
from thermoforce_mpc.version import VERSION, installed

_PACKAGES = ("casadi", "distributed", "numpy", "torch")


@functools.cache
def environment() -> dict[str, str]:
    """Versions in this process, by name; `source` is the fingerprint of this package's code."""
    versions = {"thermoforce-mpc": VERSION, "source": source_fingerprint()}
    versions["python"] = f"{sys.version_info.major}.{sys.version_info.minor}"
    return versions | installed(_PACKAGES)


def threads() -> str:
    """How many threads numerical libraries of this process use, as they were told: '' where nobody said."""
    return os.environ.get("OMP_NUM_THREADS", "")


def difference(expected: Mapping[str, str], actual: Mapping[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(
        f"{name} {actual.get(name, 'unknown')} instead of {version}"
        for name, version in expected.items()
        if actual.get(name) != version
    )


@dataclass(frozen=True)
class Order:
    """A task for a worker: what to run, where to tell, and the environment of the client."""

    key: str
    payload: bytes
    topic: str
    environment: Mapping[str, str]


class WrongWorker(Exception):
    """The worker has other versions or source code than the client, or more than one thread."""


class _Cancelled(BaseException):
    """The client no longer wants the task; raised where the task tells how far it is, so that it releases its plant."""


def look() -> tuple[dict[str, str], str]:
    """Environment and threads of a worker."""
    return environment(), threads()


def more_threads(n: int, omp_threads: str) -> str:
    """What is wrong with a worker of `n` threads whose `OMP_NUM_THREADS` is `omp_threads`; empty where each has one."""
    if n == 1 and omp_threads == "1":
        return ""
    return (
        f"computes on {n} threads with OMP_NUM_THREADS '{omp_threads}', so that results depend on it: start workers "
        "with --nthreads 1 and OMP_NUM_THREADS=1 (a nanny sets it)"
    )


def perform(order: Order) -> Answer:
    """Run a task on this worker; raises `WrongWorker`."""
    from distributed import get_worker

    worker = get_worker()
    differs = difference(order.environment, environment())
    if differs:
        raise WrongWorker(f"worker {worker.address} has {differs}; start it in the environment of the client")
    # The client has seen only the workers that were there when it came.
    if wrong := more_threads(worker.state.nthreads, threads()):
        raise WrongWorker(f"worker {worker.address} {wrong}")
    mine = worker.get_current_task()

    def report(share: float) -> None:
        state: Any = worker.state.tasks.get(mine)
        if state is None or state.state == "cancelled":
            raise _Cancelled
        worker.log_event(order.topic, {"key": order.key, "share": share})

    worker.log_event(order.topic, {"key": order.key})
    return answer_to(order.payload, report)
