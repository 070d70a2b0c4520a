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
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.series import held, interpolated
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone, ByLength, Context, padded_series
from thermoforce_mpc.model.free_response.backbones.checkpoint import quiet
from thermoforce_mpc.model.free_response.backbones.known import FRACAST
from thermoforce_mpc.model.free_response.checks import LEVELS

# Batch size. Larger batches are slower: with 100 series, memory allocation takes three times as long as the arithmetic.
_FRACAST_AT_ONCE = 8
# Longest horizon of the quantile head of TimesFM 2.5, and the steps of which Toto 2 decodes longer ones, on medians.
_TIMESFM_AT_ONCE, _TOTO_AT_ONCE = 1024, 768


class FracastBackbone:
    """`Backbone` of `fracast` with full-precision weights; uses the series only, unrolls beyond 48 steps."""

    label = "Fracast-0"

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
        _check_levels("fracast", self._model.quantiles)
        self.modules = (self._model.core, self._model.head)

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
    from tirex2 import TimeseriesType, load_model

    forecaster = load_model(folder, device="cpu")
    _check_levels(name, forecaster.model.quantiles.tolist())

    def predict(contexts: Sequence[Context], steps: int) -> Array:
        series = [
            TimeseriesType(
                target=_tensor(context.free_C[None]),
                past_covariates=None,
                future_covariates=_tensor(_weather_rows(context)),
            )
            for context in contexts
        ]
        return np.concatenate(forecaster.forecast(series, prediction_length=steps, output_type="numpy"))

    at_once = int(forecaster.model.future_len)
    return ByLength(f"TiRex-2 '{name}' with weather", (forecaster.model,), at_once, predict)


def load_timesfm(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 2.5 from the folder of its safetensors; gaps are bridged by the library."""
    import torch
    from timesfm import ForecastConfig, TimesFM_2p5_200M_torch

    model = TimesFM_2p5_200M_torch(torch_compile=False)
    model.model.device, model.model.device_count = torch.device("cpu"), 1
    model.load_checkpoint(str(folder))

    def predict(contexts: Sequence[Context], steps: int) -> Array:
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
        model.compile(settings)
        _, values = model.forecast(steps, [context.free_C.astype(np.float32) for context in contexts])
        return np.asarray(values[..., 1:].transpose(0, 2, 1))  # the first is the mean

    return ByLength(f"TimesFM 2.5 '{name}'", (model.model,), _TIMESFM_AT_ONCE, predict)


def load_timesfm3(name: str, folder: Path) -> Backbone:
    """Load a TimesFM 3 from a folder with its config.json and safetensors."""
    from timesfm3 import TimesFM3Forecaster

    with quiet():
        forecaster = TimesFM3Forecaster.from_pretrained(str(folder), device="cpu", local_files_only=True)

    def predict(contexts: Sequence[Context], steps: int) -> Array:
        answers = forecaster.predict_batch(
            [context.free_C.astype(np.float32) for context in contexts],
            steps,
            past_future_covariates=[_weather_rows(context).astype(np.float32) for context in contexts],
            return_quantiles=True,
        )
        return np.stack([answer.quantiles.T for answer in answers])

    label = f"TimesFM 3 '{name}' with weather, non-commercial"
    return ByLength(label, (forecaster.model,), _TIMESFM_AT_ONCE, predict)


def load_toto2(name: str, folder: Path) -> Backbone:
    """Load a Toto 2 from a folder with its config.json and safetensors."""
    import torch
    from toto2 import Toto2Model

    model = Toto2Model.from_pretrained(str(folder), map_location="cpu")

    def predict(contexts: Sequence[Context], steps: int) -> Array:
        # One variate of whole patches. The mask of the last patch is ignored, so its gaps hold the value before.
        series = padded_series(contexts, int(model.config.patch_size))
        known = torch.from_numpy(np.isfinite(series))[:, None]
        inputs = {
            "target": torch.from_numpy(np.stack([held(row) for row in series]))[:, None],
            "target_mask": known,
            "series_ids": torch.zeros(len(contexts), 1, dtype=torch.long),
        }
        values = model.forecast(inputs, steps, has_missing_values=not bool(known.all()))
        return np.asarray(values[:, :, 0].transpose(0, 1).numpy())

    return ByLength(f"Toto 2 '{name}'", (model,), _TOTO_AT_ONCE, predict)


def load_ttm(name: str, folder: Path) -> Backbone:
    """Load a Tiny Time Mixer that forecasts quantiles (release 3) from a folder; raises `BackboneError` for others.

    It reads a fixed length, filled up with the first value, masked.
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
    longest = int(model.config.context_length)

    def predict(contexts: Sequence[Context], steps: int) -> Array:
        series = np.full((len(contexts), longest), np.nan)
        for row, context in zip(series, contexts, strict=True):
            recent = context.free_C[-longest:]
            row[longest - recent.size :] = recent
        known = _tensor(np.isfinite(series), bool)[:, :, None]
        filled = _tensor(np.stack([interpolated(row) for row in series]))[:, :, None]
        answer = model(past_values=filled, past_observed_mask=known, return_loss=False, return_dict=True)
        return np.asarray(answer.quantile_outputs[:, :, :steps, 0].numpy())

    return ByLength(f"TTM '{name}'", (model,), int(model.config.prediction_length), predict)


def load_flowstate(name: str, folder: Path) -> Backbone:
    """Load a FlowState, at the scale of hourly values, from a folder; raises `BackboneError` for other quantiles."""
    from tsfm_public.models.flowstate import FlowStateForPrediction

    with quiet():
        model = FlowStateForPrediction.from_pretrained(folder, local_files_only=True, use_safetensors=True)
    _check_levels(name, model.config.quantiles)

    def predict(contexts: Sequence[Context], steps: int) -> Array:
        rows = [context.free_C if model.config.with_missing else interpolated(context.free_C) for context in contexts]
        series = _tensor(np.stack(rows))[:, :, None]
        answer = model(past_values=series, prediction_length=steps, batch_first=True, return_dict=True)
        return np.asarray(answer.quantile_outputs[:, :, :steps, 0].numpy())

    # Longer horizons than a patch of the decoder are forecast at once, with that much less of the context.
    return ByLength(f"FlowState '{name}'", (model,), int(model.config.context_length) // 2, predict)


def _check_levels(name: str, levels: Sequence[float]) -> None:
    if not (len(levels) == LEVELS.size and np.allclose(levels, LEVELS)):
        raise BackboneError(f"backbone '{name}': its quantiles are {levels}, expected 0.1 ... 0.9")


def _tensor(values: Any, dtype: Any = np.float32) -> Any:
    import torch

    return torch.from_numpy(np.ascontiguousarray(values, dtype=dtype))


def _weather_rows(context: Context) -> Array:
    """Past and forecast weather, a row each."""
    return np.concatenate([context.past_weather, context.ahead_weather]).T
