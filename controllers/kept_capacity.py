"""Share of a shared machine's capacity that plans leave unused, learned from what its actuators got.

What an actuator takes at a level is known on the average; a cold floor takes more. At the machine's limit the water
cools, and what one takes too much another lacks, most in the warmest room. Where a metered actuator got clearly less
than its level stands for, plans keep away from the limit by more; where all got theirs at the limit, by less.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array

# Heat below this share of what the level stands for is lacking.
_LACKING = 0.8
# Plans ask for all that they may from this share of it; a machine is at its limit from this share of its capacity:
# below, a warm floor takes less than its level stands for.
_ALL_ASKED, _AT_LIMIT = 0.85, 0.92
# Levels below this say nothing of heat.
_LEAST_LEVEL = 0.1
# Change of the share that is kept: while heat is lacking, and while none is, 1/h; and the most that is kept.
_GROWTH_1_H, _FADING_1_H, _MOST = 0.12, 0.01, 0.25


def learned_share(
    before: float, load: float, most_W: float, heat_W: Array, expected_W: Array, u: Array, step_s: float
) -> float:
    """The share kept of one machine's capacity after a step.

    Args:
        before: share kept so far.
        load: what the actuators asked for in the step, as a share of the capacity.
        most_W: the capacity, W.
        heat_W: what each got, (A,), W; NaN: not metered.
        expected_W: what their levels stand for, (A,), W.
        u: their mean levels in the step, (A,).
        step_s: length of the step, s.
    """
    if not (np.isfinite(heat_W).all() and np.isfinite(u).all()) or load < _ALL_ASKED * (1.0 - before):
        return before
    lacking = (np.abs(heat_W) < _LACKING * np.abs(expected_W)) & (u >= _LEAST_LEVEL)
    at_limit = np.abs(heat_W.sum()) >= _AT_LIMIT * most_W
    rate = _GROWTH_1_H if at_limit and lacking.any() else -_FADING_1_H
    return float(np.clip(before + rate * step_s / HOUR_S, 0.0, _MOST))
