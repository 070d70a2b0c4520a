"""TiRex-2 backbone (Podest et al. 2026), with the weather forecast as known covariates; package `tirex-2`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import Tensor


def load(name: str, folder: Path) -> Backbone:
    """Load a TiRex-2 from a folder with its config.json and safetensors.

    Raises:
        BackboneError: it forecasts other quantiles.
    """
    from tirex2 import load_model

    forecaster = load_model(folder, device="cpu")
    levels = forecaster.model.quantiles.tolist()
    if not (len(levels) == LEVELS.size and np.allclose(levels, LEVELS)):
        raise BackboneError(f"backbone '{name}': its quantiles are {levels}, expected 0.1 ... 0.9")
    return TiRex2Backbone(forecaster, f"TiRex-2 '{name}' with weather")


class TiRex2Backbone(ByLength):
    """`Backbone` of a `tirex2.ForecastModel`."""

    def __init__(self, forecaster: Any, label: str) -> None:
        super().__init__(label, (forecaster.model,), int(forecaster.model.future_len))
        self._forecaster = forecaster

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        from tirex2 import TimeseriesType

        series = [
            TimeseriesType(
                target=_rows(context.free_C[None]),
                past_covariates=None,
                future_covariates=_rows(np.concatenate([context.past_weather, context.ahead_weather]).T),
            )
            for context in contexts
        ]
        return np.concatenate(self._forecaster.forecast(series, prediction_length=steps, output_type="numpy"))


def _rows(values: Array) -> Tensor:
    import torch

    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
