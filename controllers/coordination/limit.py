"""What buildings share: a limit on the sum of their powers, a price of its peak, or both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

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

    def less(self, reserved_kW: Array) -> SharedPower:
        """What is left beside a draw of `reserved_kW` (N,): at least 0."""
        # The peak of the rest is counted from what the reserve leaves of the peak so far in its highest step.
        return SharedPower(
            np.maximum(self.limit_kW - reserved_kW, 0.0),
            self.peak_price_per_kW,
            max(self.peak_so_far_kW - float(np.max(reserved_kW, initial=0.0)), 0.0),
        )

    def why_over(self, reserved_kW: Array, buildings: int) -> str:
        """'', or why the limit may be exceeded by a draw of `reserved_kW` (N,) of as many buildings."""
        over = reserved_kW > self.limit_kW
        if not over.any():
            return ""
        return (
            f"the {buildings} buildings that take no part may draw {reserved_kW[over].max():.4g} kW, more than the "
            f"limit of {self.limit_kW[over].min():.4g} kW"
        )

    def cost(self, total_kW: Array) -> float:
        """Cost of the peak of `total_kW` (N,), currency; the limit is not part of it."""
        return self.peak_price_per_kW * max(float(total_kW.max()) - self.peak_so_far_kW, 0.0)

    def nearest(self, total_kW: Array, weight: float) -> Array:
        """The S (N,), kW, that minimises its peak's cost + weight/2 · |S − total_kW|² within the limit."""
        wanted = np.minimum(total_kW, self.limit_kW)
        if self.peak_price_per_kW == 0.0 or wanted.max() <= self.peak_so_far_kW:
            return wanted

        def slope(peak: float) -> float:
            """Derivative of the objective in the peak at which S is cut off."""
            cut = self.limit_kW > peak
            return self.peak_price_per_kW - weight * float(np.maximum(total_kW - peak, 0.0)[cut].sum())

        if slope(self.peak_so_far_kW) >= 0.0:
            return np.minimum(wanted, self.peak_so_far_kW)
        # Where a limit of a step jumps over the root the sign still changes there.
        return np.minimum(wanted, brentq(slope, self.peak_so_far_kW, float(wanted.max()), xtol=1e-9))

    def least(self, price: Array) -> tuple[Array, float]:
        """Prices (N,), currency/kW, for which the dual function is finite, and inf_S of the peak's cost − price · S."""
        price = np.where(np.isfinite(self.limit_kW), price, np.minimum(price, self.peak_price_per_kW))
        free = ~np.isfinite(self.limit_kW)
        if price[free].sum() > self.peak_price_per_kW:
            price = np.where(free, price * self.peak_price_per_kW / price[free].sum(), price)
        # Piecewise linear in the peak: the minimum is at one of the corners.
        corners = np.maximum([self.peak_so_far_kW, *self.limit_kW[~free]], self.peak_so_far_kW)
        sums = np.minimum(self.limit_kW, corners[:, None]) @ price
        return price, float((self.peak_price_per_kW * (corners - self.peak_so_far_kW) - sums).min())
