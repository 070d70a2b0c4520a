"""Call of a free response during a run, with or without state."""

from __future__ import annotations

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.protocols import FollowingFreeResponse, FreeResponse


def follow(
    method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object
) -> tuple[FreeForecast, object]:
    """Return the forecast of `method` and its state for the next call of this run (None at its start).

    A method without state returns None as state. Raises what the method raises.
    """
    if isinstance(method, FollowingFreeResponse):
        return method.follow(free_C, history, boundary, state)
    return method.forecast(free_C, history, boundary), None
