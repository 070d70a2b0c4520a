"""`python -m benchmarks.commands.known`: what an offset of the heating curve can save in a drawn house that is known.

The house of `bench commands` itself is lived through with one day of offsets again and again. From a few rules of price
the offsets of parts of the day are changed, each to the least, none or the most, and kept where that is cheaper and no
room is colder. What the best day saves is told of other thermostats than those that it was chosen with, with the days
after it and its standard error: no plan by a model can be expected to save more.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import click
import numpy as np

from benchmarks.commands.bench import ROOMS, Home, left_alone_C, left_alone_cost, priced
from thermoforce_mpc.data import HOUR_S, Array

_DAYS, _PART_H = 3, 3
# Thermostats that differ by so much, K, as their sensors do; seed and number of those that a day is chosen with, and of
# those that it is judged by.
_APART_K, _THERMOSTATS = 0.1, ((1, 3), (2, 8))
# K·h in all rooms that may be missing more than left alone, and what one more costs, currency: more than heat does.
_MORE_KH, _PER_KH = 0.1, 2.0
# Hours of the price's two peaks, of the noon and of the night between them.
_DEAR, _NOON, _NIGHT = (7, 8, 9, 17, 18, 19, 20), (11, 12, 13, 14, 15), (2, 3, 4, 5)


@dataclass(frozen=True)
class Days:
    """What days cost with those after them, of it the days, currency, and what rooms lack to their bounds, K·h."""

    cost: float
    of_days: float
    below_Kh: float

    @classmethod
    def mean(cls, each: Sequence[Days]) -> Days:
        """Of houses whose thermostats differ."""
        return cls(*np.mean([(one.cost, one.of_days, one.below_Kh) for one in each], axis=0).tolist())

    def beside(self, alone: Days) -> float:
        """Cost with what rooms lack more than `alone`."""
        return self.cost + _PER_KH * max(self.below_Kh - alone.below_Kh - _MORE_KH, 0.0)


def rules(most_K: float) -> list[Array]:
    """Offsets of a day (24,) by the price alone: none, less while it is dear, more while it is cheap, both, more."""

    def day(less: Sequence[int] = (), more: Sequence[int] = ()) -> Array:
        out = np.zeros(24)
        out[list(less)], out[list(more)] = -most_K, most_K
        return out

    both = [day(_DEAR, _NOON), day(_DEAR, (*_NOON, *_NIGHT)), day(_DEAR[3:], _NOON)]
    return [day(), day(_DEAR), day((), _NOON), *both, day((), range(24))]


def best_day(cost: Callable[[Array], float], most_K: float, seed: int = 0) -> Array:
    """Offsets of a day (24,), none beyond `most_K`, that cost little: the best rule, then part by part in any order."""
    tried = [(cost(one), one) for one in rules(most_K)]
    least, best = min(tried, key=lambda one: one[0])
    for part in np.random.default_rng(seed).permutation(24 // _PART_H):
        for value in (-most_K, 0.0, most_K):
            other = best.copy()
            other[part * _PART_H : (part + 1) * _PART_H] = value
            if not np.array_equal(other, best) and (found := cost(other)) < least:
                least, best = found, other
    return best


def lived(home: Home, day: Array, kept_C: Array, dials_K: Array) -> Days:
    """Days of `home` with the offsets of a `day` (24,) in each; no room must be warmer than `kept_C`, see the bench."""
    home = copy.deepcopy(home)
    home.dials_K = dials_K
    ahead = priced(home.plant.forecast(_DAYS * 24 * HOUR_S, HOUR_S))
    kept_C = kept_C[:, : ahead.time_s.size - 1]
    lower_C = np.minimum(ahead.lower_C, np.column_stack([kept_C[:, :1], kept_C]))
    cost = below_Kh = 0.0
    for k, offset in enumerate(np.tile(day, _DAYS).tolist()):
        done = home.advance((offset or None,) * ROOMS, HOUR_S)
        cost += float(done.power_W[0]) / 1000.0 * float(ahead.price_per_kWh[0, k])
        below_Kh += float(np.maximum(lower_C[:, k : k + 2].min(axis=1) - done.T_zone_C, 0.0).sum())
    return Days(cost + left_alone_cost(home), cost, below_Kh)


def known(seed: int, most_K: float) -> str:
    """One house in a line: what its best day saves, in % of what it costs left alone, and that day."""
    home = Home(seed, "curve offset")
    home.live(seed)
    kept_C = left_alone_C(copy.deepcopy(home), _DAYS)
    choosing, judging = (np.random.default_rng(k).normal(0.0, _APART_K, (n, ROOMS)) for k, n in _THERMOSTATS)

    def each(day: Array, thermostats: Array) -> list[Days]:
        return [lived(home, day, kept_C, dials_K) for dials_K in thermostats]

    chosen_alone = Days.mean(each(np.zeros(24), choosing))
    best = best_day(lambda day: Days.mean(each(day, choosing)).beside(chosen_alone), most_K)
    alone, with_day = each(np.zeros(24), judging), each(best, judging)
    saved = np.array([left.cost - other.cost for left, other in zip(alone, with_day, strict=True)])
    saved *= 100.0 / Days.mean(alone).of_days
    colder_Kh = Days.mean(with_day).below_Kh - Days.mean(alone).below_Kh
    day = " ".join(f"{offset:+g}" for offset in best)
    error = saved.std(ddof=1) / np.sqrt(saved.size)
    return f"{home.plant.house.name}: saves {saved.mean():.1f} ± {error:.1f} %, {colder_Kh:+.2f} K·h, with {day}"


@click.command()
@click.option("--seed", default=9961, show_default=True, help="seed of the first house")
@click.option("--houses", default=4, show_default=True, type=click.IntRange(1))
@click.option("--most", "most_K", default=3.0, show_default=True, type=click.FloatRange(0, min_open=True), help="K")
def main(seed: int, houses: int, most_K: float) -> None:
    """What the best offsets of a day save in houses that are known, half a minute of a core each."""
    for k in range(houses):
        click.echo(known(seed + k, most_K))


if __name__ == "__main__":
    main()
