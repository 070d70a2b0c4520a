"""Set-point of a room or of the house: thermostat with hysteresis, valve with a P band, or PI controller."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from thermoforce_mpc.commands.command import TemperatureCommand
from thermoforce_mpc.data import Array


class Setpoint(TemperatureCommand):
    """Room set-point. Its loop answers to the difference of set-point and room temperature."""

    of_zone: ClassVar[float | None] = -1.0
    of_outdoor: ClassVar[float | None] = 0.0
    usual_C: ClassVar[tuple[float, float]] = (5.0, 28.0)
    possible_C: ClassVar[tuple[float, float]] = (5.0, 30.0)
    usual_steps: ClassVar[tuple[float, float]] = (0.5, 1.0)
    name_in_words: ClassVar[str] = "its set-point"

    kind: Literal["setpoint"]
    beyond_K: float = Field(
        2.0, ge=0, le=10, description="how far commands may lie outside the comfort bounds of the room, K"
    )

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return self.within(lower_C - self.beyond_K, upper_C + self.beyond_K)
