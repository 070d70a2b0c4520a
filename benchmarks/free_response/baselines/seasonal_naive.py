"""Seasonal naive forecast: the value of the same hour of the day before."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free, quantiles_from_errors


class SeasonalNaive:
    """Forecast by the course of the last day; quantiles from the differences of consecutive days."""

    name = "seasonal_naive"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` for less than a day of history or gaps in the last day."""
        free = checked_free(free_C, history)
        n, day = boundary.n_steps, round(DAY_S / boundary.step_s)
        if free.size < day + 1:
            raise DataError(f"seasonal naive needs a day of history, got {free.size - 1} of {day} steps")
        if not np.isfinite(free[-day:]).all():
            raise DataError("seasonal naive: the last day of the control-free history has gaps")
        center = free[-day:][np.arange(n) % day]
        steps = free[day:] - free[:-day]
        errors = np.repeat(steps[:, None], n, axis=1)
        return FreeForecast(LEVELS, quantiles_from_errors(center, errors), "same hour of the day before")
