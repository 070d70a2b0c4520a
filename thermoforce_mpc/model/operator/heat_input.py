"""What of the control reaches the building: a map v(u, T_out), monotone in u, in front of the forced state.

A machine with a fixed part while it runs delivers `on·(h0 + h1·T_out) + u·(h2 + h3·T_out)`. Below its
`lowest_level` a mean level u is made by switching, so the share of time it runs is `on = min(u / lowest_level, 1)`:
1.0 is a pure on/off machine, where everything is proportional to u; a small value is one that modulates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError


@dataclass(frozen=True)
class OnLoad:
    """`on(u)·(c0 + c1·T) + u·(c2 + c3·T)`: the common form of delivered heat and electric power of a machine.

    `coefficients` are (c0, c1, c2, c3) in W, W/K, W, W/K; `T_out_range_C` the outdoor temperatures for which they
    hold, outside of which T_out is held at the nearer end (an affine law goes negative if followed too far).
    `levels_seen` says whether levels between off and full were in the data, that is whether c0 and c2 are known apart.

    Raises:
        DataError: the load is not a nondecreasing function of u at both ends of the range, or a number is not finite.
    """

    coefficients: tuple[float, float, float, float]
    T_out_range_C: tuple[float, float]
    lowest_level: float = 1.0
    levels_seen: bool = True

    def __post_init__(self) -> None:
        low, high = self.T_out_range_C
        if not np.isfinite([*self.coefficients, low, high, self.lowest_level]).all():
            raise DataError(f"load of the actuator is not finite: {self}")
        if not low <= high:
            raise DataError(f"outdoor range of the actuator is reversed: {low} to {high} °C")
        if not 0.0 < self.lowest_level <= 1.0:
            raise DataError(f"lowest level of the actuator is {self.lowest_level}, expected a value in (0, 1]")
        for T in (low, high):
            fixed, slope = self.parts(T)
            if fixed < 0 or slope < 0 or fixed + slope <= 0:
                raise DataError(
                    f"load of the actuator is not increasing in u at T_out = {T:g} °C "
                    f"(fixed part {fixed:g} W, proportional part {slope:g} W)"
                )

    def parts(self, T_out_C: Array | float) -> tuple[Array, Array]:
        """The part that is fixed while on and the part per unit of u at `T_out_C` °C, both W."""
        T = np.clip(T_out_C, *self.T_out_range_C)
        c0, c1, c2, c3 = self.coefficients
        return np.asarray(c0 + c1 * T), np.asarray(c2 + c3 * T)

    def on_share(self, u: Array) -> Array:
        """Share of the step the machine runs, same shape as `u`."""
        u = np.asarray(u, dtype=np.float64)
        return u if self.lowest_level == 1.0 else np.minimum(u / self.lowest_level, 1.0)

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """Load for `u` in [0, 1] at `T_out_C` °C (shapes broadcast), W."""
        fixed, per_u = self.parts(T_out_C)
        return np.asarray(self.on_share(u) * fixed + np.asarray(u, dtype=np.float64) * per_u)

    def slope_bounds(self) -> tuple[float, float]:
        """Smallest and largest ∂load/∂u over u in [0, 1] and the outdoor range, W."""
        slopes: list[float] = []
        for T in self.T_out_range_C:
            fixed, slope = self.parts(T)
            below = fixed / self.lowest_level + slope
            above = slope if self.lowest_level < 1.0 else below
            slopes += [float(below), float(above)]
        return min(slopes), max(slopes)

    def at_lowest_level(self, lowest_level: float) -> OnLoad:
        """The same machine actuated with another lowest level.

        Raises:
            DataError: a lower level is asked for than the data can tell about.
        """
        if lowest_level < 1.0 and not self.levels_seen:
            raise DataError(
                "the actuator was only seen off and full on, so its load at lower levels is unknown: "
                "probe with intermediate levels, or keep lowest_level at 1"
            )
        return replace(self, lowest_level=lowest_level)


@dataclass(frozen=True)
class HeatInput:
    """v(u, T_out), dimensionless and nondecreasing in u, with v = 1 at full heat at `reference_C`.

    Without a `heat` load it is the identity v = u, which is the paper's operator.
    """

    heat: OnLoad | None = None
    reference_C: float = 0.0

    @property
    def kind(self) -> str:
        """'identity' or 'heat'."""
        return "identity" if self.heat is None else "heat"

    @property
    def reference_W(self) -> float:
        """Heat that counts as v = 1, W (1 for the identity)."""
        return 1.0 if self.heat is None else float(self.heat(np.asarray(1.0), np.asarray(self.reference_C)))

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """v for `u` in [0, 1] and `T_out_C` °C (shapes broadcast)."""
        if self.heat is None:
            return np.asarray(u, dtype=np.float64) + 0.0 * np.asarray(T_out_C, dtype=np.float64)
        return self.heat(u, T_out_C) / self.reference_W

    def slope_bounds(self) -> tuple[float, float]:
        """Smallest and largest ∂v/∂u over u in [0, 1] and the outdoor range."""
        if self.heat is None:
            return 1.0, 1.0
        low, high = self.heat.slope_bounds()
        return low / self.reference_W, high / self.reference_W

    def largest(self) -> float:
        """Largest v over u in [0, 1] and the outdoor range: full actuation at the end that delivers more."""
        if self.heat is None:
            return 1.0
        return max(sum(float(part) for part in self.heat.parts(T)) for T in self.heat.T_out_range_C) / self.reference_W

    def at_lowest_level(self, lowest_level: float) -> HeatInput:
        """The same map for another actuation, see `OnLoad.at_lowest_level`."""
        return self if self.heat is None else replace(self, heat=self.heat.at_lowest_level(lowest_level))


IDENTITY = HeatInput()
