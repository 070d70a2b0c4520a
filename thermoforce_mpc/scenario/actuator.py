"""Actuator of a zone: the level u in [0, 1] as a value at the plant's interface, and back."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.scenario.actuator_map import FanCoilMap, LinearMap, MapName, RadiatorMap
from thermoforce_mpc.scenario.strict_model import PointName, StrictModel, check_kelvin


class Actuator(StrictModel):
    """Mapping of the level u in [0, 1] to the plant: `<point>_u` in [`minimum`, `maximum`], `<point>_activate` = 1.

    u is the heating or cooling effort; `map` says how heat follows from the value and the room's temperature
    (`thermoforce_mpc.scenario.actuator_map`). Values and temperatures are in the units of the plant's interface, the
    room's temperature in °C.
    """

    point: PointName = Field(description="overwrite point of the test case, without the `_u` ending")
    minimum: float = Field(0.0, description="lowest value, in `unit`; the value at u = 0 if `rising`")
    maximum: float = Field(1.0, description="highest value, in `unit`; the value at u = 1 if `rising`")
    rising: bool = Field(True, description="whether the value rises with u; false for the set-point of a cooled room")
    unit: str = Field("1", description="unit of the value at the plant's interface")
    kind: Literal["level", "setpoint"] = Field(
        "level", description="level: heat follows u at once; setpoint: a control loop of the building follows the value"
    )
    map: MapName = Field(
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
        if not self.minimum < self.maximum:
            raise ValueError(f"minimum ({self.minimum}) must be below maximum ({self.maximum})")
        if self.unit == "K":
            check_kelvin(minimum=self.minimum, maximum=self.maximum)
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
        reference = self.reference_zone_C + ZERO_C_K
        if self.map == "radiator" and not (self.unit == "K" and self.maximum > reference):
            raise ValueError("map radiator: the value is a water temperature in K, its maximum above reference_zone_C")
        if (self.map == "fan_coil") != (self.supply is not None):
            raise ValueError("map fan_coil and supply go together: name the point in held that sets the supply air")
        if self.supply is not None and abs(self.held[self.supply] - reference) < 1.0:
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
        return float(self._value(np.asarray(u), self._room(T_zone_C)))

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
        """Return the level u for `value` (in `unit`) with the room at `T_zone_C` °C, clipped to [0, 1].

        Args:
            value: applied value of `point`, any shape.
            T_zone_C: room temperature, same shape; NaN: at reference.
            others: applied values of the other points of `sensed`; by default as held.
        """
        applied = {**self.held, **(others or {})}
        room, value = self._room(T_zone_C), np.asarray(value, dtype=np.float64)
        if self.map == "fan_coil" and self.supply is not None:
            planned = np.asarray(self.held[self.supply])
            u = self._fan_coil.level(value, room, np.asarray(applied[self.supply]), planned)
        else:
            u = self._plain.level(value, room)
        if self.switch is None:
            return u
        return np.where(np.asarray(applied[self.switch]) > 0.5 * self.held[self.switch], u, 0.0)

    def _value(self, u: Array, room: Array) -> Array:
        if self.map == "fan_coil" and self.supply is not None:
            return self._fan_coil.value(u, room, np.asarray(self.held[self.supply]))
        return self._plain.value(u, room)

    def _room(self, T_zone_C: float | Array) -> Array:
        T = np.asarray(T_zone_C, dtype=np.float64)
        return np.where(np.isfinite(T), T, self.reference_zone_C) + ZERO_C_K

    @property
    def _plain(self) -> LinearMap | RadiatorMap:
        if self.map == "radiator":
            return RadiatorMap(self.minimum, self.maximum, self.reference_zone_C + ZERO_C_K, self.exponent)
        return LinearMap(self.minimum, self.maximum, self.rising)

    @property
    def _fan_coil(self) -> FanCoilMap:
        return FanCoilMap(self.minimum, self.maximum, self.reference_zone_C + ZERO_C_K)
