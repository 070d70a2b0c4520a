"""Call of a free response during a run, its work done here or together with others', and the mean of two."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import cast

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.execution.cooperative import Computation, Request, perform, run
from thermoforce_mpc.protocols import ComputedFreeResponse, FollowingFreeResponse, FreeResponse

Answer = tuple[FreeForecast, object]


def follow(method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object) -> Answer:
    """The forecast of `method` and its state for the next call of this run (None at its start)."""
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


class Computed(ABC):
    """`FreeResponse` around that of `of`, whose name and weights it has, by its computation `following`."""

    def __init__(self, of: FreeResponse) -> None:
        self._of = of
        if hasattr(of, "weight_hash"):
            self.weight_hash = of.weight_hash

    @property
    def name(self) -> str:
        """That of the method inside."""
        return self._of.name

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises as `following` does."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> Answer:
        """See `FollowingFreeResponse.follow`; raises as `following` does."""
        return run(self.following(free_C, history, boundary, state))

    @abstractmethod
    def following(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> Computation[Answer]:
        """See `ComputedFreeResponse.following`."""


class MeanFreeResponse(Computed):
    """`FreeResponse` that is the mean of `first` and `second`; neither keeps state.

    Their errors differ, so the mean errs less than either in most buildings, by equal shares as well as by estimated
    ones (Clemen 1989). Quantiles are averaged level by level (Lichtendahl et al. 2013).
    """

    def __init__(self, first: FreeResponse, second: FreeResponse) -> None:
        super().__init__(first)
        self._each = (first, second)

    def following(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> Computation[Answer]:
        """See `ComputedFreeResponse.following`; raises what either raises."""
        answers = []
        for method in self._each:
            forecast, _ = yield from following(method, free_C, history, boundary, None)
            answers.append(forecast)
        first, second = answers
        note = f"mean of {first.note} and {second.note}"
        return FreeForecast(first.levels, 0.5 * (first.quantiles_C + second.quantiles_C), note), None
