"""Size of a forecaster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import nn


def parameter_count(modules: Sequence[nn.Module]) -> int:
    """Return the number of weights; shared tensors count once."""
    tensors = {p.data_ptr(): p.numel() for module in modules for p in module.parameters()}
    return sum(tensors.values())
