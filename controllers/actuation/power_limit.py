"""What a limit of power leaves for actuators whose plan becomes blocks.

Blocks are whole, and carry on-time over from step to step: a step may take more than its plan gave it. Where power has
a cap or a peak has a price, actuators become blocks one after another, each within what those before it and the plans
of those to come leave. The power of levels is the one that plans count with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from thermoforce_mpc.data import Array, Names

# Power nearer than this to a limit is at it, W; levels of that distance, and of the search.
_SAME_W, _SAME_LEVEL = 1.0, 1e-6


@dataclass(frozen=True)
class PowerLimit:
    """How much all machines may take together, mean over one step.

    `cap_W`: infinite without a cap; blocks exceed it only as far as the plan does. `peak_W`: highest power that is free
    or planned, infinite where peaks are; blocks are rounded to it. `planned` (A,): levels of the plan; `power_W`:
    power, W, of mean levels (A,); `exempt`: numbers of the actuators of which something else than the plan decides.
    """

    cap_W: float
    peak_W: float
    planned: Array
    power_W: Callable[[Array], float]
    exempt: frozenset[int] = frozenset()

    @cached_property
    def within_W(self) -> float:
        """The cap, or what the plan takes where it pays for more, W."""
        return self.cap_W if math.isinf(self.cap_W) else max(self.cap_W, self.power_W(self.planned))

    def without(self, actuators: Collection[int]) -> PowerLimit:
        """The same where something else decides of `actuators`."""
        return replace(self, exempt=frozenset(actuators))


class PowerRoom:
    """What is left of a limit while actuators become blocks, one after another; without a limit, everything."""

    def __init__(self, limit: PowerLimit | None) -> None:
        self._limit, self._levels = limit, np.zeros(0) if limit is None else limit.planned.copy()
        self._forced: list[int] = []

    def limits(self, a: int) -> bool:
        """Whether actuator `a` is to stay within the limit."""
        return self._limit is not None and a not in self._limit.exempt

    def most(self, a: int, half_block: float) -> float:
        """Highest mean level that actuator `a` may have; `half_block`: by which a level is rounded up at a peak."""
        if self._limit is None or not self.limits(a):
            return math.inf
        within, peak = (self._level_at(a, self._limit.power_W, W) for W in (self._limit.within_W, self._limit.peak_W))
        return min(within, peak + half_block)

    def take(self, a: int, level: float | None, most: float = math.inf) -> None:
        """Count the mean `level` of actuator `a`, which had `most`; None, native control, counts as planned."""
        if self._limit is None or level is None:
            return
        self._levels[a] = level
        if level > most + _SAME_LEVEL:
            self._forced.append(a)

    def over_in_words(self, names: Names) -> str:
        """What takes the step above the limit, or ''."""
        limit = self._limit
        if limit is None:
            return ""
        takes_W = limit.power_W(self._levels)
        takes, most_W = f"this step takes {takes_W / 1000.0:.2f} kW", min(limit.within_W, limit.peak_W)
        if self._forced and takes_W > most_W + _SAME_W:
            which = ", ".join(names.actuators[a] for a in self._forced)
            return f"{takes} where {most_W / 1000.0:.2f} kW are planned at most: minimum on time of {which}"
        if takes_W > limit.cap_W + _SAME_W:
            return f"{takes}, above the cap of {limit.cap_W / 1000.0:g} kW: comfort is worth its price"
        return ""

    def _level_at(self, a: int, power_W: Callable[[Array], float], limit_W: float) -> float:
        """Level of actuator `a` at which all machines take `limit_W`; infinite where they do not take as much."""
        levels = self._levels.copy()

        def excess_W(level: float) -> float:
            levels[a] = level
            return power_W(levels) - limit_W

        if math.isinf(limit_W) or excess_W(1.0) <= _SAME_W:
            return math.inf
        return 0.0 if excess_W(0.0) >= 0.0 else float(brentq(excess_W, 0.0, 1.0, xtol=_SAME_LEVEL))
