"""Why the address of a connection is not reached, in words that say what to do."""

from __future__ import annotations

import socket
from collections.abc import Iterator

from thermoforce_mpc.errors import NoConnection, PlantError


def not_reached(where: str, keys: str, error: BaseException) -> PlantError:
    """What to raise where `where`, an address with its port, is not reached; `keys` of the connection say it.

    A `NoConnection` where waiting alone does not help: nothing listens there, or no such host is known.
    """
    mend = f"mend {keys} in the file of the connection"
    for cause in _causes(error):
        if isinstance(cause, ConnectionRefusedError):
            return NoConnection(f"{where} refuses the connection: nothing listens there; start it, or {mend}")
        if isinstance(cause, socket.gaierror):
            return NoConnection(f"{where}: no such host is known here; {mend}")
        if isinstance(cause, TimeoutError):
            return PlantError(f"{where} does not answer: is it on, and in this network? else {mend}")
    return PlantError(f"{where} cannot be reached ({type(error).__name__}: {error}); {mend}, or wait")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
