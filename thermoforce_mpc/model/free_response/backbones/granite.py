"""Tiny Time Mixers (Ekambaram et al. 2024) and FlowState (Graf et al. 2025); package `granite-tsfm`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context, bridged
from thermoforce_mpc.model.free_response.backbones.checkpoint import quiet
from thermoforce_mpc.model.free_response.checks import LEVELS


def load_ttm(name: str, folder: Path) -> Backbone:
    """Load a Tiny Time Mixer that forecasts quantiles (release 3) from a folder.

    Raises:
        BackboneError: it forecasts one value, or other quantiles.
    """
    from tsfm_public.models import tinytimemixer

    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    if not config.get("multi_quantile_head"):
        raise BackboneError(f"backbone '{name}': this TTM forecasts no quantiles; releases from 3 do")
    (architecture,) = config["architectures"]
    with quiet():
        model = getattr(tinytimemixer, architecture).from_pretrained(
            folder, local_files_only=True, use_safetensors=True
        )
    _check_levels(name, model.config.quantile_levels)
    return TtmBackbone(model, f"TTM '{name}'")


def load_flowstate(name: str, folder: Path) -> Backbone:
    """Load a FlowState from a folder.

    Raises:
        BackboneError: it forecasts other quantiles.
    """
    from tsfm_public.models.flowstate import FlowStateForPrediction

    with quiet():
        model = FlowStateForPrediction.from_pretrained(folder, local_files_only=True, use_safetensors=True)
    _check_levels(name, model.config.quantiles)
    return FlowStateBackbone(model, f"FlowState '{name}'")


class TtmBackbone(ByLength):
    """`Backbone` of a TTM; uses the series only. It reads a fixed length, filled up with the first value, masked."""

    def __init__(self, model: Any, label: str) -> None:
        super().__init__(label, (model,), int(model.config.prediction_length))
        self._model = model

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        import torch

        longest = int(self._model.config.context_length)
        series = np.full((len(contexts), longest), np.nan)
        for row, context in zip(series, contexts, strict=True):
            recent = context.free_C[-longest:]
            row[longest - recent.size :] = recent
        known = torch.from_numpy(np.isfinite(series))[:, :, None]
        filled = torch.from_numpy(np.stack([bridged(row) for row in series]).astype(np.float32))[:, :, None]
        answer = self._model(past_values=filled, past_observed_mask=known, return_loss=False, return_dict=True)
        return np.asarray(answer.quantile_outputs[:, :, :steps, 0].numpy())


class FlowStateBackbone(ByLength):
    """`Backbone` of a FlowState; uses the series only, at the scale of hourly values."""

    def __init__(self, model: Any, label: str) -> None:
        # Longer horizons than a patch of the decoder are forecast at once, with that much less of the context.
        super().__init__(label, (model,), int(model.config.context_length) // 2)
        self._model = model

    def _predict(self, contexts: Sequence[Context], steps: int) -> Array:
        import torch

        rows = [context.free_C if self._model.config.with_missing else bridged(context.free_C) for context in contexts]
        series = torch.from_numpy(np.stack(rows).astype(np.float32))[:, :, None]
        answer = self._model(past_values=series, prediction_length=steps, batch_first=True, return_dict=True)
        return np.asarray(answer.quantile_outputs[:, :, :steps, 0].numpy())


def _check_levels(name: str, levels: Sequence[float]) -> None:
    if not (len(levels) == LEVELS.size and np.allclose(levels, LEVELS)):
        raise BackboneError(f"backbone '{name}': its quantiles are {levels}, expected 0.1 ... 0.9")
