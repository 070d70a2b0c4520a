"""Actuators of a zone: the level u at the plant's interface, and back.

A level is what heat is linear in. The heat of a radiator or an air heater depends on the room: a map takes that physics
out at the plant's edge, so that everything behind it (operator, power law, quadratic programme) sees a level that heat
is proportional to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.scenario.settings import PointName, StrictModel, check_range

# Least difference of supply air and room as a share of that at reference: nearer, the air neither heats nor cools.
_LEAST_SHARE = 0.05


class Actuator(StrictModel):
    """Mapping of the level u in [0, 1] to the plant: `<point>_u` in [`minimum`, `maximum`], `<point>_activate` = 1.

    Values are in the units of the plant's interface, the room's temperature in °C. By `map` the level is

    - linear: the share of the way from `minimum` to `maximum`, or of the way back unless `rising`;
    - radiator: ((T_supply − T_zone) / (`maximum` − T_reference))^`exponent`. A room above reference cannot have all of
      u = 1, since the water is at most at `maximum`;
    - fan_coil: share of the flow · (T_supply − T_zone) / (T_supply − T_reference), heating or cooling.

    Each is strictly increasing in u between the ends of the value's range; `level` is the inverse of `value` there.
    """

    point: PointName = Field(description="overwrite point of the test case, without the `_u` ending")
    minimum: float = Field(0.0, description="lowest value, in `unit`; the value at u = 0 if `rising`")
    maximum: float = Field(1.0, description="highest value, in `unit`; the value at u = 1 if `rising`")
    rising: bool = Field(True, description="whether the value rises with u; false for the set-point of a cooled room")
    unit: str = Field("1", description="unit of the value at the plant's interface")
    kind: Literal["level", "setpoint"] = Field(
        "level", description="level: heat follows u at once; setpoint: a control loop of the building follows the value"
    )
    map: Literal["linear", "radiator", "fan_coil"] = Field(
        "linear",
        description="linear: the value itself; radiator: supply water, heat ~ (T_supply - T_zone)^exponent; fan_coil: "
        "air flow, heat ~ flow * (T_supply - T_zone) with T_supply the held point `supply`",
    )
    exponent: float = Field(1.3, ge=1, le=2, description="radiator: exponent n of its data sheet (EN 442)")
    reference_zone_C: float = Field(
        20.0, ge=0, le=40, description="radiator, fan_coil: room temperature for which u = 1 is the value at its end"
    )
    held: dict[PointName, float] = Field(
        default_factory=dict,
        description="other overwrite points held at a value (unit of the interface) while u acts; native otherwise",
    )
    switch: str | None = Field(
        None, description="a point of `held` without which nothing flows, such as a pump: 0 at u = 0 instead"
    )
    supply: str | None = Field(None, description="fan_coil: the point of `held` that sets the supply air, K")

    @model_validator(mode="after")
    def _ordered(self) -> Actuator:
        check_range(self.minimum, self.maximum, self.unit)
        if self.point in self.held:
            raise ValueError(f"held: '{self.point}' is the actuator itself")
        for key, name in (("switch", self.switch), ("supply", self.supply)):
            if name is not None and name not in self.held:
                raise ValueError(f"{key}: '{name}' is not one of the points in held")
        return self

    @model_validator(mode="after")
    def _mapped(self) -> Actuator:
        if self.map != "linear" and not self.rising:
            raise ValueError(f"map {self.map}: the value rises with u; leave rising out")
        if self.map == "radiator" and not (self.unit == "K" and self.maximum > self._reference):
            raise ValueError("map radiator: the value is a water temperature in K, its maximum above reference_zone_C")
        if (self.map == "fan_coil") != (self.supply is not None):
            raise ValueError("map fan_coil and supply go together: name the point in held that sets the supply air")
        if self.supply is not None and abs(self.held[self.supply] - self._reference) < 1.0:
            raise ValueError(f"supply: '{self.supply}' is held at the room's temperature, it would do nothing")
        return self

    def beside_the_level(self, maximum: float | None) -> Iterator[tuple[str, object, object]]:
        """Yield each key that a plant which takes u itself would ignore: its value, and the one that changes nothing.

        `maximum`: the value that this plant has at u = 1; None: the plant checks it itself.
        """
        yield "map", self.map, "linear"
        yield "rising", self.rising, True
        yield "held", self.held, {}
        yield "minimum", self.minimum, 0.0
        if maximum is not None:
            yield "maximum", self.maximum, maximum

    @property
    def sensed(self) -> tuple[str, ...]:
        """Points whose applied values give the level: the actuator's own, its switch and its supply."""
        return tuple(name for name in (self.point, self.switch, self.supply) if name is not None)

    @property
    def points(self) -> tuple[str, ...]:
        """All overwrite points."""
        return (self.point, *self.held)

    def value(self, u: float, T_zone_C: float = math.nan) -> float:
        """Return the value of `<point>_u` for `u` in [0, 1], in `unit`; a room that is not measured is at reference."""
        room, share = self._room(T_zone_C), np.asarray(u)
        if self.map == "radiator":
            above = (self.maximum - self._reference) * share ** (1.0 / self.exponent)
            return float(np.clip(room + above if u > 0 else self.minimum, self.minimum, self.maximum))
        if self.supply is not None:
            share = np.clip(share / np.maximum(self._of_air(room, self.held[self.supply]), _LEAST_SHARE), 0.0, 1.0)
        elif not self.rising:
            share = 1.0 - share
        return float(self.minimum + share * (self.maximum - self.minimum))

    def inputs(self, u: float | None, T_zone_C: float = math.nan) -> dict[str, float]:
        """Return the plant inputs for `u` in [0, 1] with the room at `T_zone_C` °C, or None for native control.

        All points are set explicitly, since a point that is not set keeps its last value.
        """
        if u is None:
            return {f"{name}_activate": 0.0 for name in self.points}
        values = {self.point: self.value(u, T_zone_C), **self.held}
        if self.switch is not None and u <= 0:
            values[self.switch] = 0.0
        return {f"{name}_u": value for name, value in values.items()} | {f"{name}_activate": 1.0 for name in values}

    def level(
        self, value: float | Array, T_zone_C: float | Array = math.nan, others: Mapping[str, Array] | None = None
    ) -> Array:
        """Return the level u for `value` (in `unit`) with the room at `T_zone_C` °C (NaN: at reference), in [0, 1].

        `others`: applied values of the other points of `sensed`, of the same shape; by default as held.
        """
        applied: dict[str, float | Array] = {**self.held, **(others or {})}
        room, value = self._room(T_zone_C), np.asarray(value, dtype=np.float64)
        if self.map == "radiator":
            u = (np.maximum(value - room, 0.0) / (self.maximum - self._reference)) ** self.exponent
        else:
            u = (value - self.minimum) / (self.maximum - self.minimum)
            if self.supply is not None:
                u = u * self._of_air(room, applied[self.supply])
            u = (u if self.rising else 1.0 - u) + 0.0 * room
        u = np.clip(u, 0.0, 1.0)
        if self.switch is None:
            return u
        return np.where(np.asarray(applied[self.switch]) > 0.5 * self.held[self.switch], u, 0.0)

    def _of_air(self, room: Array, supply: float | Array) -> Array:
        """What air at `supply` brings to the room as a share of what the held supply brings to one at reference."""
        assert self.supply is not None
        return np.asarray((np.asarray(supply) - room) / (self.held[self.supply] - self._reference))

    def _room(self, T_zone_C: float | Array) -> Array:
        T = np.asarray(T_zone_C, dtype=np.float64)
        return np.where(np.isfinite(T), T, self.reference_zone_C) + ZERO_C_K

    @property
    def _reference(self) -> float:
        return self.reference_zone_C + ZERO_C_K


class RoomSetpoints(StrictModel):
    """Room set-points for heating and cooling, kept by the zone's own loops, as an actuator.

    The level u in [−cooling_W / heating_W, 1] is heat delivered to the room over `heating_W`. It is measured, not
    commanded: a plan expects a level, and the plant's own loop finds it by keeping the set-points.
    """

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
        check_range(self.minimum, self.maximum, self.unit)
        if self.heating == self.cooling:
            raise ValueError(f"heating and cooling are the same point '{self.heating}'")
        return self

    @property
    def u_min(self) -> float:
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
        """Return the plant inputs for the set-points `band_C` (heating, cooling), °C; `u` None: native control.

        One loop at a time acts: of the direction that is planned, by `u`, the `held` points are set, and the set-point
        of the other is moved out of the way. Without `band_C` a full level drives its loop to its limit, and 0 turns
        both off. All points are set explicitly, since a point that is not set keeps its last value.
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
        heat = self.maximum if u > 0 and math.isfinite(u) else self.minimum
        return heat, self.minimum if u < 0 else self.maximum
