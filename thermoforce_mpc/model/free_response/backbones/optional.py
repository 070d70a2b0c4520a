"""Backbones whose packages are extras.

Fracast-0 has 85 001 pretrained parameters in the wheel of `fracast` (Apache-2.0). The others read a folder of weights:
TiRex-2 (Podest et al. 2026; `tirex-2`) and TimesFM 3 with the weather forecast as known covariates; TimesFM 2.5 (Das et
al. 2024; `timesfm`), Toto 2 (Khwaja et al. 2026; `toto-2`, Python 3.12 and newer), Tiny Time Mixers (Ekambaram et al.
2024) and FlowState (Graf et al. 2025; both `granite-tsfm`) with the series only. Weights of TimesFM 3 are for
non-commercial use.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context, bridged, padded_series
from thermoforce_mpc.model.free_response.backbones.checkpoint import quiet
from thermoforce_mpc.model.free_response.backbones.known import FRACAST
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import Tensor, nn

# Batch size. Larger batches are slower: with 100 series, memory allocation takes three times as long as the arithmetic.
_FRACAST_AT_ONCE = 8


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
        for first in range(0, len(contexts), _FRACAST_AT_ONCE):
            some = contexts[first : first + _FRACAST_AT_ONCE]
            steps = [len(context.ahead_weather) for context in some]
            values = self._model.forecast_batch(padded_series(some), horizon=max(steps))
            quantiles += [np.asarray(value[:n].T, dtype=np.float64) for value, n in zip(values, steps, strict=True)]
        return quantiles


def load_tirex2(name: str, folder: Path) -> Backbone:
    """Load a TiRex-2 from a folder with its config.json and safetensors; raises `BackboneError` for other quantiles."""
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


# Longest horizon of the quantile head of 2.5.
_TIMESFM_AT_ONCE = 1024


def load_timesfm(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 2.5 from the folder of its safetensors."""
    import torch
    from timesfm import TimesFM_2p5_200M_torch

    model = TimesFM_2p5_200M_torch(torch_compile=False)
    model.model.device, model.model.device_count = torch.device("cpu"), 1
    model.load_checkpoint(str(folder))
    return TimesFM25Backbone(model, f"TimesFM 2.5 '{name}'")


def load_timesfm3(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 3 from a folder with its config.json and safetensors."""
    from timesfm3 import TimesFM3Forecaster

    with quiet():
        forecaster = TimesFM3Forecaster.from_pretrained(str(folder), device="cpu", local_files_only=True)
    return TimesFM3Backbone(forecaster, f"TimesFM 3 '{name}' with weather, non-commercial")


class TimesFM25Backbone(ByLength):
    """`Backbone` of a `TimesFM_2p5_200M_torch`; uses the series only, gaps bridged by the library."""

    def __init__(self, model: Any, label: str) -> None:
        super().__init__(label, (model.model,), _TIMESFM_AT_ONCE)
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
        super().__init__(label, (forecaster.model,), _TIMESFM_AT_ONCE)
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


# The package decodes longer horizons in blocks of this many steps, on medians.
_TOTO_AT_ONCE = 768


def load_toto2(name: str, folder: Path) -> Backbone:
    """Load a Toto 2 from a folder with its config.json and safetensors."""
    from toto2 import Toto2Model

    return Toto2Backbone(Toto2Model.from_pretrained(str(folder), map_location="cpu"), f"Toto 2 '{name}'")


class Toto2Backbone(ByLength):
    """`Backbone` of a `Toto2Model`; uses the series only."""

    def __init__(self, model: Any, label: str) -> None:
        super().__init__(label, (model,), _TOTO_AT_ONCE)
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


def load_ttm(name: str, folder: Path) -> Backbone:
    """Load a Tiny Time Mixer that forecasts quantiles (release 3) from a folder; raises `BackboneError` for others."""
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
    """Load a FlowState from a folder; raises `BackboneError` where it forecasts other quantiles."""
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
