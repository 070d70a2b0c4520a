"""Exponential smoothing, damped trend and daily season: ETS(A, Ad, A) of Hyndman and Athanasopoulos 2021, ch. 8."""

from __future__ import annotations

import itertools

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free, quantiles_from_errors

# All combinations run side by side; the one with the smallest squared error one step ahead is used.
_LEVEL = (0.1, 0.3, 0.6, 0.9, 1.0)
_TREND = (0.0, 0.02, 0.1, 0.3)
_SEASON = (0.0, 0.05, 0.2, 0.5)
_DAMPING = (0.8, 0.9, 0.98)
_GRID = np.array(list(itertools.product(_LEVEL, _TREND, _SEASON, _DAMPING)))
# A forecast is started this many times per day of history to learn the errors at each lead time.
_STARTS_PER_DAY = 4


class ExponentialSmoothing:
    """Level, damped trend and daily season; smoothing constants by grid on the history given."""

    name = "ets"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; a gap leaves the states as they are forecast.

        Raises:
            DataError: less than two days of history.
        """
        free = checked_free(free_C, history)
        n, day = boundary.n_steps, round(DAY_S / boundary.step_s)
        if free.size < 2 * day:
            raise DataError(f"exponential smoothing needs two days of history, got {free.size - 1} of {2 * day} steps")
        alpha, beta, gamma, phi = _GRID.T
        first = free[:day]
        level = np.full(len(_GRID), np.nanmean(first) if np.isfinite(first).any() else free[np.isfinite(free)][0])
        trend = np.zeros(len(_GRID))
        pattern = np.where(np.isfinite(first), first - level[0], 0.0)
        season = np.tile(pattern[:, None], (1, len(_GRID)))
        squared = np.zeros(len(_GRID))
        starts: list[tuple[int, Array, Array, Array]] = []
        for t in range(day, free.size):
            if t % max(1, day // _STARTS_PER_DAY) == 0 and t + n <= free.size:
                starts.append((t, level, trend, season.copy()))
            slot = t % day
            smooth = level + phi * trend
            if np.isfinite(free[t]):
                error = free[t] - smooth - season[slot]
                squared += error**2
                level = smooth + alpha * error
                trend = phi * trend + beta * alpha * error
                season[slot] = season[slot] + gamma * (1.0 - alpha) * error
            else:
                level, trend = smooth, phi * trend
        best = int(np.argmin(squared))
        damping = np.cumsum(phi[best] ** np.arange(1, n + 1))

        def ahead(t: int, level: Array, trend: Array, season: Array) -> Array:
            return np.asarray(level[best] + damping * trend[best] + season[(t + np.arange(n)) % day, best])

        errors = np.array([free[t : t + n] - ahead(t, *state) for t, *state in starts]).reshape(-1, n)
        center = ahead(free.size, level, trend, season)
        return FreeForecast(LEVELS, quantiles_from_errors(center, errors), "exponential smoothing, ETS(A, Ad, A)")
