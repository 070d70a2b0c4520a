"""Input of the operator: a map v(u, T_out), monotone in u, from the level to the delivered heat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad


@dataclass(frozen=True)
class HeatInput:
    """Map v(u, T_out), dimensionless and nondecreasing in u, with v = 1 at full level and `reference_C`.

    Without a `heat` load it is the identity v = u of the paper's operator. `lowest` is the lowest level: 0, or less
    where the level of one zone's heating and cooling is signed (cooling below 0), which only the identity allows.

    Raises:
        DataError: `lowest` is not in [−10, 0], or below 0 with a heat load.
    """

    heat: MachineLoad | None = None
    reference_C: float = 0.0
    lowest: float = 0.0

    def __post_init__(self) -> None:
        if not -10.0 <= self.lowest <= 0.0 or (self.lowest < 0.0 and self.heat is not None):
            raise DataError(f"lowest level {self.lowest:g}: expected 0, or that of cooling where u drives the operator")

    @property
    def kind(self) -> str:
        """'identity' or 'heat'."""
        return "identity" if self.heat is None else "heat"

    @property
    def reference_W(self) -> float:
        """Heat at v = 1, W (1 for the identity)."""
        return 1.0 if self.heat is None else float(self.heat(np.asarray(1.0), np.asarray(self.reference_C)))

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """Return v for `u` in [0, 1] and `T_out_C` °C (shapes broadcast)."""
        if self.heat is None:
            return np.asarray(u, dtype=np.float64) + 0.0 * np.asarray(T_out_C, dtype=np.float64)
        return self.heat(u, T_out_C) / self.reference_W

    def slope_bounds(self) -> tuple[float, float]:
        """Return the smallest and largest ∂v/∂u over u in [0, 1] and the outdoor range."""
        if self.heat is None:
            return 1.0, 1.0
        low, high = self.heat.slope_bounds()
        return low / self.reference_W, high / self.reference_W

    def largest(self) -> float:
        """Return the largest v over u in [0, 1] and the outdoor range: full level at the end with more heat."""
        if self.heat is None:
            return 1.0
        return max(sum(float(part) for part in self.heat.parts(T)) for T in self.heat.T_out_range_C) / self.reference_W

    def at_lowest_level(self, lowest_level: float) -> HeatInput:
        """Return the same map with another lowest level, see `MachineLoad.at_lowest_level`."""
        return self if self.heat is None else replace(self, heat=self.heat.at_lowest_level(lowest_level))


IDENTITY = HeatInput()
