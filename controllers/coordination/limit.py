"""What buildings share: a limit on the sum of their powers, a price of its peak, or both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError


@dataclass(frozen=True, eq=False)
class SharedPower:
    """Limit and peak price of the summed power S over N steps.

    `limit_kW` (N,): highest mean power of each step, infinite without a limit. `peak_price_per_kW`: currency per kW by
    which the largest S exceeds `peak_so_far_kW`.

    Raises:
        DataError: a limit below 0 or not a number, or a price or peak that is not finite and nonnegative.
    """

    limit_kW: Array
    peak_price_per_kW: float = 0.0
    peak_so_far_kW: float = 0.0

    def __post_init__(self) -> None:
        limit = np.array(self.limit_kW, dtype=np.float64)
        if limit.ndim != 1 or not limit.size or not (limit >= 0.0).all():
            raise DataError(f"shared power: limit_kW needs one value of at least 0 per step; found {limit}")
        for name in ("peak_price_per_kW", "peak_so_far_kW"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DataError(f"shared power: {name} is {value}, expected a number of at least 0")
        limit.setflags(write=False)
        object.__setattr__(self, "limit_kW", limit)

    def less(self, reserved_kW: float) -> SharedPower:
        """What is left beside a draw of `reserved_kW`: at least 0."""
        return SharedPower(
            np.maximum(self.limit_kW - reserved_kW, 0.0),
            self.peak_price_per_kW,
            max(self.peak_so_far_kW - reserved_kW, 0.0),
        )

    def why_over(self, reserved_kW: float, buildings: int) -> str:
        """'', or why the limit may be exceeded by a draw of `reserved_kW` of as many buildings."""
        if reserved_kW <= self.limit_kW.min():
            return ""
        return (
            f"the {buildings} buildings that take no part may draw {reserved_kW:.4g} kW, more than the limit of "
            f"{self.limit_kW.min():.4g} kW"
        )

    def cost(self, total_kW: Array) -> float:
        """Cost of the peak of `total_kW` (N,), currency; the limit is not part of it."""
        return self.peak_price_per_kW * max(float(total_kW.max()) - self.peak_so_far_kW, 0.0)
