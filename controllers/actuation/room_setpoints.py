"""Room set-points from a plan: the plant's own loops find the levels, the plan decides when and where to.

Disturbances within a step are the loops' task; they act in seconds. The set-points never leave the comfort bounds in
force, so the zone is at least as comfortable as under the plant's own schedule, however wrong the model is.
"""

from __future__ import annotations

import math

import numpy as np

from controllers.actuation.actuator import OFF
from thermoforce_mpc.data import Array, Block

# The numbers here were set on the air of `bestest_air`, the first plant with such loops (2026-11-22).
# Planned change of the zone temperature beyond its present value from which the loop runs at its limit, K.
_MOVES_K = 0.3
# A loop slows down before it is there: factor on the time at full level.
_SLOWS = 1.25
# A loop that worked at its bound in the last step, at this level or more, is taken to go on within this distance, K:
# that of `_MOVES_K`.
_WORKED, _AT_BOUND_K = 0.01, 0.3


def room_blocks(
    u: float,
    T_end_C: float,
    *,
    T_now_C: float,
    u_last: float,
    bounds_C: tuple[float, float],
    u_min: float,
    step_s: float,
    block_s: float,
) -> tuple[Block, ...]:
    """Blocks of total length `step_s` for a planned mean level `u` that brings the zone to `T_end_C`.

    Where the zone is to be moved, the loop starts as late as it can: the move takes the share of the step that `u`
    exceeds the level that holds the zone, at full level, rounded up to `block_s`. Where nothing is planned, a loop that
    holds the zone at its bound goes on undisturbed.

    `u`: below 0 for cooling; temperatures at the end of the step and now, °C (`T_now_C` NaN: not known, the loops act
    for the whole step); `u_last`: measured level of the last step, NaN: not known; `bounds_C`: in force during the
    step, margins and learned reserve inside; `u_min`: level of full cooling, below 0; `block_s`: least time between
    two set-points, s.
    """
    lower, upper = bounds_C
    holding = _holding_sign(u_last, T_now_C, bounds_C)
    hold = math.copysign(max(OFF, abs(u_last)), holding) if holding else 0.0
    if abs(u) < OFF:
        return (Block(hold, step_s, bounds_C),)
    end = min(max(T_end_C, lower), upper)
    band = (end, upper) if u > 0 else (lower, end)
    to_go = end - T_now_C if u > 0 else T_now_C - end
    if not to_go > _MOVES_K:
        return (Block(u, step_s, band),)
    base_level = abs(hold) if hold * u > 0 else 0.0
    full = 1.0 if u > 0 else -u_min
    share = max(abs(u) - base_level, 0.0) / max(full - base_level, OFF)
    moving_s = min(max(math.ceil(_SLOWS * share * step_s / block_s), 1) * block_s, step_s)
    level = (abs(u) - base_level) * step_s / moving_s + base_level
    moving = Block(math.copysign(min(max(level, OFF), full), u), moving_s, band)
    if moving_s >= step_s:
        return (moving,)
    return Block(hold, step_s - moving_s, bounds_C), moving


def _holding_sign(u_last: float, T_now_C: float, bounds_C: tuple[float, float]) -> int:
    """+1 or −1 where the heating or cooling loop held the zone at its bound in the last step, else 0."""
    if u_last > _WORKED and T_now_C < bounds_C[0] + _AT_BOUND_K:
        return 1
    if u_last < -_WORKED and T_now_C > bounds_C[1] - _AT_BOUND_K:
        return -1
    return 0


def within_C(lower_C: float, upper_C: float, inside_K: Array) -> tuple[float, float]:
    """Bounds with margins `inside_K` (2,) inside the lower and the upper one, at most to the middle of the band, °C."""
    below_K, above_K = np.minimum(inside_K, 0.5 * (upper_C - lower_C))
    return lower_C + float(below_K), upper_C - float(above_K)
