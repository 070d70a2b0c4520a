"""Toto 2 backbone (Khwaja et al. 2026); package `toto-2`, for Python 3.12 and newer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context, padded_series

# The package decodes longer horizons in blocks of this many steps, on medians.
_AT_ONCE = 768


def load(name: str, folder: Path) -> Backbone:
    """Load a Toto 2 from a folder with its config.json and safetensors."""
    from toto2 import Toto2Model

    return Toto2Backbone(Toto2Model.from_pretrained(str(folder), map_location="cpu"), f"Toto 2 '{name}'")


class Toto2Backbone(ByLength):
    """`Backbone` of a `Toto2Model`; uses the series only."""

    def __init__(self, model: Any, label: str) -> None:
        super().__init__(label, (model,), _AT_ONCE)
        self._model = model

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        import torch

        # One variate of whole patches. The mask of the last patch is ignored, so its gaps hold the value before.
        series = torch.from_numpy(padded_series(contexts, int(self._model.config.patch_size)))[:, None]
        known = torch.isfinite(series)
        inputs = {
            "target": torch.from_numpy(np.stack([_held(row) for row in series[:, 0].numpy()]))[:, None],
            "target_mask": known,
            "series_ids": torch.zeros(len(contexts), 1, dtype=torch.long),
        }
        values = self._model.forecast(inputs, steps, has_missing_values=not bool(known.all()))
        return np.asarray(values[:, :, 0].transpose(0, 1).numpy())


def _held(series: Array) -> Array:
    """A series with the last known value in its gaps, and the first one before it."""
    known = np.isfinite(series)
    at = np.maximum.accumulate(np.where(known, np.arange(series.size), -1))
    return series[np.where(at < 0, int(np.argmax(known)), at)]
