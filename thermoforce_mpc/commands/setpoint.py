"""Set-point of a room or of the house: thermostat with hysteresis, valve with a P band, or PI controller."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from thermoforce_mpc.commands.command import StepwiseCommand
from thermoforce_mpc.data import Array


class Setpoint(StepwiseCommand):
    """Room set-point, °C. Its loop answers to the difference of set-point and room temperature."""

    of_zone: ClassVar[float | None] = -1.0
    of_outdoor: ClassVar[float | None] = 0.0
    unit: ClassVar[str] = "°C"

    name_in_words: ClassVar[str] = "its set-point"

    kind: Literal["setpoint"]
    minimum: float | None = Field(5.0, ge=5, le=30, description="lowest set-point, °C")
    maximum: float | None = Field(28.0, ge=5, le=30, description="highest set-point, °C")
    beyond_K: float = Field(
        2.0, ge=0, le=10, description="how far commands may lie outside the comfort bounds of the room, K"
    )

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return self.within(lower_C - self.beyond_K, upper_C + self.beyond_K)

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"{value:.10g} °C"
