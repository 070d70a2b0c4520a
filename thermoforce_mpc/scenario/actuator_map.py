"""Maps between the level u in [0, 1], in which heat is linear, and the value at the plant's interface.

The heat of a radiator or an air heater depends on the room: a map takes that physics out at the plant's edge, so that
everything behind it (operator, power law, quadratic programme) sees a level that heat is proportional to. Each map is
strictly increasing in u between the ends of the value's range, and `level` is the inverse of `value` there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.data import Array

MapName = Literal["linear", "radiator", "fan_coil"]

# Least difference of supply air and room as a share of that at reference: nearer, the air neither heats nor cools.
_LEAST_SHARE = 0.05


@dataclass(frozen=True)
class LinearMap:
    """u = share of the way from `minimum` to `maximum`, or of the way back unless `rising`; the room plays no part."""

    minimum: float
    maximum: float
    rising: bool = True

    def value(self, u: Array, T_zone: Array) -> Array:
        """Return the value for `u` in [0, 1]; shapes broadcast."""
        share = u if self.rising else 1.0 - u
        return np.asarray(self.minimum + share * (self.maximum - self.minimum) + 0.0 * T_zone)

    def level(self, value: Array, T_zone: Array) -> Array:
        """Return u for `value`, clipped to [0, 1]; shapes broadcast."""
        share = (value - self.minimum) / (self.maximum - self.minimum)
        return np.clip((share if self.rising else 1.0 - share) + 0.0 * T_zone, 0.0, 1.0)


@dataclass(frozen=True)
class RadiatorMap:
    """Supply water of a radiator: u = ((T_supply − T_zone) / (`maximum` − `reference`))^`exponent`.

    Temperatures in one unit. At u = 0 the value is `minimum`. A room above `reference` cannot have all of u = 1, since
    the water is at most at `maximum`; `level` then says what it gets.
    """

    minimum: float
    maximum: float
    reference: float
    exponent: float

    def value(self, u: Array, T_zone: Array) -> Array:
        """Return the supply temperature for `u` in [0, 1] and the room at `T_zone`; shapes broadcast."""
        above = (self.maximum - self.reference) * np.asarray(u) ** (1.0 / self.exponent)
        supply = np.where(np.asarray(u) > 0, T_zone + above, self.minimum)
        return np.clip(supply, self.minimum, self.maximum)

    def level(self, value: Array, T_zone: Array) -> Array:
        """Return u for supply water at `value`, clipped to [0, 1]; shapes broadcast."""
        share = np.maximum(value - T_zone, 0.0) / (self.maximum - self.reference)
        return np.clip(share**self.exponent, 0.0, 1.0)


@dataclass(frozen=True)
class FanCoilMap:
    """Flow of air at a supply temperature: u = share of the flow · (`supply` − T_zone) / (`supply` − `reference`).

    `minimum`, `maximum`: the flow at u = 0 and at u = 1 with the room at `reference`. Heating (supply above the room)
    and cooling (below) alike. As the room nears the supply air, a flow counts for less.
    """

    minimum: float
    maximum: float
    reference: float

    def value(self, u: Array, T_zone: Array, supply: Array) -> Array:
        """Return the flow for `u` in [0, 1], the room at `T_zone` and air at `supply`; shapes broadcast."""
        share = np.asarray(u) / np.maximum(self._share(T_zone, supply, supply), _LEAST_SHARE)
        return np.asarray(self.minimum + np.clip(share, 0.0, 1.0) * (self.maximum - self.minimum))

    def level(self, value: Array, T_zone: Array, supply: Array, planned_supply: Array) -> Array:
        """Return u for a flow of `value` with air at `supply`, relative to that at `planned_supply`; in [0, 1]."""
        flow = (value - self.minimum) / (self.maximum - self.minimum)
        return np.clip(flow * self._share(T_zone, supply, planned_supply), 0.0, 1.0)

    def _share(self, T_zone: Array, supply: Array, planned_supply: Array) -> Array:
        return np.asarray((supply - T_zone) / (planned_supply - self.reference))
