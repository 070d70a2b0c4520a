"""The heating curve: an offset of it in K, or the flow temperature itself."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from thermoforce_mpc.commands.command import StepwiseCommand, TemperatureCommand
from thermoforce_mpc.data import Array


class CurveOffset(StepwiseCommand):
    """Offset of the heating curve, in K or in the steps of the device."""

    name_in_words: ClassVar[str] = "the offset of the heating curve"
    of_flow: ClassVar[bool] = True

    kind: Literal["curve_offset"]
    resolution: float = Field(1.0, gt=0, description="step between two offsets")
    minimum: float | None = Field(-3.0, description="lowest offset")
    maximum: float | None = Field(3.0, description="highest offset")

    @property
    def told_in(self) -> str:
        """See `Command.told_in`."""
        return "K"

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return self.within(np.full(lower_C.shape, -np.inf), np.full(upper_C.shape, np.inf))

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"{value:+.10g} K" if value else "0 K"


class FlowTemperature(TemperatureCommand):
    """Flow temperature, within `beyond_K` of what it usually is at that time."""

    usual_C: ClassVar[tuple[float, float]] = (20.0, 45.0)
    possible_C: ClassVar[tuple[float, float]] = (5.0, 90.0)
    name_in_words: ClassVar[str] = "the flow temperature"
    of_flow: ClassVar[bool] = True
    follows_weather: ClassVar[bool] = True
    trial_changes: ClassVar[tuple[float, ...]] = (2.0, -2.0)

    kind: Literal["flow_temperature"]
    beyond_K: float = Field(5.0, ge=0, le=30, description="largest difference from what it usually is, K")

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return self.within(usual - self.beyond_K, usual + self.beyond_K)

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"{super().in_words(value)} flow"
