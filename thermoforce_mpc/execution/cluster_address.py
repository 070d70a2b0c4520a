"""Whether a Dask scheduler answers at an address.

A `Client` that finds nobody leaves a thread behind, or waits for ever.
"""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from typing import Any


def check_scheduler(address: str, within_s: float) -> None:
    """Ask who is at `address`.

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
    """What a scheduler, worker or nanny says of itself."""
    from distributed import Security
    from distributed.comm import connect
    from distributed.core import send_recv

    comm = await connect(address, timeout=within_s, **Security().get_connection_args("client"))
    try:
        identity: dict[str, Any] = await send_recv(comm, op="identity")
        return identity
    finally:
        comm.abort()
