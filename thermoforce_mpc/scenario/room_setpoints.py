"""Actuator of a zone whose own loops keep two room set-points, one for heating and one for cooling.

The level u in [−cooling_W / heating_W, 1] is heat delivered to the room over `heating_W`, negative for cooling. It is
measured, not commanded: a plan expects a level, and the plant's own loop finds it by keeping the set-points.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from pydantic import Field, model_validator

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.scenario.strict_model import PointName, StrictModel, check_kelvin


class RoomSetpoints(StrictModel):
    """Room set-points for heating and cooling as an actuator."""

    kind: Literal["room_setpoints"]
    heating: PointName = Field(description="overwrite point of the heating set-point, without the `_u` ending")
    cooling: PointName = Field(description="overwrite point of the cooling set-point, without the `_u` ending")
    minimum: float = Field(description="lowest set-point, in `unit`")
    maximum: float = Field(description="highest set-point, in `unit`")
    unit: Literal["K"] = Field("K", description="unit of the set-points at the plant's interface")
    heating_W: float = Field(gt=0, description="largest heat to the room, W: u = 1")
    cooling_W: float = Field(gt=0, description="largest heat from the room, W: the lowest u, times −heating_W")
    heating_held: dict[PointName, float] = Field(
        default_factory=dict, description="other overwrite points held at a value while heating is planned"
    )
    cooling_held: dict[PointName, float] = Field(
        default_factory=dict, description="other overwrite points held at a value while cooling is planned"
    )

    @model_validator(mode="after")
    def _ordered(self) -> RoomSetpoints:
        if not self.minimum < self.maximum:
            raise ValueError(f"minimum ({self.minimum}) must be below maximum ({self.maximum})")
        check_kelvin(minimum=self.minimum, maximum=self.maximum)
        if self.heating == self.cooling:
            raise ValueError(f"heating and cooling are the same point '{self.heating}'")
        return self

    @property
    def lowest(self) -> float:
        """Lowest level: full cooling."""
        return -self.cooling_W / self.heating_W

    def beside_the_level(self, maximum: float | None) -> Iterator[tuple[str, object, object]]:
        """Yield what a plant that takes u itself cannot do, see `Actuator.beside_the_level`: all of it."""
        yield "kind", self.kind, "level"

    @property
    def sensed(self) -> tuple[str, ...]:
        """Points whose applied values give the level: none, the level is measured heat."""
        return ()

    @property
    def points(self) -> tuple[str, ...]:
        """All overwrite points."""
        return tuple(dict.fromkeys((self.heating, self.cooling, *self.heating_held, *self.cooling_held)))

    def inputs(self, u: float | None, band_C: tuple[float, float] | None) -> dict[str, float]:
        """Return the plant inputs for the set-points `band_C` (heating, cooling), °C, or None for native control.

        `u` tells the direction that is planned: its `held` points are set, those of the other direction left native,
        and the set-point of the other direction is moved out of the way, so that one loop at a time acts. Without
        `band_C` a full level drives its loop to its limit, and 0 turns both off.

        All points are set explicitly, since a point that is not set keeps its last value.
        """
        released = {f"{name}_activate": 0.0 for name in self.points}
        if u is None:
            return released
        heat, cool = (value + ZERO_C_K for value in band_C) if band_C else self._driven(u)
        if u > 0:
            cool = self.maximum
        elif u < 0:
            heat = self.minimum
        values = {self.heating: heat, self.cooling: cool}
        values = {name: min(max(value, self.minimum), self.maximum) for name, value in values.items()}
        values |= self.heating_held if u > 0 else self.cooling_held if u < 0 else {}
        return (
            released
            | {f"{name}_u": value for name, value in values.items()}
            | {f"{name}_activate": 1.0 for name in values}
        )

    def _driven(self, u: float) -> tuple[float, float]:
        """Set-points that drive one loop to its limit, in `unit`: beyond what the zone reaches."""
        heat = self.maximum if u > 0 and math.isfinite(u) else self.minimum
        return heat, self.minimum if u < 0 else self.maximum
