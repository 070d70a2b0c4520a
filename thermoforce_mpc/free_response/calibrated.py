"""Intervals corrected by what the method's own forecasts turned out to be, weather errors included.

Trials on the history (`selected`) know the weather in hindsight; only forecasts that were really issued show what
errors of the weather forecast do. So each is kept, compared with what has come since, and the last days set the width
(split conformal prediction over a rolling window, which follows slow changes).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.free_response.checks import checked_free
from thermoforce_mpc.free_response.walk_forward import Trial, interval_scale, rescaled
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.types import DAY_S, Array, Boundary, FreeForecast, History

_WINDOW_S = 6 * DAY_S
# Values a group of lead times must have seen before its width is touched: a day of hourly forecasts.
_LEAST_VALUES = 24


@dataclass(frozen=True)
class _Issued:
    """A forecast as issued, before any correction; `ends_s` (N,) are the ends of its steps."""

    time_s: float
    ends_s: Array
    forecast: FreeForecast


class CalibratedFreeResponse:
    """`inner` with intervals scaled so that they would have held 80 % of what came over the last six days.

    It remembers what it forecast, so one object belongs to one run; time going back, or another horizon, starts anew.
    """

    name = "calibrated"

    def __init__(self, inner: FreeResponse) -> None:
        self.inner = inner
        self._issued: deque[_Issued] = deque()

    def weight_hash(self) -> str:
        """Hash of the weights of the frozen method inside; raises `DataError` when it has none."""
        hashed = getattr(self.inner, "weight_hash", None)
        if hashed is None:
            raise DataError(f"calibrated: free response '{self.inner.name}' has no weights")
        return str(hashed())

    def forecast(self, free_C: Array, history: History, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises what the method inside raises."""
        free = checked_free(free_C, history)
        now = float(history.time_s[-1])
        raw = self.inner.forecast(free, history, boundary)
        if self._issued and (now < self._issued[-1].time_s or self._issued[-1].ends_s.size != boundary.n_steps):
            self._issued.clear()
        while self._issued and now - self._issued[0].time_s > _WINDOW_S:
            self._issued.popleft()
        if not self._issued:
            scale = np.ones(boundary.n_steps)
        else:
            trials = [Trial(past.forecast, _known(past.ends_s, history.time_s, free)) for past in self._issued]
            scale = interval_scale(trials, least_values=_LEAST_VALUES)
        if not self._issued or now > self._issued[-1].time_s:
            self._issued.append(_Issued(now, np.asarray(boundary.time_s[1:]), raw))
        corrected = rescaled(raw, scale)
        note = f"{raw.note}; interval times {scale.min():.1f} to {scale.max():.1f}"
        return FreeForecast(corrected.levels, corrected.quantiles_C, note)


def _known(ends_s: Array, time_s: Array, free: Array) -> Array:
    """The control-free temperature at `ends_s` (N,), NaN where it is not in the history."""
    index = np.searchsorted(time_s, ends_s - 0.5)
    inside = (index < time_s.size) & (ends_s >= time_s[0] - 0.5)
    index = np.minimum(index, time_s.size - 1)
    match = inside & (np.abs(time_s[index] - ends_s) < 0.5)
    return np.where(match, free[index], np.nan)
