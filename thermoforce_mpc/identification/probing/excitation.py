"""Random excitation for probing: random levels held for random times, biased to keep the temperature in its band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

EXCURSION_K = 1.5
"""Distance from the centre of the excursions at which the machine is on, or off, K."""
# Change of the probability of on per K from the centre, 1/K, and least probability of on (and of off).
_LEAN_PER_K, _LEAST_SHARE = 0.35, 0.05


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
