"""Chronos-2 backbone (Ansari et al. 2025), with the weather forecast as known covariates."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.backbones.base import Context
from thermoforce_mpc.model.free_response.checks import LEVELS

if TYPE_CHECKING:
    from torch import nn

_COVARIATES = ("outdoor_temperature", "irradiance")


class Chronos2Backbone:
    """`Backbone` of a `Chronos2Pipeline` with past and forecast outdoor temperature and irradiance."""

    def __init__(self, pipeline: Any, label: str) -> None:
        self._pipeline = pipeline
        self._label = label

    @property
    def label(self) -> str:
        """Name for reports."""
        return self._label

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights."""
        return (self._pipeline.model,)

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`; contexts with equal N form one batch."""
        answers: list[Array] = [np.empty(0)] * len(contexts)
        for steps in {len(context.ahead_weather) for context in contexts}:
            same = [i for i, context in enumerate(contexts) if len(context.ahead_weather) == steps]
            for i, values in zip(same, self._predict([contexts[i] for i in same], steps), strict=True):
                answers[i] = values
        return answers

    def _predict(self, contexts: Sequence[Context], steps: int) -> list[Array]:
        tasks = [
            {
                "target": context.free_C.astype(np.float32),
                "past_covariates": _columns(context.past_weather),
                "future_covariates": _columns(context.ahead_weather),
            }
            for context in contexts
        ]
        with warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = self._pipeline.predict_quantiles(
                tasks, prediction_length=steps, quantile_levels=LEVELS.round(1).tolist()
            )
        # One list entry per task, shape (variates, N, levels); the target is the only variate forecast.
        return [np.asarray(value[0].T.double().numpy()) for value in values]


def _columns(weather: Array) -> dict[str, Any]:
    return {name: weather[:, i].astype(np.float32) for i, name in enumerate(_COVARIATES)}
