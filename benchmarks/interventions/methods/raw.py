"""Forecaster alone: it continues the measured temperature and does not depend on the action."""

from __future__ import annotations

import numpy as np

from benchmarks.interventions.dataset import Window
from thermoforce_mpc.data import Array
from thermoforce_mpc.protocols import FreeResponse


class RawForecast:
    """`Predictor` that returns the same forecast of T for every plan."""

    def __init__(self, free_response: FreeResponse) -> None:
        self._free_response = free_response
        self.note = "zero-shot"

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        history = window.history
        median = self._free_response.forecast(history.T_zone_C[0], history, window.boundary).median_C
        return np.broadcast_to(median, u.shape).copy()
