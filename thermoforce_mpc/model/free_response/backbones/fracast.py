"""Fracast-0 backbone: 85 001 pretrained parameters in the wheel of the optional package `fracast` (Apache-2.0)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Context, padded_series
from thermoforce_mpc.model.free_response.backbones.known import FRACAST
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import nn

# Batch size. Larger batches are slower: with 100 series, memory allocation takes three times as long as the arithmetic.
_AT_ONCE = 8


class FracastBackbone:
    """`Backbone` of `fracast` with full-precision weights; uses the series only, unrolls beyond 48 steps."""

    def __init__(self) -> None:
        """Load the weights of the wheel; raises `BackboneError` when the package is absent or damaged."""
        FRACAST.check()
        try:
            from fracast import FracastModel

            self._model = FracastModel.from_pretrained(weights="fp32")
        except Exception as error:  # its JSON and safetensors readers raise several types
            raise BackboneError(
                f"backbone 'fracast': its weights cannot be loaded: {type(error).__name__}: {error}; reinstall it"
            ) from error
        if not np.allclose(self._model.quantiles, LEVELS):
            raise BackboneError(f"backbone 'fracast': its quantiles are {self._model.quantiles}, expected 0.1 ... 0.9")

    @property
    def label(self) -> str:
        """Name for reports."""
        return "Fracast-0"

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights."""
        return (self._model.core, self._model.head)

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`."""
        quantiles: list[Array] = []
        for first in range(0, len(contexts), _AT_ONCE):
            some = contexts[first : first + _AT_ONCE]
            steps = [len(context.ahead_weather) for context in some]
            values = self._model.forecast_batch(padded_series(some), horizon=max(steps))
            quantiles += [np.asarray(value[:n].T, dtype=np.float64) for value, n in zip(values, steps, strict=True)]
        return quantiles
