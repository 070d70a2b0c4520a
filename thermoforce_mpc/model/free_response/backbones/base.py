"""Interface of the frozen backbones."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, Array

if TYPE_CHECKING:
    from torch import nn


COVARIATES = ("outdoor_temperature", "irradiance", "clock")
"""Names of the covariates that are known of every instant."""

LINEAR_MODEL = "linear_model"
"""Name of the covariate that is a linear weather model's course."""


@dataclass(frozen=True)
class Context:
    """Input of a backbone: the control-free series, past and forecast weather. It never contains the control.

    `free_C` (k,) °C with NaN gaps, the last value is now; `past_weather` (k, 3) at the same instants and
    `ahead_weather` (N, 3) at the ends of the N steps ahead: outdoor temperature °C, irradiance W/m², and `clock`. Where
    the series is what a linear weather model leaves over, a fourth column is that model's course, °C.
    """

    free_C: Array
    past_weather: Array
    ahead_weather: Array


def clock(time_s: Array) -> Array:
    """Hour of the day as a covariate: a wave of a day with its maximum at 15 h, same shape as `time_s`."""
    return np.asarray(np.cos(2.0 * np.pi * (time_s / DAY_S - 15.0 / 24.0)))


class Backbone(Protocol):
    """Frozen model that maps a context to forecast quantiles."""

    @property
    def label(self) -> str:
        """Name for reports."""
        ...

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights, in a fixed order; none where a `Graph` holds them, as the attribute `graph`."""
        ...

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """Return quantiles 0.1, 0.2, ... 0.9 over the N steps ahead of each context, shape (9, N), °C.

        Contexts may differ in length and in N; a batch costs little more than one context.
        """
        ...


def padded_series(contexts: Sequence[Context], multiple: int = 1) -> NDArray[np.float32]:
    """The series of all contexts, padded on the left with NaN to a multiple of `multiple`, (contexts, k)."""
    longest = -(-max(context.free_C.size for context in contexts) // multiple) * multiple
    series = np.full((len(contexts), longest), np.nan, dtype=np.float32)
    for row, context in zip(series, contexts, strict=True):
        row[longest - context.free_C.size :] = context.free_C
    return series


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch, which makes results bitwise reproducible, where torch is loaded."""
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def frozen_pass() -> Iterator[None]:
    """As `one_thread`, and no gradients."""
    torch = sys.modules.get("torch")
    with one_thread(), nullcontext() if torch is None else torch.inference_mode():
        yield


class ByLength:
    """`Backbone` of a library's model: contexts of one length and number of steps ahead form a batch.

    `at_once`: largest number of steps that the model forecasts; longer horizons are unrolled on its medians. `predict`:
    quantiles 0.1 to 0.9 of contexts of one length, (contexts, 9, steps), °C.
    """

    def __init__(
        self,
        label: str,
        modules: tuple[nn.Module, ...],
        at_once: int,
        predict: Callable[[Sequence[Context], int], Array],
    ) -> None:
        self.label, self.modules, self._at_once, self._predict = label, modules, at_once, predict

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`."""
        answers: list[Array] = [np.empty(0)] * len(contexts)
        of_size: dict[tuple[int, int], list[int]] = {}
        for i, context in enumerate(contexts):
            of_size.setdefault((context.free_C.size, len(context.ahead_weather)), []).append(i)
        for (_, steps), same in of_size.items():
            for i, values in zip(same, self._unrolled([contexts[i] for i in same], steps), strict=True):
                answers[i] = values
        return answers

    def _unrolled(self, contexts: Sequence[Context], steps: int) -> Array:
        done = min(steps, self._at_once)
        first = self._predict([replace(c, ahead_weather=c.ahead_weather[:done]) for c in contexts], done)
        if done == steps:
            return np.asarray(first, dtype=np.float64)
        onwards = [
            Context(
                np.concatenate([context.free_C, values[4]]),
                np.concatenate([context.past_weather, context.ahead_weather[:done]]),
                context.ahead_weather[done:],
            )
            for context, values in zip(contexts, first, strict=True)
        ]
        return np.concatenate([first, self._unrolled(onwards, steps - done)], axis=2, dtype=np.float64)
