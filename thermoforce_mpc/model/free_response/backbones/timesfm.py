"""TimesFM backbones (Das et al. 2024); package `timesfm`.

2.5 reads the series only; its weights are Apache-2.0. 3 also reads the weather forecast; its weights are for
non-commercial use.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context
from thermoforce_mpc.model.free_response.backbones.checkpoint import quiet

# Longest horizon of the quantile head of 2.5.
_AT_ONCE = 1024


def load(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 2.5 from the folder of its safetensors."""
    import torch
    from timesfm import TimesFM_2p5_200M_torch

    model = TimesFM_2p5_200M_torch(torch_compile=False)
    model.model.device, model.model.device_count = torch.device("cpu"), 1
    model.load_checkpoint(str(folder))
    return TimesFM25Backbone(model, f"TimesFM 2.5 '{name}'")


def load3(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 3 from a folder with its config.json and safetensors."""
    from timesfm3 import TimesFM3Forecaster

    with quiet():
        forecaster = TimesFM3Forecaster.from_pretrained(str(folder), device="cpu", local_files_only=True)
    return TimesFM3Backbone(forecaster, f"TimesFM 3 '{name}' with weather, non-commercial")


class TimesFM25Backbone(ByLength):
    """`Backbone` of a `TimesFM_2p5_200M_torch`; uses the series only, gaps bridged by the library."""

    def __init__(self, model: Any, label: str) -> None:
        super().__init__(label, (model.model,), _AT_ONCE)
        self._model = model

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        from timesfm import ForecastConfig

        # Compiling only keeps the settings; a context is filled up to the longest one that they allow.
        settings = ForecastConfig(
            max_context=contexts[0].free_C.size,
            max_horizon=steps,
            normalize_inputs=True,
            per_core_batch_size=len(contexts),
            use_continuous_quantile_head=True,
            infer_is_positive=False,  # °C
            fix_quantile_crossing=True,
        )
        self._model.compile(settings)
        _, values = self._model.forecast(steps, [context.free_C.astype(np.float32) for context in contexts])
        return np.asarray(values[..., 1:].transpose(0, 2, 1))  # the first is the mean


class TimesFM3Backbone(ByLength):
    """`Backbone` of a `TimesFM3Forecaster` with outdoor temperature, irradiance and clock, past and ahead."""

    def __init__(self, forecaster: Any, label: str) -> None:
        super().__init__(label, (forecaster.model,), _AT_ONCE)
        self._forecaster = forecaster

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        answers = self._forecaster.predict_batch(
            [context.free_C.astype(np.float32) for context in contexts],
            steps,
            past_future_covariates=[
                np.concatenate([context.past_weather, context.ahead_weather]).T.astype(np.float32)
                for context in contexts
            ],
            return_quantiles=True,
        )
        return np.stack([answer.quantiles.T for answer in answers])
