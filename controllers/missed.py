"""Reserve inside the comfort bound that is learned from what was missed.

What a plan cannot see shows in the readings afterwards: a sensor that lags behind a room in on/off blocks, a machine
that is weaker than its law. Where readings are beyond the bound although the machine had more to give, by more in the
mean than a plan may expect to be, the reserve grows; otherwise it fades.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array


@dataclass(frozen=True)
class Learning:
    """How a reserve is learned.

    Attributes:
        growth_1_h: growth, K per hour and K of mean violation above the allowed one; in a step at most the violation.
        most_K: the most that is learned, and that one reading counts, K.
        allowed_K: mean violation that a plan may expect, K.
    """

    growth_1_h: float
    most_K: float
    allowed_K: float


def of_plans(allowed_K: float) -> Learning:
    """For plans of levels: 0.05 K too much all day adds 0.2 K; at most what a thermostat keeps above its bound."""
    return Learning(0.25, 0.3, allowed_K)


# Where the plant's own loops keep set-points. They miss them by short drops, as of a fan that pauses at night: few
# readings show them, so one is made up for at once in steps of 15 min. Chosen on two cold weeks of the small office.
OF_LOOPS = Learning(4.0, 1.0, 0.001)
# How much wider than at its tightest a bound is set back, K.
_SET_BACK_K = 0.5


@dataclass(frozen=True)
class Missed:
    """What a run has learned of its bounds.

    Attributes:
        reserve_K: reserve inside the lower and the upper bound of each zone (2, Z), K.
        tightest_C: the highest lower and the lowest upper bound of each zone that it has met (2, Z), °C.
    """

    reserve_K: Array
    tightest_C: Array

    @classmethod
    def nothing(cls, zones: int) -> Missed:
        """At the begin of a run."""
        return cls(np.zeros((2, zones)), np.stack([np.full(zones, -np.inf), np.full(zones, np.inf)]))

    def meeting(self, lower_C: Array, upper_C: Array) -> Missed:
        """With the bounds (Z, N), °C, of the instants ahead, NaN where they are not known."""
        lower_C, upper_C = np.fmax.reduce(lower_C, axis=-1), np.fmin.reduce(upper_C, axis=-1)
        tightest_C = np.fmax(self.tightest_C[0], lower_C), np.fmin(self.tightest_C[1], upper_C)
        return Missed(self.reserve_K, np.stack(tightest_C))

    def set_back(self, z: int | slice, lower_C: Array, upper_C: Array) -> NDArray[np.bool_]:
        """Where bounds of zone `z` (N,), or of zones at an instant, °C, are wider than at their tightest, (2, N).

        There loops cycle at low load, and a reserve costs little. The instants ahead do not tell: a weekend is longer.
        """
        tightest_C = self.tightest_C[:, z]
        return np.stack([lower_C < tightest_C[0] - _SET_BACK_K, upper_C > tightest_C[1] + _SET_BACK_K])

    def inside_K(self, z: int, lower_C: Array, upper_C: Array, *, by_loops: bool) -> Array:
        """Reserve inside the bounds (N,) of zone `z`, (2, N), K; `by_loops`: only where they are set back."""
        reserve_K = np.repeat(self.reserve_K[:, z, None], lower_C.size, axis=1)
        return reserve_K * self.set_back(z, lower_C, upper_C) if by_loops else reserve_K


def learned_K(before_K: Array, beyond_K: Array, spare: NDArray[np.bool_], step_s: float, learning: Learning) -> Array:
    """The reserve inside each bound after a step, K, from that before it, any shape.

    Args:
        before_K: reserve so far, K.
        beyond_K: how far the reading at the end of the step was beyond the bound, K, negative inside; NaN: not known.
        spare: whether the actuators that protect the bound were less than fully used in the step; where they were, or
            where there are none, nothing is learned.
        step_s: length of the step, s.
        learning: rate and limits.
    """
    violation_K = np.clip(beyond_K, 0.0, learning.most_K)
    change_K = min(learning.growth_1_h * step_s / HOUR_S, 1.0) * (violation_K - learning.allowed_K)
    learned = spare & np.isfinite(beyond_K)
    return np.asarray(np.clip(before_K + np.where(learned, change_K, 0.0), 0.0, learning.most_K))
