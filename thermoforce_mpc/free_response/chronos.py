"""A frozen time-series foundation model on the control-free series T − F (paper eq:compose), never trained here."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.errors import BackboneError, DataError
from thermoforce_mpc.free_response.backbones import SHIPPED, Weather, load_backbone, shipped_folder
from thermoforce_mpc.free_response.checks import LEVELS, checked_free
from thermoforce_mpc.free_response.persistence import Persistence
from thermoforce_mpc.types import DAY_S, HOUR_S, Array, Boundary, FreeForecast, History

__all__ = ["SHIPPED", "ChronosFreeResponse", "shipped_folder"]

# With less than a day of measurements a daily course cannot be known: persistence takes over and says so.
_SHORTEST_HISTORY_S = DAY_S
_LEAST_CONTEXT_STEPS = 16


class ChronosFreeResponse:
    """A frozen backbone: evaluation mode, no gradients, weights hashed on request."""

    name = "chronos"

    def __init__(self, backbone: str = SHIPPED, context_steps: int = 512) -> None:
        """Load the weights.

        Args:
            backbone: 'shipped', 'fracast', a local directory, or a hub name; see `load_backbone`.
            context_steps: how much of the history the model sees at most.

        Raises:
            BackboneError: the weights cannot be loaded, or `context_steps` is less than the 16 a patch has.
        """
        if context_steps < _LEAST_CONTEXT_STEPS:
            raise BackboneError(
                f"context_steps is {context_steps}: the backbone reads patches of {_LEAST_CONTEXT_STEPS}, give at least "
                "that"
            )
        self.backbone = backbone
        self._context_steps = context_steps
        self._model = load_backbone(backbone)
        self._short = Persistence()

    @property
    def label(self) -> str:
        """What it is, for reports."""
        return self._model.label

    def weight_hash(self) -> str:
        """SHA-256 over names and bytes of all weights: equal before and after a run, since they are frozen."""
        return self._model.weight_hash()

    def forecast(self, free_C: Array, history: History, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`. NaN gaps are passed to the model as they are, nothing is filled in.

        Raises:
            DataError: no value was ever measured, history and forecast differ in step, or the model's answer is not
                finite.
        """
        free = checked_free(free_C, history)
        context = free[-self._context_steps :]
        known = int(np.isfinite(context).sum())
        # A day has this many steps and one more boundary.
        if known <= round(_SHORTEST_HISTORY_S / boundary.step_s):
            short = self._short.forecast(free, history, boundary)
            hours = max(known - 1, 0) * boundary.step_s / HOUR_S
            return FreeForecast(short.levels, short.quantiles_C, f"persistence: only {hours:g} h of history measured")
        if abs(history.step_s - boundary.step_s) > 1e-6:
            raise DataError(f"history at {history.step_s:g} s and forecast at {boundary.step_s:g} s differ in step")
        weather = Weather(
            past={"T_out": history.T_out_C[-context.size :], "solar": history.solar_W_m2[-context.size :]},
            ahead={"T_out": boundary.T_out_C[1:], "solar": boundary.solar_W_m2[1:]},
        )
        values = np.sort(self._model.quantiles(context, boundary.n_steps, weather), axis=0)
        if values.shape != (LEVELS.size, boundary.n_steps) or not np.isfinite(values).all():
            raise DataError(f"{self.label} gave values of shape {values.shape} that are not all finite")
        return FreeForecast(LEVELS, values, self.label)
