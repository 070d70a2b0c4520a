"""Weather-aware and still with a frozen backbone: a linear weather model, and a forecaster of what it leaves over."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.free_response.checks import checked_free
from thermoforce_mpc.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.free_response.linear_weather import SHORTEST_HISTORY_S, fit_linear_weather
from thermoforce_mpc.types import Array, Boundary, FreeForecast, History


class ResidualFreeResponse:
    """Linear weather model plus `backbone`'s forecast of its residual series (history less simulated course)."""

    name = "residual"

    def __init__(self, backbone: ChronosFreeResponse) -> None:
        self.backbone = backbone

    def weight_hash(self) -> str:
        """Hash of the backbone's weights, which nothing here changes."""
        return self.backbone.weight_hash()

    def forecast(self, free_C: Array, history: History, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` where the linear model or the backbone does."""
        free = checked_free(free_C, history)
        if history.n_steps * boundary.step_s < SHORTEST_HISTORY_S:
            # Too short to tell the weather's part; the backbone has its own way with a short history, and says so.
            return self.backbone.forecast(free, history, boundary)
        fit = fit_linear_weather(free, history, boundary)
        rest = self.backbone.forecast(free - fit.past_C, history, boundary)
        return FreeForecast(
            rest.levels,
            np.asarray(fit.ahead_C + rest.quantiles_C),
            f"linear weather model plus residual by {rest.note}",
        )
