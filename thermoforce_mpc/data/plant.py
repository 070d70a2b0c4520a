"""What a plant says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from thermoforce_mpc.data.clock import DAY_S


@dataclass(frozen=True)
class Period:
    """A scored window: it starts at `start_s`, lasts `scored_s`, and follows `warmup_s` of native control."""

    name: str
    start_s: float
    scored_s: float = 14 * DAY_S
    warmup_s: float = 7 * DAY_S


@dataclass(frozen=True)
class PlantInfo:
    """Plant kind, test case, weather and version, for manifests and headlines."""

    kind: str
    testcase: str
    description: str
    weather: str
    version: str
    details: Mapping[str, str] = field(default_factory=dict)
