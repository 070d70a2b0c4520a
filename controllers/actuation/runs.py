"""Levels of a whole plan as machines that are on or off can carry them out, in runs that keep their limits.

Limits are minimum on and off times, and starts an hour.

A plan has mean levels of its steps. Where a step does not hold a minimum on and a minimum off time, its share cannot be
made of blocks: blocks made step by step, with what they leave carried over (`Actuators.realise`), are where the search
begins. Then ends of runs are moved, runs left out and put in, as long as that lowers the cost of the plan by its own
statement; each try keeps the minimum times, also towards what ran before. A local search: what it finds is no worse
than the blocks, and need not be the best there is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.actuation.actuators import Actuators
from thermoforce_mpc.data import HOUR_S, Array

# Ends of runs are moved by these shares of the longer minimum time, and new runs put in at every one of the last. Plans
# of a day in steps of 15 min with 2 h of minimum times then take 6 s (2026-11-28).
_MOVES, _PUT_IN = (1.0, 0.5, 0.25, 0.125, 0.0625), 0.5
# Costs evaluated for one actuator, at most (the 6 s above are of so many), and the least gain that counts, as a share
# of the cost: less is rounding of a solver.
_MOST_TRIES, _GAIN = 3000, 1e-6


def needs_runs(actuation: Actuation, step_s: float) -> bool:
    """Whether a step of `step_s` seconds does not hold the least cycle of on/off blocks."""
    return not (actuation.by_rooms or actuation.by_supply or not actuation.switches) and (
        actuation.config.least_cycle_s > step_s
    )


def in_runs(
    actuators: Actuators,
    u: Array,
    step_s: float,
    states: Sequence[ActuationState],
    left: Sequence[int],
    cost: Callable[[Array], float],
) -> Array:
    """Levels (A, N) in runs that keep minimum on and off times, from planned ones, `u` (A, N).

    `states` (A,): of the machines now; `left`: numbers of actuators that do not follow the plan; `cost` of levels
    (A, N): what is to be lowered. Levels of actuators whose steps hold their minimum times stay as they are.
    """
    u = _by_blocks(actuators, u, step_s, states, left)
    for a, actuation in enumerate(actuators.each):
        alone = len(actuators.layout.fed_by(actuators.layout.machine_of[a])) == 1
        exclusive = any(a in group for group in actuators.layout.exclusive)
        if a in left or not alone or exclusive or actuation.modulates or not needs_runs(actuation, step_s):
            continue

        def of_actuator(levels: Array, a: int = a) -> float:
            changed = u.copy()
            changed[a] = levels
            return cost(changed)

        u[a] = _Runs.of(actuation, step_s, states[a], u.shape[1]).improved(u[a], of_actuator)
    return u


def _by_blocks(
    actuators: Actuators, u: Array, step_s: float, states: Sequence[ActuationState], left: Sequence[int]
) -> Array:
    """Mean levels (A, N) of the blocks that are made of `u`, step by step."""
    kept = [a for a, actuation in enumerate(actuators.each) if a in left or not needs_runs(actuation, step_s)]
    out = u.copy()
    for k in range(u.shape[1]):
        demands = [None if a in left else float(level) for a, level in enumerate(u[:, k])]
        acted = actuators.realise(demands, step_s, states)
        for a, blocks in enumerate(acted.blocks):
            if a not in kept:
                out[a, k] = sum((block.u[0] or 0.0) * block.duration_s for block in blocks) / step_s
        states = acted.states
    return out


@dataclass(frozen=True)
class _Runs:
    """On/off over `n_steps` steps of `per_step` blocks each; the least blocks `on` and `off`, and those now `held`.

    At most `starts` in any `hour` blocks (None: any number); `before`: how many blocks ago it started, the first first.
    """

    per_step: int
    n_steps: int
    on: int
    off: int
    running: bool
    held: float
    level: float
    starts: int | None
    hour: float
    before: tuple[float, ...]

    @classmethod
    def of(cls, actuation: Actuation, step_s: float, state: ActuationState, n_steps: int) -> _Runs:
        c = actuation.config
        per_step = max(1, math.floor(step_s / c.block_s + 1e-6))
        block_s = step_s / per_step
        on, off = (max(1, math.ceil(least_s / block_s - 1e-6)) for least_s in (c.min_on_s, c.min_off_s))
        held, before = state.held_s / block_s + 1e-6, tuple(age_s / block_s for age_s in reversed(state.starts_s))
        of_hour = c.starts_per_hour, HOUR_S / block_s - 1e-6, before
        return cls(per_step, n_steps, on, off, state.on, held, actuation.block_level, *of_hour)

    def levels(self, on: NDArray[np.bool_]) -> Array:
        """Mean levels of the steps (N,)."""
        return np.asarray(self.level * on.reshape(self.n_steps, self.per_step).mean(axis=1))

    def improved(self, levels: Array, cost: Callable[[Array], float]) -> Array:
        """Levels (N,) of runs no dearer than the blocks of `levels` (N,), or these where they cannot be told apart."""
        on = self._as_blocks(levels)
        if not self._keeps(on):
            return levels
        least, tries, gained = cost(self.levels(on)), 0, True
        while gained and tries < _MOST_TRIES:
            gained = False
            for other in self._others(on):
                if tries >= _MOST_TRIES:
                    break
                if not self._keeps(other):
                    continue
                tries += 1
                costs = cost(self.levels(other))
                if costs < least - _GAIN * abs(least):
                    on, least, gained = other, costs, True
                    break
        return self.levels(on)

    def _as_blocks(self, levels: Array) -> NDArray[np.bool_]:
        """On or off in each block: one that runs goes on at first, one that stands begins as late as it can."""
        counts = np.rint(levels / self.level * self.per_step).astype(int)
        on, runs = np.zeros((self.n_steps, self.per_step), dtype=bool), self.running
        for k, count in enumerate(counts):
            if runs:
                on[k, :count] = True
            else:
                on[k, self.per_step - count :] = True
            runs = bool(on[k, -1])
        return on.ravel()

    def _keeps(self, on: NDArray[np.bool_]) -> bool:
        """Whether every run keeps the minimum times, the last one goes on beyond the plan, and starts their number."""
        ends = np.flatnonzero(np.diff(on)) + 1
        starts = np.concatenate([[0], ends])
        lengths = np.diff(np.append(starts, on.size)).astype(float)
        if on[0] == self.running:
            lengths[0] += self.held
        elif self.held < (self.on if self.running else self.off):
            return False
        least = np.where(on[starts], self.on, self.off)
        if not (lengths[:-1] >= least[:-1]).all():
            return False
        if self.starts is None:
            return True
        begun = [
            *(-ago for ago in self.before),
            *(start for start in starts if on[start] and (start or not self.running)),
        ]
        return all(later - first >= self.hour for first, later in zip(begun, begun[self.starts :], strict=False))

    def _others(self, on: NDArray[np.bool_]) -> Iterator[NDArray[np.bool_]]:
        """Neighbours of a sequence: ends of runs moved, runs left out, and runs put in."""
        longest, n = max(self.on, self.off), on.size
        sizes = list(dict.fromkeys(max(1, round(share * longest)) for share in _MOVES))
        ends = (np.flatnonzero(np.diff(on)) + 1).tolist()
        edges = [0, *ends, n]

        def flipped(first: int, last: int) -> NDArray[np.bool_]:
            other = on.copy()
            other[first:last] = ~other[first:last]
            return other

        def put(first: int, last: int, value: bool) -> NDArray[np.bool_]:
            other = on.copy()
            other[first:last] = value
            return other

        for size in sizes:
            for end in ends:
                yield put(max(end - size, 0), end, bool(on[end]))
                yield put(end, min(end + size, n), bool(on[end - 1]))
        for first, last in pairwise(edges):
            yield flipped(first, last)
        for size in sizes:  # a run as a whole, earlier or later
            for first, last in pairwise(ends):
                for by in (-size, size):
                    if first + by >= 0 and last + by <= n:
                        other, value = on.copy(), bool(on[first])
                        other[first:last] = not value
                        other[first + by : last + by] = value
                        yield other
        for first in range(0, n, max(1, round(_PUT_IN * longest))):
            yield put(first, min(first + self.on, n), True)
            yield put(first, min(first + self.off, n), False)


def without_owed(actuators: Actuators, states: Sequence[ActuationState], step_s: float) -> tuple[ActuationState, ...]:
    """States (A,) of machines whose runs are planned as wholes: nothing is carried over from one step to the next."""
    return tuple(
        replace(state, owed_s=0.0) if needs_runs(actuation, step_s) else state
        for actuation, state in zip(actuators.each, states, strict=True)
    )
