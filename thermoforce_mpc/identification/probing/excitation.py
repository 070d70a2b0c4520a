"""Random excitation for probing, held for random times: levels, biased to keep the temperature in its band, or room
set-points inside the comfort band, by which the plant's own loops heat and cool in turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from thermoforce_mpc.data import Block, Boundary, Record

EXCURSION_K = 1.5
"""Distance from the centre of the excursions at which the machine is on, or off, K: half of a band of 3 K, so that
probing stays in it."""
# Change of the probability of on per K from the centre, 1/K: 1.3 K from it, near `EXCURSION_K`, it is what is left as
# the least probability of on (and of off).
_LEAN_PER_K, _LEAST_SHARE = 0.35, 0.05
# Distance of room set-points from the zone temperature when they are drawn, K: enough to set a loop to work. Set on
# `bestest_air`, as the shares below (2026-11-22).
_NEAREST_K, _FARTHEST_K = 0.5, 3.0
# Least distance between heating and cooling set-point, K: loops that overlap would work against each other.
_APART_K = 0.5
# Shares of draws that heat and that cool; the rest let the zone float.
_HEAT, _COOL = 0.4, 0.4


def drawing(state: Mapping[str, Any]) -> np.random.Generator:
    """The random numbers that stood at `state`, of `Generator.bit_generator`."""
    rng = np.random.default_rng(0)
    rng.bit_generator.state = dict(state)
    return rng


class Draws(NamedTuple):
    """Holding times to draw from, steps, and the seed."""

    hold_steps: tuple[int, ...]
    seed: tuple[int, ...]


@dataclass
class Excitation:
    """Generator of levels; equal seeds and temperatures give equal levels.

    `level`, one of `levels`, off first, is held for `left` more steps; `resumed` passes both on to the next excitation.
    """

    levels: tuple[float, ...]
    hold_steps: tuple[int, ...]
    rng: np.random.Generator
    excursion_K: float = EXCURSION_K
    level: float = 0.0
    left: int = 0

    def next(self, need_K: float) -> float:
        """Return the level of the next step; `need_K` is centre − T for heating, T − centre for cooling, K.

        Beyond `excursion_K` the level is the highest, as far on the other side it is 0.
        """
        if abs(need_K) > self.excursion_K:
            self.level, self.left = (max(self.levels) if need_K > 0 else 0.0), 1
        elif self.left == 0:
            on = self.rng.random() < np.clip(0.5 + _LEAN_PER_K * need_K, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
            self.level = float(self.rng.choice(self.levels[1:])) if on else 0.0
            self.left = int(self.rng.choice(self.hold_steps))
        self.left -= 1
        return self.level

    def resumed(self, draws: Draws) -> Excitation:
        """Return an excitation with other draws that continues the current level."""
        return replace(self, hold_steps=draws.hold_steps, rng=np.random.default_rng(draws.seed))


@dataclass
class LevelTrial:
    """A few steps at intermediate levels in place of full ones, so that the laws see part load.

    Each level is held for `steps` in all. Half of them are taken right after off and half right after full level: heat
    stored in water and pipes then adds as much to the one as it takes from the other. The draws of the excitation stay
    as they are.
    """

    levels: tuple[float, ...]
    steps: int
    left: int = 0
    done: int = 0

    def applied(self, drawn: float, before: float, highest: float) -> float:
        """Return the level to apply for the `drawn` one, `before` being the level applied in the last step."""
        if drawn < highest:
            self.left = 0  # a run cut short counts as done
            return drawn
        if self.left == 0:
            if self.done == 2 * len(self.levels) or before != (highest if self.done % 2 else 0.0):
                return drawn
            self.done, self.left = self.done + 1, self.steps // 2
        self.left -= 1
        return self.levels[(self.done - 1) // 2]


@dataclass(frozen=True, eq=False)
class RoomsState:
    """Where the excitation of a zone by room set-points stands: random numbers, steps left, direction and target."""

    draws: Mapping[str, Any]
    left: int
    sign: int
    target_C: float


@dataclass
class RoomExcitation:
    """Excites a zone by room set-points, equal ones for equal seeds and readings. `u_min`: level of full cooling."""

    rng: np.random.Generator
    hold_steps: tuple[int, ...]
    u_min: float
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
            return Block(self.u_min, step_s, (lower, max(target, lower + _APART_K)))
        return Block(0.0, step_s, (lower, upper))

    def state(self) -> RoomsState:
        """All that the next steps depend on."""
        return RoomsState(self.rng.bit_generator.state, self.left, self.sign, self.target_C)

    def restore(self, state: object) -> None:
        """Go on from `state`, one of rooms."""
        assert isinstance(state, RoomsState)
        self.rng = drawing(state.draws)
        self.left, self.sign, self.target_C = state.left, state.sign, state.target_C

    def withheld(self) -> None:
        """Room set-points exclude nothing, and nothing excludes them."""

    def learn(self, step: Record) -> None:
        """Nothing is learned: the plant's own loops keep the bounds."""
