"""The law by which levels are drawn while probing: random, held for random times, leaning against the temperature."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

# Share of time that a draw is on (off) however far the temperature is to one side of the centre, inside the limits.
_LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Law:
    """How levels are drawn. Fields as in `ProbingConfig`; `hold_steps` are the holding times to draw from."""

    levels: tuple[float, ...]
    hold_steps: tuple[int, ...]
    lean_per_K: float
    below_K: float
    above_K: float


@dataclass
class Excitation:
    """Draws one level after another; equal seeds and temperatures give equal levels.

    `level` is held for `left` more steps; both are handed on from one excitation to the next by `resumed`.
    """

    law: Law
    rng: np.random.Generator
    level: float = 0.0
    left: int = field(default=0)

    def next(self, need_K: float) -> float:
        """Level of the next step, where the zone is `need_K` K on the side that needs the machine (negative: not).

        Beyond the limits comfort decides: on at the highest level, or off.
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
        """Another law and seed from where this one is."""
        return Excitation(law, np.random.default_rng(seed), self.level, self.left)
