"""Probing by room set-points: the plant's own loops move the zone inside the comfort band, up and down.

Random set-points, held for random times, excite heating and cooling in turn. They stay inside the comfort bounds in
force, so probing is as comfortable as the plant's own control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Block, Boundary, Record

# Distance of the set-points from the zone temperature when they are drawn, K: enough to set a loop to work.
_NEAREST_K, _FARTHEST_K = 0.5, 3.0
# Least distance between heating and cooling set-point, K: loops that overlap would work against each other.
_APART_K = 0.5
# Shares of draws that heat and that cool; the rest let the zone float.
_HEAT, _COOL = 0.4, 0.4


@dataclass
class RoomExcitation:
    """Excites a zone by room set-points, equal ones for equal seeds and readings. `lowest`: level of full cooling."""

    rng: np.random.Generator
    hold_steps: tuple[int, ...]
    lowest: float
    step_s: float
    left: int = 0
    sign: int = 0
    target_C: float = 0.0

    def next(self, record: Record, band: Boundary, ahead: Boundary | None) -> Block:
        """Room set-points of the next step, for which `band` holds the bounds; `ahead` counts for levels only."""
        lower, upper = float(band.lower_C[0].max()), float(band.upper_C[0].min())
        T_zone_C, step_s = float(record.T_zone_C[0, -1]), self.step_s
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

    def withheld(self) -> None:
        """Room set-points exclude nothing, and nothing excludes them."""

    def learn(self, step: Record) -> None:
        """Nothing is learned: the plant's own loops keep the bounds."""
