"""When episodes begin and how long they last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from thermoforce_mpc.data import DAY_S, YEAR_S, Array
from thermoforce_mpc.errors import ConfigError


@dataclass(frozen=True)
class Episodes:
    """Length and start of episodes, s; times count from 1 January.

    `start_time` is the start of every episode unless `random_start_time`: then it is any whole number of steps after 1
    January for which the episode, with `behind` before it and `ahead` after it, lies in the year and overlaps none of
    `excluding_periods`. An episode may touch an excluded period. `warmup_period` under native control comes before it.

    Raises:
        ConfigError: a length is out of range, or no start is possible; names the argument.
    """

    step_period: float = 900.0
    max_episode_length: float = 7 * DAY_S
    warmup_period: float = DAY_S
    start_time: float = 0.0
    random_start_time: bool = False
    excluding_periods: Sequence[tuple[float, float]] | None = None
    ahead: float = 0.0
    behind: float = 0.0

    def __post_init__(self) -> None:
        least = {"step_period": 30.0, "max_episode_length": self.step_period, "warmup_period": 0.0, "start_time": 0.0}
        for name, low in least.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value < YEAR_S):
                raise ConfigError(f"{name}: {value!r} s: expected {low:g} s or more, less than a year")
        # Their limits are the view's, which knows what it observes; here they only have to be numbers.
        for name, value in (("predictive_period", self.ahead), ("regressive_period", self.behind)):
            if not np.isfinite(value):
                raise ConfigError(f"{name}: {value!r} s: expected a finite number")
        for pair in self.excluding_periods or ():
            if not (np.shape(pair) == (2,) and _number(pair[0]) and _number(pair[1]) and pair[0] < pair[1]):
                raise ConfigError(
                    f"excluding_periods: {pair!r}: expected pairs of begin and later end, s since 1 January; a period "
                    "over New Year is two of them"
                )
        if self.random_start_time and not self.possible_starts.size:
            raise ConfigError(
                "excluding_periods: with random_start_time no episode of "
                f"{self.max_episode_length / DAY_S:g} days fits into the rest of the year"
            )

    @cached_property
    def possible_starts(self) -> Array:
        """Every start that `random_start_time` may draw (n,), s."""
        last = YEAR_S - self.max_episode_length - self.ahead
        starts = np.arange(np.ceil(self.behind / self.step_period), last / self.step_period + 1e-9) * self.step_period
        free = np.ones(starts.size, dtype=bool)
        for first, final in self.excluding_periods or ():
            free &= (starts + self.max_episode_length <= first) | (starts >= final)
        return np.asarray(starts[free])

    def start_s(self, rng: np.random.Generator) -> float:
        """Start of the next episode, s; draws from `rng` only with `random_start_time`."""
        return float(rng.choice(self.possible_starts)) if self.random_start_time else float(self.start_time)


def _number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and bool(np.isfinite(value))
