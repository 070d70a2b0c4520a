"""Persistence forecast: the reference for other forecasters, and the fallback for short histories."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free, quantiles_from_errors


class Persistence:
    """`FreeResponse` that holds the last finite value; quantiles from past changes over each lead time."""

    name = "persistence"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` if no value was measured."""
        free = checked_free(free_C, history)
        n = boundary.n_steps
        last = free[np.flatnonzero(np.isfinite(free))[-1]]
        errors = np.full((free.size, n), np.nan)
        for lead in range(1, min(n, free.size - 1) + 1):
            errors[: free.size - lead, lead - 1] = free[lead:] - free[:-lead]
        return FreeForecast(LEVELS, quantiles_from_errors(np.full(n, last), errors), "persistence")
