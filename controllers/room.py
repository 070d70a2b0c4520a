"""Room set-points from a plan: the plant's own loops find the levels, the plan decides when and where to.

Disturbances within a step are the loops' task; they act in seconds. The set-points never leave the comfort bounds in
force, so the zone is at least as comfortable as under the plant's own schedule, however wrong the model is.
"""

from __future__ import annotations

import math

from thermoforce_mpc.data import Block

# Planned change of the zone temperature beyond its present value from which the loop runs at its limit, K.
_MOVES_K = 0.3
# A loop slows down before it is there: factor on the time at full level.
_SLOWS = 1.25
# Levels nearer to 0 than this are no heating and no cooling.
_OFF = 1e-3


def room_blocks(
    u: float, T_now_C: float, T_end_C: float, bounds_C: tuple[float, float], step_s: float, block_s: float
) -> tuple[Block, ...]:
    """Blocks of total length `step_s` for a planned mean level `u` that brings the zone from `T_now_C` to `T_end_C`.

    Where the zone is to be moved, the loop starts as late as it can: at full level the move takes |u| of the step,
    rounded up to blocks of `block_s`.

    Args:
        u: planned mean level, below 0 for cooling.
        T_now_C: zone temperature now, °C; NaN if it is not known, then the loops act for the whole step.
        T_end_C: planned zone temperature at the end of the step, °C.
        bounds_C: lower and upper bound in force during the step, margins inside, °C.
        step_s: length of the step, s.
        block_s: least time between two set-points, s.
    """
    lower, upper = bounds_C
    if abs(u) < _OFF:
        return (Block(0.0, step_s, (lower, upper)),)
    end = min(max(T_end_C, lower), upper)
    band = (end, upper) if u > 0 else (lower, end)
    to_go = end - T_now_C if u > 0 else T_now_C - end
    resting = lower <= T_now_C <= upper
    if not (to_go > _MOVES_K and resting):
        return (Block(u, step_s, band),)
    moving_s = min(math.ceil(_SLOWS * abs(u) * step_s / block_s) * block_s, step_s)
    moving = Block(math.copysign(min(abs(u) * step_s / moving_s, 1.0), u), moving_s, band)
    if moving_s >= step_s:
        return (moving,)
    return Block(0.0, step_s - moving_s, (lower, upper)), moving


def within_C(lower_C: float, upper_C: float, margin_K: float) -> tuple[float, float]:
    """Bounds with `margin_K` inside, at most to the middle of the band, °C."""
    half = 0.5 * (upper_C - lower_C)
    return lower_C + min(margin_K, half), upper_C - min(margin_K, half)
