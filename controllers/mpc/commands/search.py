"""Search for commands: other values for some hours, kept where the plan's own cost is lower with them.

Levels of a plan say what is wanted, not which command a building's loop answers it with: between two set-points half a
kelvin apart a thermostat gives nothing or everything, and one command may act on several rooms. So the commands that
follow levels are where the search begins. In each round windows of commands are tried, some anywhere and some at the
runs that stand, the building is followed under all of them at once, and the best that stand apart are taken together.

How many are tried depends neither on the steps of a plan nor on how far its limits are: what is allowed beside more is
found as well as before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from controllers.actuation.commands import CommandState
from thermoforce_mpc.commands.command import SAME, Command
from thermoforce_mpc.data import HOUR_S, Array, steps_in

# Windows tried in a round one by one, those of them at runs at most, pairs of two, and shares of these that move a run
# and that trade a window for another. With these and what follows, first plans of `bench commands` for seeds that they
# were not chosen on (2026-11-30) cost 3.344 and 7.456 (8701, set-points, 24 and 48 h; 3.371 and 7.827 with windows
# drawn anywhere, fewer of longer plans), 7.123 (48 h at 15 min; 7.564), 4.558 and 9.739 (9773, SG-Ready; 4.605 and
# 9.788), 5.914 and 11.483 (8703, offset; 5.931 and 11.475).
_WINDOWS, _AT_RUNS, _PAIRS, _MOVED, _TRADED = 112, 34, 64, 0.3, 0.5
# Rounds, those in a row that gain less than this share of all before, which end it, and windows taken together; chosen
# on seeds 9756, 9759, 9776 and 9777 of `bench commands`, as what follows.
_ROUNDS, _PATIENCE, _GAIN, _TOGETHER = 12, 3, 0.01, 24
# Steps of plans that are followed in all rounds, and rounds at least, so that a long plan takes seconds; `bench
# commands` as above.
_STEPS, _FEWEST = 960, 5
# Lengths of windows, h: from the shortest that a loop answers to a day. Without 12 and 24 h plans of 48 h at 15 min for
# seed 9777 of `bench commands` were .7 and 1.0 % dearer.
_WINDOW_H = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 24.0)
# Share of windows with a value that stands beside them; next commands that are tried for a run, parts by which an end
# of it is moved; `bench commands` as above.
_BESIDE, _NEXT, _BY = 0.4, 2, (1, 2, 4, 8)
# Of other windows so many are at most so many commands from what stands, the others anywhere within the limits: else
# wider limits would take windows from what is near (`test_wider_limits_of_a_long_plan_make_it_no_dearer`).
_NEAR, _OF_NEAR = 2, 0.8
_SEED = 64


@dataclass(frozen=True, eq=False)
class Knob:
    """A command over the N steps of a plan, each of `parts` parts of `part_s` s, at whose beginnings it may change.

    `low`, `high` (N,): limits; `state`: what is set now.
    """

    command: Command
    low: Array
    high: Array
    state: CommandState
    parts: int
    part_s: float

    def keeps(self, row: Array) -> bool:
        """Whether commands of all parts (P,) keep hold, longest time and fastest change, from what is set now on."""
        command, hold_s = self.command, 60.0 * self.command.hold_min
        value, held_s = self.state.value, self.state.held_s
        bounds = _bounds_of_runs(row)
        for begin, end in pairwise(bounds):
            to = float(row[begin])
            if abs(to - value) > SAME:
                inside = self.low[0] - SAME <= value <= self.high[0] + SAME
                must_leave = begin == 0 and not (command.allows(value) and inside)
                may_go_on = held_s + self.part_s <= command.longest_s(value) + SAME
                if held_s < hold_s - SAME and may_go_on and not must_leave:
                    return False
                if abs(to - value) > command.most_change(held_s) + SAME and not must_leave:
                    return False
                value, held_s = to, 0.0
            held_s += (end - begin) * self.part_s
            if held_s > command.longest_s(value) + SAME:
                return False
        return True

    def outside(self, row: Array) -> int:
        """Parts in which commands (P,) lie outside their limits."""
        low, high = self._limits
        return int(((row < low) | (row > high)).sum())

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        return np.repeat(self.low, self.parts) - SAME, np.repeat(self.high, self.parts) + SAME

    @cached_property
    def grids(self) -> list[Array]:
        """What can be set in each step."""
        return [self.command.values(*ends) for ends in zip(self.low.tolist(), self.high.tolist(), strict=True)]

    def ends(self) -> tuple[float, float] | None:
        """Least and largest command of the first step; None while what is set must be held."""
        if self.state.held_s < 60.0 * self.command.hold_min - SAME:
            return None
        near = self.command.values(float(self.low[0]), float(self.high[0]))
        near = near[np.abs(near - self.state.value) <= self.command.most_change(self.state.held_s) + SAME]
        long_enough = [self.command.longest_s(float(value)) >= self.parts * self.part_s for value in near]
        near = near[np.array(long_enough, dtype=bool)]
        return (float(near[0]), float(near[-1])) if near.size else None

    def after(self, row: Array) -> CommandState:
        """What is set after the first step of commands (P,)."""
        value, held_s = self.state.value, self.state.held_s
        for to in row[: self.parts].tolist():
            value, held_s = to, (held_s if abs(to - value) <= SAME else 0.0) + self.part_s
        return CommandState(value, held_s)


@dataclass(frozen=True)
class _Window:
    knob: int
    begin: int
    end: int
    value: float

    def beside(self, other: _Window) -> bool:
        """Whether both can stand: no part of a command is in both."""
        return self.knob != other.knob or self.end <= other.begin or other.end <= self.begin


_Move = tuple[_Window, ...]
"""Windows that are put in place together."""


def better_commands(
    knobs: Sequence[Knob], starts: Sequence[Array], cost: Callable[[Array], Array]
) -> tuple[Array, float]:
    """Commands (K, P) that cost no more than any of `starts`, (K, P) each, and what they cost.

    `cost`: of S commands (S, K, P), (S,). The same arguments give the same commands.
    """
    rng = np.random.default_rng(_SEED)
    costs = cost(np.stack(starts))
    rows, first, waited = starts[int(np.argmin(costs))], float(costs.min()), 0
    least = first
    for _ in range(min(_ROUNDS, max(_FEWEST, _STEPS // knobs[0].low.size))):
        moves = _moves(rng, knobs, rows)
        if not moves:
            break
        tried = [_in_place(move, rows) for move in moves]
        costs = cost(np.stack(tried))
        order = [int(i) for i in np.argsort(costs, kind="stable")[: 2 * _TOGETHER] if costs[i] < least]
        if joined := _joined(knobs, rows, [moves[i] for i in order]):
            tried += joined
            costs = np.append(costs, cost(np.stack(joined)))
        best = int(np.argmin(costs))
        gain = least - float(costs[best])
        waited = 0 if gain > max(_GAIN * (first - least), 1e-9 * abs(least)) else waited + 1
        if gain > 1e-9 * abs(least):
            rows, least = tried[best], float(costs[best])
        if waited == _PATIENCE:
            break
    return rows, least


def _in_place(move: _Move, rows: Array) -> Array:
    out = rows.copy()
    for window in move:
        out[window.knob, window.begin : window.end] = window.value
    return out


def _fits(knobs: Sequence[Knob], rows: Array, move: _Move) -> bool:
    """Whether a move changes commands `rows` (K, P), and they keep what a command must with it."""
    changed = _in_place(move, rows)
    return all(knobs[window.knob].command.allows(window.value) for window in move) and all(
        not np.array_equal(changed[i], rows[i])
        and knobs[i].outside(changed[i]) <= knobs[i].outside(rows[i])
        and knobs[i].keeps(changed[i])
        for i in {window.knob for window in move}
    )


def _moves(rng: np.random.Generator, knobs: Sequence[Knob], rows: Array) -> list[_Move]:
    """Windows, two of them, and what gives heat earlier or later: runs that are, and as much less as there is more."""
    windows = _windows(rng, knobs, rows)
    moves: list[_Move] = [(window,) for window in windows]
    for _ in range(_PAIRS if windows else 0):
        how, one, other = rng.random(), *(windows[j] for j in rng.integers(len(windows), size=2))
        pair: _Move = ()
        if how < _MOVED:
            pair = _run_moved(rng, rows)
        elif how < _MOVED + _TRADED:
            pair = _traded(rng, knobs[one.knob], rows, one)
        pair = pair or (one, other)
        if pair[0].knob != pair[1].knob or _fits(knobs, rows, pair):
            moves.append(pair)
    return moves


def _windows(rng: np.random.Generator, knobs: Sequence[Knob], rows: Array) -> list[_Window]:
    """Windows that keep what a command must in commands `rows` (K, P)."""
    out: dict[_Window, None] = {}
    at_runs = [window for i, knob in enumerate(knobs) for window in _at_runs(i, knob, rows[i])]
    # More windows near the beginning: later ones are planned again before they come.
    near = np.array([1.0 / np.sqrt(window.begin / rows.shape[1] + 0.02) for window in at_runs])
    for j in rng.choice(near.size, near.size, replace=False, p=near / near.sum()) if at_runs else ():
        if _fits(knobs, rows, (at_runs[j],)):
            out[at_runs[j]] = None
        if len(out) == _AT_RUNS:
            break
    for _ in range(4 * _WINDOWS):
        i = int(rng.integers(len(knobs)))
        window = _anywhere(rng, i, knobs[i], rows[i])
        if window is not None and window not in out and _fits(knobs, rows, (window,)):
            out[window] = None
        if len(out) == _WINDOWS:
            break
    return list(out)


def _anywhere(rng: np.random.Generator, i: int, knob: Knob, row: Array) -> _Window | None:
    """A window of commands (P,) of knob `i`: a value beside it, or one that is near as likely as far."""
    P = row.size
    begin = int(P * rng.random() ** 2)
    end = min(P, begin + steps_in(float(rng.choice(_WINDOW_H)) * HOUR_S, knob.part_s))
    if rng.random() < _BESIDE:
        return _Window(i, begin, end, float((row[max(begin - 1, 0)], row[end % P], knob.state.value)[rng.integers(3)]))
    grid = knob.grids[begin // knob.parts]
    # Wider limits take little from what is near.
    away = rng.integers(min(_NEAR, grid.size) if rng.random() < _OF_NEAR else max(grid.size - 1, 1)) + 1
    to = int(np.argmin(np.abs(grid - row[begin]))) + int(rng.choice((-away, away)))
    return _Window(i, begin, end, float(grid[to])) if 0 <= to < grid.size else None


def _traded(rng: np.random.Generator, knob: Knob, rows: Array, window: _Window) -> _Move:
    """A window and one as long elsewhere, by as much less as that is more; nothing where none is."""
    P, long = rows.shape[1], window.end - window.begin
    begin = int(rng.integers(P - long + 1))
    grid, now = knob.grids[begin // knob.parts], rows[window.knob, [begin, window.begin]]
    to = int(np.argmin(np.abs(grid - (now[0] + now[1] - window.value))))
    other = _Window(window.knob, begin, begin + long, float(grid[to]))
    return (window, other) if other.beside(window) and abs(other.value - now[0]) > SAME else ()


def _at_runs(i: int, knob: Knob, row: Array) -> Iterator[_Window]:
    """Runs of commands (P,) of knob `i` with another value, or that begin earlier or later."""
    bounds = _bounds_of_runs(row)
    for k, (begin, end) in enumerate(pairwise(bounds)):
        value, grid = float(row[begin]), knob.grids[begin // knob.parts]
        below, above = grid[grid < value - SAME][-_NEXT:], grid[grid > value + SAME][:_NEXT]
        for other in {*below.tolist(), *above.tolist(), float(row[begin - 1]), float(row[end % row.size])} - {value}:
            yield _Window(i, begin, end, other)
        for by in _BY if begin else ():
            if begin + by < end:
                yield _Window(i, begin, begin + by, float(row[begin - 1]))
            if begin - by >= bounds[k - 1]:
                yield _Window(i, begin - by, begin, value)


def _run_moved(rng: np.random.Generator, rows: Array) -> _Move:
    """A run of commands (K, P) between two others, earlier or later; nothing where there is none or no room for it."""
    i = int(rng.integers(len(rows)))
    bounds = _bounds_of_runs(rows[i])
    if len(bounds) < 4:
        return ()
    k = int(rng.integers(1, len(bounds) - 2))
    (before, begin, end, after), by = bounds[k - 1 : k + 3], int(rng.choice(_BY))
    earlier, value, later = (float(rows[i, at]) for at in (begin - 1, begin, end))
    if rng.random() < 0.5 and end + by <= after:
        return _Window(i, begin, min(begin + by, end), earlier), _Window(i, max(end, begin + by), end + by, value)
    if begin - by >= before:
        return _Window(i, begin - by, min(begin, end - by), value), _Window(i, max(end - by, begin), end, later)
    return ()


def _bounds_of_runs(row: Array) -> list[int]:
    """Where runs of the same command (P,) begin, and P."""
    return [0, *(np.flatnonzero(row[1:] != row[:-1]) + 1).tolist(), row.size]


def _joined(knobs: Sequence[Knob], rows: Array, moves: Sequence[_Move]) -> list[Array]:
    """Commands with the first two moves, the first three, and on, of those that may stand together; fewer of many."""
    out: list[Array] = []
    taken: list[_Window] = []
    together = rows
    for move in moves:
        both = _in_place(move, together)
        apart = all(window.beside(other) for window in move for other in taken)
        if apart and all(knobs[window.knob].keeps(both[window.knob]) for window in move):
            together = both
            taken += move
            out.append(together)
        if len(out) == _TOGETHER:
            break
    sizes = {2, 3, 4, 6, 8, 12, 16, len(out)}
    return [found for n, found in enumerate(out, 1) if n > 1 and n in sizes]
