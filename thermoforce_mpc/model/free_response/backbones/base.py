"""What every frozen backbone can do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Context:
    """What a backbone may see: the control-free series, and the weather before and after now. Never the control.

    `free_C` (k,) °C with NaN gaps, the last value being now; `past_weather` (k, 2) at the same instants and
    `ahead_weather` (N, 2) at the ends of the N steps ahead: outdoor temperature °C and irradiance W/m².
    """

    free_C: Array
    past_weather: Array
    ahead_weather: Array


class Backbone(Protocol):
    """A frozen model that turns a context into quantiles."""

    @property
    def label(self) -> str:
        """What it is, for reports."""
        ...

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """All that has weights, in a fixed order."""
        ...

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """Quantiles 0.1, 0.2, ... 0.9 over the N steps ahead of each context, shape (9, N), °C.

        Contexts may differ in length and in N; many at once (several buildings, several past instants) cost little more
        than one.
        """
        ...


def padded_series(contexts: Sequence[Context]) -> NDArray[np.float32]:
    """The series of all contexts in one array (contexts, longest), NaN on the left of shorter ones: not there."""
    longest = max(context.free_C.size for context in contexts)
    series = np.full((len(contexts), longest), np.nan, dtype=np.float32)
    for row, context in zip(series, contexts, strict=True):
        row[longest - context.free_C.size :] = context.free_C
    return series
