"""Input of the operator: a map v(u, T_out), monotone in u, from the level to the delivered heat."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad


@dataclass(frozen=True)
class HeatInput:
    """Map v(u, T_out), dimensionless and nondecreasing in u, with v = 1 at full level and `reference_C`.

    Without a `heat` load it is v = u·(1 + per_K·(T_out − reference_C)), and the identity v = u of the paper's operator
    where `per_K` is 0; outside `T_out_range_C`, °C, T_out is held at the nearer end. Heat that was measured beside v =
    u is `metered`: it does not enter v, but readings of the meter are levels by it. `u_min` is the lowest level: 0, or
    less where the level of one zone's heating and cooling is signed, which only the identity allows. Raises `DataError`
    for `u_min` outside [−10, 0], a load with a term in u², parts that do not go together, or a `per_K` so large that v
    does not rise with u somewhere in the range.
    """

    heat: MachineLoad | None = None
    reference_C: float = 0.0
    u_min: float = 0.0
    per_K: float = 0.0
    T_out_range_C: tuple[float, float] = (0.0, 0.0)
    metered: MachineLoad | None = None

    def __post_init__(self) -> None:
        identity = self.heat is None and self.per_K == 0.0
        if not -10.0 <= self.u_min <= 0.0 or (self.u_min < 0.0 and not identity):
            raise DataError(f"lowest level {self.u_min:g}: expected 0, or that of cooling where u drives the operator")
        if self.law is not None and self.law.curve_W != 0.0:
            raise DataError(f"heat input: heat has no term in u² ({self.law.curve_W:g} W), only power has")
        if self.metered is not None and not (identity and self.u_min == 0.0):
            raise DataError("heat input: metered heat belongs to v = u with levels from 0")
        if self.per_K == 0.0:
            return
        if self.heat is not None:
            raise DataError("heat input: per_K belongs to levels whose heat is not measured")
        low, high = self.T_out_range_C
        if not (np.isfinite([self.per_K, low, high]).all() and low <= high and min(self._ends()) > 0.0):
            raise DataError(
                f"heat input: {self.per_K:g} 1/K about {self.reference_C:g} °C is not positive from {low:g} to "
                f"{high:g} °C"
            )

    @property
    def law(self) -> MachineLoad | None:
        """Measured heat of a level, whether it is v or not; None where heat was not measured."""
        return self.metered if self.heat is None else self.heat

    @property
    def by_level(self) -> HeatInput:
        """The same with v = u, and the law of its heat beside."""
        return replace(self, heat=None, metered=self.law)

    def with_law(self, law: MachineLoad) -> HeatInput:
        """The same with another law of its heat, which has one."""
        return replace(self, metered=law) if self.heat is None else replace(self, heat=law)

    def full_share(self, T_out_C: Array | float) -> Array:
        """Return the heat of full level at `T_out_C` °C over that at `reference_C`; 1 where heat was not measured."""
        if self.law is None:
            return np.ones(np.shape(T_out_C))
        return np.asarray(self.law(np.asarray(1.0), np.asarray(T_out_C)) / self.reference_W)

    @cached_property
    def winter_share(self) -> float:
        """`full_share` at 0 °C, the winter of rules that know no weather."""
        return float(self.full_share(0.0))

    def of_meter(self, heat_W: Array, T_out_C: Array) -> Array:
        """Return v of measured heat `heat_W`, W, at `T_out_C` °C: with v = u, the share of the heat of full level."""
        share = heat_W / self.reference_W
        return np.asarray(share if self.heat is not None else share / self.full_share(T_out_C))

    def outdoor_factor(self, T_out_C: Array | float) -> Array:
        """Return v per level at `T_out_C` °C where heat is not measured."""
        return np.asarray(1.0 + self.per_K * (np.clip(T_out_C, *self.T_out_range_C) - self.reference_C))

    def _ends(self) -> tuple[float, float]:
        """v per level at both ends of the range."""
        if self.per_K == 0.0:
            return 1.0, 1.0
        low, high = sorted(float(self.outdoor_factor(T)) for T in self.T_out_range_C)
        return low, high

    @cached_property
    def reference_W(self) -> float:
        """Heat of full level at `reference_C`, W; 1 where heat was not measured."""
        return 1.0 if self.law is None else float(self.law(np.asarray(1.0), np.asarray(self.reference_C)))

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """Return v for `u` in [0, 1] and `T_out_C` °C (shapes broadcast)."""
        if self.heat is None:
            level = np.asarray(u, dtype=np.float64) + 0.0 * np.asarray(T_out_C, dtype=np.float64)
            return level if self.per_K == 0.0 else level * self.outdoor_factor(T_out_C)
        return self.heat(u, T_out_C) / self.reference_W

    def slope_bounds(self) -> tuple[float, float]:
        """Return the smallest and largest ∂v/∂u over u in [0, 1] and the outdoor range."""
        if self.heat is None:
            return self._ends()
        low, high = self.heat.slope_bounds()
        return low / self.reference_W, high / self.reference_W

    def largest_W(self) -> float:
        """Return the most heat over the outdoor range, W: full level at the end with more; 0 if it was not measured."""
        if self.law is None:
            return 0.0
        return max(sum(float(part) for part in self.law.parts(T)) for T in self.law.T_out_range_C)

    def largest(self) -> float:
        """Return the largest v over u in [0, 1] and the outdoor range."""
        return self._ends()[1] if self.heat is None else self.largest_W() / self.reference_W

    def at_lowest_level(self, lowest_level: float) -> HeatInput:
        """Return the same map with another lowest level, see `MachineLoad.at_lowest_level`."""
        return self if self.law is None else self.with_law(self.law.at_lowest_level(lowest_level))


IDENTITY = HeatInput()
