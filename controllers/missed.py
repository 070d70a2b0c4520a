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
        growth_1_h: growth, K per hour and K of mean violation above the allowed one.
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
# readings show them, so each counts more. 0.003 K are 0.5 K.h a week. Chosen on two cold weeks of the small office.
OF_LOOPS = Learning(0.75, 1.0, 0.003)
# How much wider than at its tightest a bound is set back, K.
_SET_BACK_K = 0.5


def set_back(lower_C: Array, upper_C: Array) -> NDArray[np.bool_]:
    """Where bounds (..., N), °C, are wider than at their tightest within the N instants, lower and upper (2, ..., N).

    There loops cycle at low load, and a reserve costs little.
    """
    tightest = lower_C.max(axis=-1, keepdims=True), upper_C.min(axis=-1, keepdims=True)
    return np.stack([lower_C < tightest[0] - _SET_BACK_K, upper_C > tightest[1] + _SET_BACK_K])


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
    change_K = learning.growth_1_h * step_s / HOUR_S * (violation_K - learning.allowed_K)
    learned = spare & np.isfinite(beyond_K)
    return np.asarray(np.clip(before_K + np.where(learned, change_K, 0.0), 0.0, learning.most_K))
