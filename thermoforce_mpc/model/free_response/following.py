"""Asking a free response in the course of a run, whether it follows the run or answers from its arguments alone."""

from __future__ import annotations

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.protocols import FollowingFreeResponse, FreeResponse


def follow(
    method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object
) -> tuple[FreeForecast, object]:
    """The forecast of `method`, and its state for the next call of this run (None begins a run).

    A method that answers from its arguments alone has no state: it is None. Raises what the method raises.
    """
    if isinstance(method, FollowingFreeResponse):
        return method.follow(free_C, history, boundary, state)
    return method.forecast(free_C, history, boundary), None
