"""Chronos-2 backbone (Ansari et al. 2025), with weather forecast and hour of the day as known covariates."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import (
    COVARIATES,
    LINEAR_MODEL,
    Context,
    frozen_pass,
    padded_series,
)
from thermoforce_mpc.model.free_response.backbones.graph import ByGraph
from thermoforce_mpc.model.free_response.checks import LEVELS


class Chronos2Backbone(ByGraph):
    """`Backbone` of a `Chronos2Pipeline` with outdoor temperature, irradiance and clock, past and ahead.

    One that was trained on what linear weather models leave over reads their course, too (`after_linear_weather`).
    """

    def __init__(self, *args: Any, after_linear_weather: bool = False) -> None:
        super().__init__(*args)
        self.after_linear_weather = after_linear_weather
        self._names = (*COVARIATES, LINEAR_MODEL) if after_linear_weather else COVARIATES

    def _steps_at_once(self, settings: Mapping[str, Any]) -> int:
        return int(settings["output_patch_size"]) * int(settings["max_output_patches"])

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`; contexts with equal N form one batch."""
        answers: list[Array] = [np.empty(0)] * len(contexts)
        for steps in {len(context.ahead_weather) for context in contexts}:
            same = [i for i, context in enumerate(contexts) if len(context.ahead_weather) == steps]
            by_graph = self.graph is not None and self._levels is not None and steps <= self._at_once
            predict = self._by_graph if by_graph else self._by_library
            for i, values in zip(same, predict([contexts[i] for i in same], steps), strict=True):
                answers[i] = values
        return answers

    def _by_graph(self, contexts: Sequence[Context], steps: int) -> list[Array]:
        assert self.graph is not None
        k = -(-max(context.free_C.size for context in contexts) // self._patch) * self._patch
        rows = 1 + len(self._names)  # of a context: the series, then its covariates
        past = np.full((len(contexts), rows, k), np.nan, dtype=np.float32)
        past[:, 0] = padded_series(contexts, self._patch)
        ahead = np.full((len(contexts), rows, -(-steps // self._patch) * self._patch), np.nan, dtype=np.float32)
        for i, context in enumerate(contexts):
            past[i, 1:, k - context.free_C.size :] = context.past_weather.T[: rows - 1]
            ahead[i, 1:, :steps] = context.ahead_weather.T[: rows - 1]
        values = self.graph(
            context=past.reshape(-1, k)[:, -self._longest :],
            group_ids=np.repeat(np.arange(len(contexts)), rows),
            future_covariates=ahead.reshape(-1, ahead.shape[2]),
        )
        return list(values[::rows][:, self._levels, :steps].astype(np.float64))

    def _by_library(self, contexts: Sequence[Context], steps: int) -> list[Array]:
        tasks = [
            {
                "target": context.free_C.astype(np.float32),
                "past_covariates": self._columns(context.past_weather),
                "future_covariates": self._columns(context.ahead_weather),
            }
            for context in contexts
        ]
        pipeline = self._pipeline
        with frozen_pass(), warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = pipeline.predict_quantiles(
                tasks, prediction_length=steps, quantile_levels=LEVELS.round(1).tolist()
            )
        # One list entry per task, shape (variates, N, levels); the target is the only variate forecast.
        return [np.asarray(value[0].T.double().numpy()) for value in values]

    def _columns(self, weather: Array) -> dict[str, Any]:
        return {name: weather[:, i].astype(np.float32) for i, name in enumerate(self._names)}
