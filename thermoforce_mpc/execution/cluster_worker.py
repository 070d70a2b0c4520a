"""What a worker of a Dask cluster does with a task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.execution.engine import Answer, answer_to
from thermoforce_mpc.execution.environment import difference, environment, threads


@dataclass(frozen=True)
class Order:
    """A task for a worker: what to run, where to tell, and the environment of the client."""

    key: str
    payload: bytes
    topic: str
    environment: Mapping[str, str]


class WrongWorker(Exception):
    """The worker has other versions or source code than the client."""


class _Cancelled(BaseException):
    """The client no longer wants the task; raised where the task tells how far it is, so that it releases its plant."""


def look() -> tuple[dict[str, str], str]:
    """Environment and threads of a worker."""
    return environment(), threads()


def perform(order: Order) -> Answer:
    """Run a task on this worker; raises `WrongWorker`."""
    from distributed import get_worker

    worker = get_worker()
    differs = difference(order.environment, environment())
    if differs:
        raise WrongWorker(f"worker {worker.address} has {differs}; start it in the environment of the client")
    mine = worker.get_current_task()

    def told(share: float) -> None:
        state: Any = worker.state.tasks.get(mine)
        if state is None or state.state == "cancelled":
            raise _Cancelled
        worker.log_event(order.topic, {"key": order.key, "share": share})

    worker.log_event(order.topic, {"key": order.key})
    return answer_to(order.payload, told)
