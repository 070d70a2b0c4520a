"""The card of a model: where it comes from and what it has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ModelCard:
    """Where a model comes from and what it has seen; everything here is plain JSON.

    `data` maps the name of each record to its sha256, `ranges` a signal to the (low, high) it was identified on,
    `scores` and `uncertainty` hold numbers by name, `config` the configuration of the identification.
    """

    source: str = "given"
    data: Mapping[str, str] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
