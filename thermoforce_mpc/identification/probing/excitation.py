"""Random excitation for probing: random levels held for random times, biased to keep the temperature in its band."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

# Least probability of on (and of off) inside the temperature limits.
_LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Law:
    """Parameters of the draws. Fields as in `ProbingConfig`; `hold_steps` are the holding times to draw from."""

    levels: tuple[float, ...]
    hold_steps: tuple[int, ...]
    lean_per_K: float
    below_K: float
    above_K: float


@dataclass
class Excitation:
    """Generator of levels; equal seeds and temperatures give equal levels.

    `level` is held for `left` more steps; `resumed` passes both on to the next excitation.
    """

    law: Law
    rng: np.random.Generator
    level: float = 0.0
    left: int = field(default=0)

    def next(self, need_K: float) -> float:
        """Return the level of the next step; `need_K` is centre − T for heating, T − centre for cooling, K.

        Beyond `below_K` the level is the highest, beyond `above_K` on the other side it is 0.
        """
        law = self.law
        if need_K > law.below_K:
            self.level, self.left = max(law.levels), 1
        elif need_K < -law.above_K:
            self.level, self.left = 0.0, 1
        elif self.left == 0:
            on = self.rng.random() < np.clip(0.5 + law.lean_per_K * need_K, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
            self.level = float(self.rng.choice(law.levels[1:])) if on else 0.0
            self.left = int(self.rng.choice(law.hold_steps))
        self.left -= 1
        return self.level

    def resumed(self, law: Law, seed: tuple[int, ...]) -> Excitation:
        """Return an excitation with another law and seed that continues the current level."""
        return Excitation(law, np.random.default_rng(seed), self.level, self.left)


@dataclass
class LevelTrial:
    """A few steps at intermediate levels in place of full ones, so that the laws see part load.

    Each level is held for `steps` in all. Half of them are taken right after off and half right after full level: heat
    stored in water and pipes then adds as much to the one as it takes from the other. The draws of the excitation stay
    as they are.
    """

    levels: tuple[float, ...]
    steps: int
    left: int = field(default=0)
    done: int = field(default=0)

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
