"""Chronos-Bolt backbone (Ansari et al. 2024): univariate, patch input, nine quantiles."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Context, frozen_pass, padded_series
from thermoforce_mpc.model.free_response.backbones.graph import ByGraph
from thermoforce_mpc.model.free_response.checks import LEVELS

# Largest batch: beyond, the activations leave the cache of a core and the pass becomes slower.
_AT_ONCE = 48
# Contexts of one length below which they join a batch of longer ones.
_FEW = 16


class BoltBackbone(ByGraph):
    """`Backbone` of a `ChronosBoltPipeline`; uses the series only."""

    @cached_property
    def _pipeline(self) -> Any:
        pipeline = self._load()
        # The decoder runs once per call, so its cache is never read but takes 20 % of the time.
        pipeline.model.decoder.config.use_cache = False
        return pipeline

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
        steps = [len(context.ahead_weather) for context in contexts]
        series = padded_series(contexts, self._patch)
        if self._levels is not None and max(steps) <= self._at_once:
            values = self._at_once_of(series[:, -self._longest :])[:, self._levels]
        else:
            values = self._unrolled(series, max(steps))
        return [value[:, :n] for value, n in zip(values.astype(np.float64), steps, strict=True)]

    def _unrolled(self, series: NDArray[np.float32], steps: int) -> NDArray[np.float32]:
        """Quantiles (B, 9, steps) by the library, which unrolls what it does not forecast at once."""
        pipeline = self._pipeline
        import torch

        with frozen_pass(), warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = pipeline.predict_quantiles(torch.from_numpy(series), steps, LEVELS.round(1).tolist())
        return np.asarray(values.transpose(1, 2))

    def _at_once_of(self, series: NDArray[np.float32]) -> NDArray[np.float32]:
        """All trained quantiles (B, quantiles, steps) of series (B, k), k a multiple of the patch."""
        if self.graph is not None:
            return self.graph(context=series)
        import torch

        return np.asarray(self._pipeline.model(context=torch.from_numpy(series)).quantile_preds)
