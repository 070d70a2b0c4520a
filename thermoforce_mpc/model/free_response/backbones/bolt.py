"""Chronos-Bolt backbone (Ansari et al. 2024): univariate, patch input, nine quantiles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Context, padded_series
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import Tensor, nn

# Largest batch: beyond, the activations leave the cache of a core and the pass becomes slower.
_AT_ONCE = 48
# Contexts of one length below which they join a batch of longer ones.
_FEW = 16


class BoltBackbone:
    """`Backbone` of a `ChronosBoltPipeline`; uses the series only.

    Args:
        pipeline: the library's pipeline, frozen.
        label: name for reports.
        traced_after: passes of the library's code before it is traced, which takes as long as about 100 of them.
    """

    def __init__(self, pipeline: Any, label: str, *, traced_after: int = 50) -> None:
        self._pipeline, self._label, self._traced_after = pipeline, label, traced_after
        settings = pipeline.model.chronos_config
        self._patch, self._at_once = int(settings.input_patch_size), int(settings.prediction_length)
        self._longest = int(settings.context_length)
        quantiles = [round(float(level), 6) for level in pipeline.quantiles]
        levels = LEVELS.round(1).tolist()
        self._levels = [quantiles.index(level) for level in levels] if set(levels) <= set(quantiles) else None
        self._pass: Callable[[Tensor], Tensor] = self._by_library
        self._passes = 0
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
        series = torch.from_numpy(padded_series(contexts, self._patch))
        if self._levels is not None and max(steps) <= self._at_once:
            values = self._at_once_of(series[:, -self._longest :])[:, self._levels]
        else:
            values = self._unrolled(series, max(steps)).transpose(1, 2)
        return [value[:, :n] for value, n in zip(values.double().numpy(), steps, strict=True)]

    def _unrolled(self, series: Tensor, steps: int) -> Tensor:
        """Quantiles (B, steps, 9) by the library, which unrolls what it does not forecast at once."""
        with warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = self._pipeline.predict_quantiles(series, steps, LEVELS.round(1).tolist())
        return cast("Tensor", values)

    def _at_once_of(self, series: Tensor) -> Tensor:
        """All trained quantiles (B, quantiles, steps) of series (B, k), k a multiple of the patch.

        The library's Python takes as long as the arithmetic of one building, so the model is traced once it is used
        often: the same operations in the same order, and the same bits.
        """
        self._passes += 1
        if self._passes == self._traced_after and self._longest % self._patch == 0:
            self._pass = _traced(self._by_library, self._longest)
        return self._pass(series)

    def _by_library(self, series: Tensor) -> Tensor:
        return cast("Tensor", self._pipeline.model(context=series).quantile_preds)


def _traced(model: Callable[[Tensor], Tensor], longest: int) -> Callable[[Tensor], Tensor]:
    """The operations of a model, recorded from one call; they hold for any number and length of series."""
    import torch

    with warnings.catch_warnings(), torch.inference_mode():
        # Of tracing, deprecated in favour of compilers that need a C++ compiler on the machine, and of branches on
        # shapes, which all series given here take alike.
        warnings.simplefilter("ignore")
        return cast("Callable[[Tensor], Tensor]", torch.jit.trace(model, torch.zeros(2, longest), check_trace=False))
