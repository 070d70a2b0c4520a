"""Chronos-Bolt backbone (Ansari et al. 2024): univariate, patch input, nine quantiles."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Context, padded_series
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import nn


class BoltBackbone:
    """`Backbone` of a `ChronosBoltPipeline`; uses the series only."""

    def __init__(self, pipeline: Any, label: str) -> None:
        self._pipeline = pipeline
        self._label = label
        # The decoder runs once per call, so its cache is never read but takes 20 % of the time.
        pipeline.model.decoder.config.use_cache = False

    @property
    def label(self) -> str:
        """Name for reports."""
        return self._label

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights."""
        return (self._pipeline.model,)

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`; the library unrolls horizons beyond the trained one."""
        import torch

        steps = [len(context.ahead_weather) for context in contexts]
        with warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = self._pipeline.predict_quantiles(
                torch.from_numpy(padded_series(contexts)), max(steps), LEVELS.round(1).tolist()
            )
        return [np.asarray(value[:n].T.double().numpy()) for value, n in zip(values, steps, strict=True)]
