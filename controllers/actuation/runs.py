"""Levels of a whole plan as machines that are on or off can carry them out, in runs that keep their limits.

Limits are minimum on and off times, and starts an hour. A machine runs while any of its actuators is on, and a
modulating one at its lowest level or above.

A plan has mean levels of its steps. Where a step does not hold a minimum on and a minimum off time, its share cannot be
made of blocks: blocks made step by step, with what they leave carried over (`Actuators.realise`), are where the search
begins. Then ends of runs are moved, runs left out and put in, and what each actuator has of them, or their level, is
changed, as long as that lowers the cost of the plan by its own statement; each try keeps the limits, also towards what
ran before. A local search: what it finds is no worse than the blocks, and need not be the best there is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.actuation.actuators import Actuators, machine_state
from thermoforce_mpc.data import HOUR_S, Array, Block

# Ends of runs are moved by these shares of the longer minimum time, and new runs put in at every one of the last. Plans
# of a day in steps of 15 min with 2 h of minimum times then take 6 s (2026-11-28).
_MOVES, _PUT_IN = (1.0, 0.5, 0.25, 0.125, 0.0625), 0.5
# What one of several actuators has of a run is changed in all of it, its halves and its quarters. By
# judgement: tried on two valves with minimum times of 2 h (`test_whole_runs.py`, 2026-11-29).
_PIECES = (1, 2, 4)
# Costs evaluated for one machine, at most (the 6 s above are of so many), and the least gain that counts, as a share
# of the cost: less is rounding of a solver.
_MOST_TRIES, _GAIN = 3000, 1e-6


def needs_runs(actuation: Actuation, step_s: float) -> bool:
    """Whether a step of `step_s` seconds does not hold the least cycle of on/off blocks."""
    return not (actuation.by_rooms or actuation.by_supply or not actuation.switches) and (
        actuation.config.least_cycle_s > step_s
    )


def machines_in_runs(actuators: Actuators, step_s: float, left: Collection[int] = ()) -> list[list[int]]:
    """Numbers of the actuators of each machine whose runs are planned as wholes; those in `left` follow no plan.

    Not so where actuators exclude one another, where they have different limits, and where a step holds a cycle.
    """
    layout, found = actuators.layout, []
    exclusive = {a for group in layout.exclusive for a in group}
    for of_machine in layout.actuators_of_machines:
        fed = [a for a in of_machine if a not in left]
        alike = len({tuple(actuators.each[a].config.model_dump().items()) for a in fed}) == 1
        if alike and exclusive.isdisjoint(fed) and needs_runs(actuators.each[fed[0]], step_s):
            found.append(fed)
    return found


def limits_not_planned(actuators: Actuators, step_s: float, left: Collection[int] = ()) -> list[str]:
    """Of which actuators minimum times and starts an hour are no part of a plan of whole runs, in words.

    `left`: numbers of those that need none, as what is set there is no level.
    """
    planned = {a for fed in machines_in_runs(actuators, step_s, left) for a in fed} | set(left)
    by_step, own, names = [], [], actuators.layout.names.actuators
    for a, actuation in enumerate(actuators.each):
        c = actuation.config
        if a in planned:
            continue
        if needs_runs(actuation, step_s):
            by_step.append(names[a])
        elif (actuation.by_supply or not actuation.switches) and (
            max(c.min_on_s, c.min_off_s, 0.5 * HOUR_S / c.starts_per_hour if c.starts_per_hour else 0.0) > step_s
        ):  # levels and pauses last a step at the least
            own.append(names[a])
    told = []
    if by_step:
        told.append(
            f"{', '.join(by_step)}: minimum on and off times and starts an hour are kept from step to step, and not "
            "planned ahead"
        )
    if own:
        told.append(
            f"{', '.join(own)}: minimum on and off times and starts an hour are kept by the machine's own control, and "
            "not planned"
        )
    return told


def in_runs(
    actuators: Actuators,
    u: Array,
    step_s: float,
    states: Sequence[ActuationState],
    left: Sequence[int],
    cost: Callable[[Array], float],
) -> Array:
    """Levels (A, N) in runs that keep minimum on and off times and starts, from planned ones, `u` (A, N).

    `states` (A,): of the machines now; `left`: numbers of actuators that do not follow the plan; `cost` of levels
    (A, N): what is to be lowered, infinite where they cannot be. Levels of actuators whose steps hold a cycle stay as
    they are. Runs are those of a machine, whichever of its actuators is on; of a modulating one, at its lowest level
    or above.
    """
    u, on = _by_blocks(actuators, u, step_s, states, left)
    for fed in machines_in_runs(actuators, step_s, left):

        def of_machine(levels: Array, fed: list[int] = fed) -> float:
            changed = u.copy()
            changed[fed] = levels
            return cost(changed)

        state = states[fed[0]] if len(fed) == 1 else machine_state([states[a] for a in fed])
        runs = _Runs.of(actuators.each[fed[0]], step_s, state, u.shape[1])
        u[fed] = runs.improved(u[fed], runs.of_blocks([on[a] for a in fed]), of_machine)
    return u


def _by_blocks(
    actuators: Actuators, u: Array, step_s: float, states: Sequence[ActuationState], left: Sequence[int]
) -> tuple[Array, list[list[tuple[Block, ...]]]]:
    """Mean levels (A, N) of the blocks that are made of `u`, step by step, and these blocks (A, N)."""
    kept = [a for a, actuation in enumerate(actuators.each) if a in left or not needs_runs(actuation, step_s)]
    out, made = u.copy(), list[list[tuple[Block, ...]]]([] for _ in actuators.each)
    for k in range(u.shape[1]):
        demands = [None if a in left else float(level) for a, level in enumerate(u[:, k])]
        acted = actuators.realise(demands, step_s, states)
        for a, blocks in enumerate(acted.blocks):
            made[a].append(blocks)
            if a not in kept:
                out[a, k] = sum((block.u[0] or 0.0) * block.duration_s for block in blocks) / step_s
        states = acted.states
    return out, made


@dataclass(frozen=True)
class _Runs:
    """On/off of a machine over `n_steps` steps of `per_step` blocks each; the least blocks `on` and `off`, and those
    now `held`.

    At most `starts` in any `hour` blocks (None: any number); `before`: how many blocks ago it started, the first first.
    `lowest`: level of a modulating machine that runs for a part of a step, and the least of all of one; None: its
    actuators are open for shares of its run, at `level`.
    """

    per_step: int
    n_steps: int
    on: int
    off: int
    running: bool
    held: float
    level: float
    lowest: float | None
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
        lowest = actuation.block_level if actuation.modulates else None
        return cls(per_step, n_steps, on, off, state.on, held, actuation.highest, lowest, *of_hour)

    def of_blocks(self, made: Sequence[Sequence[tuple[Block, ...]]]) -> NDArray[np.bool_]:
        """Whether the machine runs in each block, where its actuators have these blocks (V, N)."""
        on = np.zeros((self.n_steps, self.per_step), dtype=bool)
        for of_actuator in made:
            for k, blocks in enumerate(of_actuator):
                ends_s = np.cumsum([block.duration_s for block in blocks])
                middles_s = (np.arange(self.per_step) + 0.5) * ends_s[-1] / self.per_step
                levels = np.array([block.u[0] or 0.0 for block in blocks])
                on[k] |= levels[np.searchsorted(ends_s, middles_s)] > 0.0
        return on.ravel()

    def levels(self, on: NDArray[np.bool_], parts: Array) -> Array:
        """Mean levels (V, N) of the actuators, of which each has its part (V, N) of what the machine runs."""
        count = on.reshape(self.n_steps, self.per_step).sum(axis=1)
        if self.lowest is None:
            return np.asarray(self.level * np.rint(parts * count) / self.per_step)
        return np.where(count == self.per_step, self.level * parts, self.lowest * count / self.per_step)

    def _parts(self, levels: Array, on: NDArray[np.bool_]) -> Array:
        """Parts (V, N) by mean levels (V, N); where it stands, their mean over the plan."""
        share = on.reshape(self.n_steps, self.per_step).mean(axis=1)
        counts = share == 1.0 if self.lowest is not None else share > 0.0
        if not counts.any():
            return np.ones_like(levels)
        parts = np.clip(levels / (self.level * np.maximum(share, 1.0 / self.per_step)), self.lowest or 0.0, 1.0)
        usual = parts[:, counts].mean(axis=1)
        found = np.where(counts, parts, usual[:, None])
        if self.lowest is None:  # one of them is open for as long as the machine runs
            found /= np.maximum(found.max(axis=0), 1e-9)
        return np.asarray(found)

    def improved(self, levels: Array, on: NDArray[np.bool_], cost: Callable[[Array], float]) -> Array:
        """Levels (V, N) of the best runs found from blocks `on` with mean `levels` (V, N); these where none are."""
        if not self._keeps(on):
            return levels
        parts, tries, gained = self._parts(levels, on), 0, True
        least = cost(self.levels(on, parts))
        neighbours = (
            lambda: ((other, parts) for other in self._others(on) if self._keeps(other)),
            lambda: ((on, other) for other in self._other_parts(on, parts)),
        )
        while gained:
            gained = False
            for of_kind in neighbours:
                searching = True
                while searching:
                    searching = False
                    for other in of_kind():
                        if tries >= _MOST_TRIES:
                            break
                        tries += 1
                        costs = cost(self.levels(*other))
                        if costs < (least - _GAIN * abs(least) if math.isfinite(least) else least):
                            (on, parts), least, gained, searching = other, costs, True, True
                            break
        return self.levels(on, parts) if math.isfinite(least) else levels

    def _other_parts(self, on: NDArray[np.bool_], parts: Array) -> Iterator[Array]:
        """Neighbours of parts (V, N): those of one actuator changed in a run of the machine, or in a piece of it."""
        if self.lowest is None and len(parts) == 1:
            return
        share = on.reshape(self.n_steps, self.per_step).mean(axis=1) > 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], share, [False]]).astype(int)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            for pieces in _PIECES:
                for piece in np.array_split(np.arange(first, last), pieces):
                    for v in range(len(parts)) if piece.size else ():
                        before = parts[v, piece]
                        for part in (before * 0.0, before * 0.0 + 1.0, before - 0.25, before + 0.25):
                            other = parts.copy()
                            other[v, piece] = np.clip(part, self.lowest or 0.0, 1.0)
                            if self.lowest is None:
                                other[:, piece] /= np.maximum(other[:, piece].max(axis=0), 1e-9)
                            if self.lowest is not None or other[:, piece].any(axis=0).all():
                                yield other

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
