"""Call of a free response during a run, with or without state, and with its work done here or together with others'."""

from __future__ import annotations

from typing import cast

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.execution.cooperative import Computation, Request, perform
from thermoforce_mpc.protocols import ComputedFreeResponse, FollowingFreeResponse, FreeResponse

Answer = tuple[FreeForecast, object]


def follow(method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object) -> Answer:
    """Return the forecast of `method` and its state for the next call of this run (None at its start).

    A method without state returns None as state. Raises what the method raises.
    """
    if isinstance(method, FollowingFreeResponse):
        return method.follow(free_C, history, boundary, state)
    return method.forecast(free_C, history, boundary), None


def following(
    method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object
) -> Computation[Answer]:
    """`follow` as a computation that yields requests; a method that makes none is one request itself."""
    # By name: checks of a protocol cost more than all else here.
    if hasattr(method, "following"):
        return (yield from cast(ComputedFreeResponse, method).following(free_C, history, boundary, state))
    answer: Answer = yield from perform(Request(method, lambda: follow(method, free_C, history, boundary, state)))
    return answer
