"""Interface of the frozen backbones."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Context:
    """Input of a backbone: the control-free series, past and forecast weather. It never contains the control.

    `free_C` (k,) °C with NaN gaps, the last value is now; `past_weather` (k, 2) at the same instants and
    `ahead_weather` (N, 2) at the ends of the N steps ahead: outdoor temperature °C and irradiance W/m².
    """

    free_C: Array
    past_weather: Array
    ahead_weather: Array


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

        Contexts may differ in length and in N; a batch (several buildings, several past instants) costs little more
        than one context.
        """
        ...


def padded_series(contexts: Sequence[Context], multiple: int = 1) -> NDArray[np.float32]:
    """Return the series of all contexts in one array (contexts, k), padded on the left with NaN.

    k is the least multiple of `multiple` that holds the longest.
    """
    longest = -(-max(context.free_C.size for context in contexts) // multiple) * multiple
    series = np.full((len(contexts), longest), np.nan, dtype=np.float32)
    for row, context in zip(series, contexts, strict=True):
        row[longest - context.free_C.size :] = context.free_C
    return series


@contextmanager
def frozen_pass() -> Iterator[None]:
    """One thread of torch and no gradients, where torch is loaded.

    Results are bitwise reproducible, and models this small gain nothing by more threads.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)
