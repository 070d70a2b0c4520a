"""Probing by room set-points: the plant's own loops move the zone inside the comfort band, up and down.

Random set-points, held for random times, excite heating and cooling in turn. They stay inside the comfort bounds in
force, so probing is as comfortable as the plant's own control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array, Block

# Distance of the set-points from the zone temperature when they are drawn, K: enough to set a loop to work.
_NEAREST_K, _FARTHEST_K = 0.5, 3.0
# Least distance between heating and cooling set-point, K: loops that overlap would work against each other.
_APART_K = 0.5
# Shares of draws that heat and that cool; the rest let the zone float.
_HEAT, _COOL = 0.4, 0.4


@dataclass
class RoomExcitation:
    """Generator of room set-points; equal seeds and temperatures give equal ones. `lowest`: level of full cooling."""

    rng: np.random.Generator
    hold_steps: tuple[int, ...]
    lowest: float
    left: int = 0
    sign: int = 0
    target_C: float = 0.0

    def next(self, T_zone_C: float, lower_C: Array, upper_C: Array, step_s: float) -> Block:
        """Return the block of the next step.

        Args:
            T_zone_C: zone temperature now, °C.
            lower_C, upper_C: comfort bounds at the start and the end of the step, shape (2,), °C.
            step_s: length of the step, s.
        """
        lower, upper = float(lower_C.max()), float(upper_C.min())
        if self.left == 0:
            self.left = int(self.rng.choice(self.hold_steps))
            kind, away = self.rng.random(), self.rng.uniform(_NEAREST_K, _FARTHEST_K)
            self.sign = 1 if kind < _HEAT else -1 if kind < _HEAT + _COOL else 0
            self.target_C = T_zone_C + self.sign * away
        self.left -= 1
        target = min(max(self.target_C, lower), upper)
        if self.sign > 0 and T_zone_C < upper - _APART_K:
            return Block(1.0, step_s, (min(target, upper - _APART_K), upper))
        if self.sign < 0 and T_zone_C > lower + _APART_K:
            return Block(self.lowest, step_s, (lower, max(target, lower + _APART_K)))
        return Block(0.0, step_s, (lower, upper))
