"""Options of a zone sensor, its state from step to step, and its zone now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from pydantic import Field, model_validator

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.limits import RULES
from thermoforce_mpc.scenario.settings import StrictModel

_RULE = RULES["T_zone_C"]


class SensorConfig(StrictModel):
    """Which readings of a zone sensor are believed."""

    enabled: bool = Field(True, description="judge the readings of zone sensors by the model")
    lowest_C: float = Field(_RULE.range[0], description="readings below are not believed, °C")
    highest_C: float = Field(_RULE.range[1], description="readings above are not believed, °C")
    # Distance from the prediction within which a reading is always believed, K; more where the record changes by more
    # than half of it within a step.
    jump_K: ClassVar[float] = _RULE.expected
    frozen_h: float = Field(
        _RULE.frozen_h,
        gt=0,
        description="shortest time after which a reading that repeats itself may be a stuck sensor, h",
    )
    # Time for which the model stands in for readings that are not believed, h.
    bridge_h: ClassVar[float] = 6.0
    # Time after which steady readings are believed again, wherever they are, h.
    return_h: ClassVar[float] = 24.0

    @model_validator(mode="after")
    def _in_order(self) -> SensorConfig:
        if not self.lowest_C < self.highest_C:
            raise ValueError(f"lowest_C of {self.lowest_C:g} °C is not below highest_C of {self.highest_C:g} °C")
        return self


@dataclass(frozen=True)
class Anchor:
    """Free forecast from the last reading that was accepted and new: `free_C`, half-width of its band `half_K` (N,)."""

    time_s: float
    free_C: Array
    half_K: Array

    def at(self, time_s: float, step_s: float) -> tuple[float, float]:
        """Forecast and half-width for an instant, °C and K; NaN beyond the forecast."""
        lead = round((time_s - self.time_s) / step_s)
        if not 1 <= lead <= self.free_C.size:
            return math.nan, math.nan
        return float(self.free_C[lead - 1]), float(self.half_K[lead - 1])


@dataclass(frozen=True)
class SensorState:
    """State of one zone's sensor.

    `refused_s`: instants of readings that were rejected. `anchor`: what predicts the next ones. `seen_s`: the last
    instant validated. `distrust`: why readings are rejected at present, by kind; empty while they are not. `since`:
    readings since then: time s, °C, and their distance from the prediction, K.
    """

    refused_s: tuple[float, ...] = ()
    anchor: Anchor | None = None
    seen_s: float = -math.inf
    distrust: str = ""
    kind: str = ""
    since: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class Sensed:
    """A zone now: `T_C` is its reading, or the model's temperature where the reading is rejected (NaN: unknown).

    `why`: why it is not, and since when; empty where it is. `lost`: the model stands in for it no longer. `news`:
    that readings are accepted again.
    """

    T_C: float
    why: str = ""
    lost: bool = False
    news: str = ""
