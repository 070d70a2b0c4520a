"""Search for commands: other values for some hours, kept where the plan's own cost is lower with them.

Levels of a plan say what is wanted, not which command a building's loop answers it with: between two set-points half a
kelvin apart a thermostat gives nothing or everything, and one command may act on several rooms. So the commands that
follow levels are where the search begins. In each round windows of commands are drawn anew, the building is followed
under all of them at once, and the best are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from controllers.actuation.commands import CommandState
from thermoforce_mpc.commands.command import SAME, Command
from thermoforce_mpc.data import Array

# Windows drawn in a round, rounds, those in a row without a better plan that end it, and windows taken together. First
# plans of `bench commands` for seeds 100 and 101 (2026-11-28) cost 2.048 and 3.474 with 24 windows a round, 1.970 and
# 3.358 with 96, 1.993 and 3.343 with 192.
_DRAWN, _ROUNDS, _PATIENCE, _TOGETHER = 96, 14, 3, 8
# Steps of a plan up to which so many are drawn; fewer of longer ones, so that a plan takes seconds.
_LONG = 48
# Lengths of windows that are drawn, h: from the shortest that a loop answers to a night's setback, by judgement.
_WINDOW_H = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
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
        value, held_s, at = self.state.value, self.state.held_s, 0
        for to, same in groupby(row.tolist()):
            n = len(list(same))
            if abs(to - value) > SAME:
                inside = self.low[0] - SAME <= value <= self.high[0] + SAME
                must_leave = at == 0 and not (command.allows(value) and inside)
                may_go_on = held_s + self.part_s <= command.longest_s(value) + SAME
                if held_s < hold_s - SAME and may_go_on and not must_leave:
                    return False
                if abs(to - value) > command.most_change(held_s) + SAME and not must_leave:
                    return False
                value, held_s = to, 0.0
            held_s += n * self.part_s
            if held_s > command.longest_s(value) + SAME:
                return False
            at += n
        return True

    def outside(self, row: Array) -> int:
        """Parts in which commands (P,) lie outside their limits."""
        low, high = np.repeat(self.low, self.parts), np.repeat(self.high, self.parts)
        return int(((row < low - SAME) | (row > high + SAME)).sum())

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

    def in_place(self, rows: Array) -> Array:
        out = rows.copy()
        out[self.knob, self.begin : self.end] = self.value
        return out


def better_commands(
    knobs: Sequence[Knob], starts: Sequence[Array], cost: Callable[[Array], Array]
) -> tuple[Array, float]:
    """Commands (K, P) that cost no more than any of `starts`, (K, P) each, and what they cost.

    `cost`: of S commands (S, K, P), (S,). The same arguments give the same commands.
    """
    rng = np.random.default_rng(_SEED)
    costs = cost(np.stack(starts))
    rows, least, waited = starts[int(np.argmin(costs))], float(costs.min()), 0
    for _ in range(_ROUNDS):
        moves = _moves(rng, knobs, rows)
        if not moves:
            break
        costs = cost(np.stack([found for found, _ in moves]))
        order = [int(i) for i in np.argsort(costs, kind="stable")[: 4 * _TOGETHER] if costs[i] < least]
        joined = _joined(knobs, rows, [moves[i][1] for i in order])
        found = cost(np.stack(joined)) if joined else np.array([np.inf])
        best = int(np.argmin(found))
        if found[best] < least - 1e-9 * abs(least):
            rows, least, waited = joined[best], float(found[best]), 0
        elif (waited := waited + 1) >= _PATIENCE:
            break
    return rows, least


def _moves(rng: np.random.Generator, knobs: Sequence[Knob], rows: Array) -> list[tuple[Array, tuple[_Window, ...]]]:
    """Commands (K, P) that differ from `rows` in a window, or in two, as heat is given earlier instead of later."""
    windows = _drawn(rng, knobs, rows)
    moves: list[tuple[Array, tuple[_Window, ...]]] = [(window.in_place(rows), (window,)) for window in windows]
    for _ in range(len(windows)):
        pair = tuple(windows[int(i)] for i in rng.integers(len(windows), size=2))
        both = pair[1].in_place(pair[0].in_place(rows))
        if pair[0].knob != pair[1].knob or knobs[pair[0].knob].keeps(both[pair[0].knob]):
            moves.append((both, pair))
    return moves


def _drawn(rng: np.random.Generator, knobs: Sequence[Knob], rows: Array) -> list[_Window]:
    """Windows that keep their command's limits in commands `rows` (K, P)."""
    out: dict[_Window, None] = {}
    P = rows.shape[1]
    grids = [
        [knob.command.values(float(a), float(b)) for a, b in zip(knob.low, knob.high, strict=True)] for knob in knobs
    ]
    for _ in range(max(24, _DRAWN * _LONG // max(knobs[0].low.size, _LONG))):
        i = int(rng.integers(len(knobs)))
        knob = knobs[i]
        # More windows near the beginning: later ones are planned again before they come.
        begin = int(P * rng.random() ** 2)
        end = min(P, begin + max(1, round(rng.choice(_WINDOW_H) * 3600.0 / knob.part_s)))
        beside = [rows[i, max(begin - 1, 0)], rows[i, min(end, P - 1)], knob.state.value]
        value = float(beside[rng.integers(3)] if rng.random() < 0.4 else rng.choice(grids[i][begin // knob.parts]))
        window = _Window(i, begin, end, value)
        row = window.in_place(rows)[i]
        fits = knob.outside(row) <= knob.outside(rows[i]) and knob.command.allows(value)
        if fits and knob.keeps(row) and not np.array_equal(row, rows[i]):
            out[window] = None
    return list(out)


def _joined(knobs: Sequence[Knob], rows: Array, moves: Sequence[tuple[_Window, ...]]) -> list[Array]:
    """Commands with the first move, the first two, and so on, of those that may stand together."""
    out: list[Array] = []
    for windows in moves:
        together = out[-1] if out else rows
        for window in windows:
            together = window.in_place(together)
        if all(knobs[window.knob].keeps(together[window.knob]) for window in windows):
            out.append(together)
        if len(out) == _TOGETHER:
            break
    return out
