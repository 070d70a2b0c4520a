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

# Mean violation of a bound that a plan may expect, K.
ALLOWED_K = 0.0135


@dataclass(frozen=True)
class Learning:
    """How fast a reserve grows, K per hour and K of mean violation above the allowed one, and the most of it, K."""

    growth_1_h: float
    most_K: float


# 0.05 K too much all day adds about 0.2 K; at most what a thermostat keeps above its bound.
OF_PLANS = Learning(0.25, 0.3)


def of_loops(most_K: float) -> Learning:
    """Where the plant's own loops keep set-points: what they miss are short drops, such as a heat pump that defrosts.

    Faster, since few of the readings show them. Chosen on two cold weeks of the EnergyPlus small office.
    """
    return Learning(0.75, most_K)


def learned_K(
    before_K: Array,
    beyond_K: Array,
    spare: NDArray[np.bool_],
    allowed_K: float,
    step_s: float,
    learning: Learning = OF_PLANS,
) -> Array:
    """The reserve inside each bound after a step, K, from that before it, any shape.

    Args:
        before_K: reserve so far, K.
        beyond_K: how far the reading at the end of the step was beyond the bound, K, negative inside; NaN: not known.
        spare: whether the actuators that protect the bound were less than fully used in the step; where they were, or
            where there are none, nothing is learned.
        allowed_K: mean violation that a plan may expect, K.
        step_s: length of the step, s.
        learning: rate and limit.
    """
    violation_K = np.clip(beyond_K, 0.0, learning.most_K)
    change_K = learning.growth_1_h * step_s / HOUR_S * (violation_K - allowed_K)
    learned = spare & np.isfinite(beyond_K)
    return np.asarray(np.clip(before_K + np.where(learned, change_K, 0.0), 0.0, learning.most_K))
