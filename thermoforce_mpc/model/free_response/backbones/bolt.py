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

# Largest batch: beyond, the activations leave the cache of a core and the pass becomes slower.
_AT_ONCE = 48
# Contexts of one length below which they join a batch of longer ones.
_FEW = 16


class BoltBackbone:
    """`Backbone` of a `ChronosBoltPipeline`; uses the series only."""

    def __init__(self, pipeline: Any, label: str) -> None:
        self._pipeline = pipeline
        self._label = label
        settings = pipeline.model.chronos_config
        self._patch, self._at_once = int(settings.input_patch_size), int(settings.prediction_length)
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
        """See `Backbone.quantiles_C`; the library unrolls horizons beyond the trained one.

        Contexts of one number of patches form a batch, since padding to the longest costs as much as the longest; few
        of them join longer ones, since each batch costs as much as several contexts.
        """
        answers: list[Array] = [np.empty(0)] * len(contexts)
        of_size: dict[tuple[bool, int], list[int]] = {}
        for i, context in enumerate(contexts):
            unrolled = len(context.ahead_weather) > self._at_once
            of_size.setdefault((unrolled, -(-context.free_C.size // self._patch)), []).append(i)
        batches: list[list[int]] = []
        for _, same in sorted(of_size.items(), reverse=True):
            if batches and min(len(batches[-1]), len(same)) < _FEW:
                batches[-1] += same
            else:
                batches.append(same)
        for batch in batches:
            for first in range(0, len(batch), _AT_ONCE):
                some = batch[first : first + _AT_ONCE]
                for i, values in zip(some, self._predict([contexts[i] for i in some]), strict=True):
                    answers[i] = values
        return answers

    def _predict(self, contexts: Sequence[Context]) -> list[Array]:
        import torch

        steps = [len(context.ahead_weather) for context in contexts]
        with warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = self._pipeline.predict_quantiles(
                torch.from_numpy(padded_series(contexts)), max(steps), LEVELS.round(1).tolist()
            )
        return [np.asarray(value[:n].T.double().numpy()) for value, n in zip(values, steps, strict=True)]
