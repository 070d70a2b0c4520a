"""The mean of two free responses.

Their errors differ, so the mean errs less than either in most buildings, by equal shares as well as by estimated ones
(Clemen 1989). Quantiles are averaged level by level (Lichtendahl et al. 2013).
"""

from __future__ import annotations

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.execution.cooperative import Computation, run
from thermoforce_mpc.model.free_response.following import following
from thermoforce_mpc.protocols import FreeResponse


class MeanFreeResponse:
    """`FreeResponse` that is the mean of `first`, whose name and weights it has, and `second`; neither keeps state."""

    def __init__(self, first: FreeResponse, second: FreeResponse) -> None:
        self.name, self._each = first.name, (first, second)
        if hasattr(first, "weight_hash"):
            self.weight_hash = first.weight_hash

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises what either raises."""
        return run(self.following(free_C, history, boundary, None))[0]

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, object]]:
        """See `ComputedFreeResponse.following`; raises what either raises."""
        answers = []
        for method in self._each:
            forecast, _ = yield from following(method, free_C, history, boundary, None)
            answers.append(forecast)
        first, second = answers
        note = f"mean of {first.note} and {second.note}"
        return FreeForecast(first.levels, 0.5 * (first.quantiles_C + second.quantiles_C), note), None
