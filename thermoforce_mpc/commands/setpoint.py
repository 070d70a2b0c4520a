"""Set-point of a room or of the house: thermostat with hysteresis, valve with a P band, or PI controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal

from pydantic import Field

from thermoforce_mpc.commands.command import TemperatureCommand, first_of, is_warm
from thermoforce_mpc.data import Array

# A trial moves a set-point across the temperature of its room by so much, K, where that is no farther away.
_CLEARLY_K, _NEAR_K = 0.5, 4.0
_EACH = "each"


class Setpoint(TemperatureCommand):
    """Set-point of a room or, at a machine, of the house. Its loop answers to the difference of set-point and room
    temperature, of a house's thermostat to that of its `reference` room.
    """

    of_zone: ClassVar[float | None] = -1.0
    of_outdoor: ClassVar[float | None] = 0.0
    usual_C: ClassVar[tuple[float, float]] = (5.0, 28.0)
    possible_C: ClassVar[tuple[float, float]] = (5.0, 30.0)
    usual_steps: ClassVar[tuple[float, float]] = (0.5, 1.0)
    name_in_words: ClassVar[str] = "its set-point"
    trial_changes: ClassVar[tuple[float, ...]] = (1.0, -1.0, 2.0, -2.0)

    kind: Literal["setpoint"]
    beyond_K: float = Field(
        2.0, ge=0, le=10, description="how far commands may lie outside the comfort bounds of the room, K"
    )
    reference: str | None = Field(
        None,
        description="room of the thermostat, of a machine that feeds several; each: all rooms have one, set alike",
    )

    def reference_of(self, room: str) -> str:
        """See `Command.reference_of`."""
        return room if self.reference in (None, _EACH) else str(self.reference)

    def check_rooms(self, rooms: Sequence[str], *, of_machine: bool) -> None:
        """See `Command.check_rooms`."""
        if not of_machine and self.reference is not None:
            raise ValueError("reference: of the command of a machine; an actuator's goes by its own room")
        if self.reference is None and len(rooms) > 1:
            raise ValueError(
                f"reference: say in which room the thermostat is, of {', '.join(rooms)}, or {_EACH}: all rooms have "
                "one, set alike"
            )
        if self.reference not in (None, _EACH, *rooms):
            raise ValueError(f"reference: it heats no room '{self.reference}'; it heats {', '.join(rooms)}")

    def check_bounds(self, of: str, lower_C: float, upper_C: float) -> None:
        """See `Command.check_bounds`."""
        self._check_reach(of, lower_C, upper_C)

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return self.within(lower_C - self.beyond_K, upper_C + self.beyond_K)

    def tried(self, before: float, T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> float | None:
        """See `Command.tried`; one that a thermostat must answer to comes first."""
        lower = max((low for low, _ in bounds_C if math.isfinite(low)), default=-math.inf)
        upper = min((high for _, high in bounds_C if math.isfinite(high)), default=math.inf)
        values = [one for one in self._moved(before) if lower - self.beyond_K <= one <= upper + self.beyond_K]
        crossing = self._crossing(before, T_zone_C[0], lower, upper)
        values = values if crossing is None else [crossing, *values]
        return first_of(values, before, is_warm(T_zone_C, bounds_C))

    def _crossing(self, before: float, T_C: float, lower: float, upper: float) -> float | None:
        """The set-point inside the comfort bounds nearest to the room's temperature, of its other side: a thermostat at
        `before` answers to it. None where there is none, or the room is far away.
        """
        if not abs(T_C - before) <= _NEAR_K:
            return None
        rises = before < T_C
        first = T_C + math.copysign(_CLEARLY_K, 1.0 if rises else -1.0)
        value = float(self.nearest(first))
        if (value < first) is rises and value != first:
            value = float(self.nearest(first, 1.0 if rises else -1.0))
        return value if lower <= value <= upper and self.allows(value) and value != before else None
