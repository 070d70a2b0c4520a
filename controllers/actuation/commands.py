"""From levels of a plan to commands of a loop: what is set when, for how long, and what the loop answers.

A step is met on average: a command is held as long as it brings about what is planned, or two of them share the step,
and what is missing is owed to the next one. A loop that switches is driven to its ends for a share of the step, since
between them it does as it likes (`LoopMap.spread`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermoforce_mpc.commands.command import SAME
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import share_on
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.clock import PLAN_STEP_S

# What a change of the command and the scatter of a loop count, as level over a step, and a step outside its limits. By
# judgement (2026-11-28): `bench commands` was set up with them.
_CHANGE, _SCATTER, _OUTSIDE = 0.35, 0.5, 10.0
# Later steps that a command is chosen for too, with a weight that falls from step to step: rooms change what a command
# brings within two hours.
_AHEAD, _FADES = 6, 0.6
# What earlier commands brought too much or too little is made up for by this level over a step, at most; by judgement.
_MOST_OWED = 0.5

Turns = tuple[tuple[float, float], ...]
"""Commands of a step in their order, and for how long each is held, s."""


@dataclass(frozen=True)
class CommandState:
    """What is set: the command, how long it has been held, s, and the level over a step that is owed."""

    value: float
    held_s: float
    owed: float = 0.0


@dataclass(frozen=True, eq=False)
class CommandedLoop:
    """A loop over the N steps of a plan: its command with the limits of each step, and the outdoor temperature.

    `low`, `high`, `usual` (N,): limits of the command and what it is when left alone; `T_out_C` (N,): mean of the step;
    `room`: number of the zone whose temperature it works against; `age_s`: how long ago `learned.last` was read, s;
    `off`: see `off_commands`.
    """

    learned: LearnedCommand
    room: int
    low: Array
    high: Array
    usual: Array
    T_out_C: Array
    step_s: float
    age_s: float = 0.0
    off: tuple[float, ...] = ()

    @property
    def usual_row(self) -> Array:
        """What the command usually is, in all parts (P,)."""
        return np.repeat(self.usual, self.parts)

    def is_on(self, values: Array) -> Array:
        """Share of a step in which the machine may run, with commands (S, n) in its parts, (S,)."""
        return share_on(values, self.off)

    def begin(self) -> CommandState:
        """What is set where no plan acted in the last step: as it was read, or later what it usually is."""
        if self.age_s <= self.step_s + 1.0 and np.isfinite(self.learned.last):
            return CommandState(self.learned.last, self.learned.held_s + max(self.age_s, 0.0))
        return CommandState(float(self.usual[0]), self.step_s)

    def reach(self, T_mean_C: Array, taken: Array, before: float) -> tuple[Array, Array]:
        """Least and largest level of each step (N,) that commands within the limits bring, room at `T_mean_C` (N,).

        `taken` (N,): by other valves, `before`: x of the last step, see `LoopMap`.
        """
        out, loop = [], self.learned.loop
        taken = np.broadcast_to(taken, T_mean_C.shape)
        for commands in (self.low, self.high):
            x, last = np.empty(commands.size), before
            for k, value in enumerate(commands):
                last = x[k] = float(loop.behind(value, T_mean_C[k], self.T_out_C[k], last, taken=taken[k]))
            out.append(loop.opened(T_mean_C) * x)
        return out[0], np.maximum(out[0], out[1])

    @cached_property
    def parts(self) -> int:
        """Parts of a step at whose beginnings the command may change."""
        return max(1, int(self.step_s // PLAN_STEP_S)) if self.step_s % PLAN_STEP_S == 0.0 else 1

    def choose(
        self, k: int, wanted: Array, T_start_C: float, T_end_C: Array, before: float, state: CommandState
    ) -> tuple[Turns, CommandState]:
        """Commands of step `k` as (value, s), and what is set after it.

        `wanted` (n,): levels of this step and the next ones; `T_start_C`: room now; `T_end_C` (n,): at the end of each
        of these steps, °C; `before`: x of the last step, see `LoopMap`.
        """
        command, n, part_s = self.learned.command, self.parts, self.step_s / self.parts
        grid = command.values(float(self.low[k]), float(self.high[k]))
        near = grid[np.abs(grid - state.value) <= command.most_change(state.held_s) + SAME]
        may_stay = command.allows(state.value)
        # What may not be set at all is left at once, by more than the slowest change where it must be.
        grid = near if near.size or may_stay else grid[[int(np.argmin(np.abs(grid - state.value)))]]
        values = np.unique(np.append(grid, state.value))
        at = np.linspace(T_start_C, T_end_C[0], 2 * n + 1)[1::2]
        T_out, hold_s = self.T_out_C[k], 60.0 * command.hold_min
        longest_s = np.array([command.longest_s(float(value)) for value in values])
        levels = self.learned.loop.level(values[:, None], at, T_out, before)  # (values, parts)
        cost = self.learned.loop.scatter(values[:, None], at, T_out)
        now = int(np.argmin(np.abs(values - state.value)))
        later = self._later(k, values, wanted, T_end_C)
        outside = np.where((values < self.low[k] - SAME) | (values > self.high[k] + SAME), _OUTSIDE, 0.0)
        target = wanted[0] + state.owed
        best, chosen = np.inf, (n, now)
        for i in range(n + 1):  # the command changes after `i` parts
            kept_s = state.held_s + i * part_s
            if i > 0 and (kept_s > longest_s[now] + SAME or not may_stay):
                continue
            waits = kept_s + part_s <= longest_s[now] + SAME and state.value in grid
            if i < n and kept_s < hold_s - SAME and waits:
                continue
            share = i / n
            mean = (levels[now, :i].sum() + levels[:, i:].sum(axis=1)) / n
            scatter = (cost[now, :i].sum() + cost[:, i:].sum(axis=1)) / n
            score = np.abs(mean - target) + _SCATTER * scatter + share * outside[now] + (1.0 - share) * outside
            score = score + (later if i < n else later[now]) + (_CHANGE if i < n else 0.0)
            if i < n:
                score[now] = np.inf
                score[longest_s < (n - i) * part_s - SAME] = np.inf
                v = int(np.argmin(score))
            else:
                v = now
            if score[v] < best - 1e-9:
                best, chosen = float(score[v]), (i, v)
        i, v = chosen
        mean = float(levels[now, :i].sum() + levels[v, i:].sum()) / n
        owed = float(np.clip(target - mean, -_MOST_OWED, _MOST_OWED))
        if i == n:
            return ((state.value, self.step_s),), CommandState(state.value, state.held_s + self.step_s, owed)
        turns = ((state.value, i * part_s), (float(values[v]), (n - i) * part_s))
        return tuple(turn for turn in turns if turn[1] > 0.0), CommandState(float(values[v]), (n - i) * part_s, owed)

    def _later(self, k: int, values: Array, wanted: Array, T_end_C: Array) -> Array:
        """How far commands that are held beyond step `k` are from what is planned then, (values,).

        What is planned stands for x too: of where a search begins, more would not be seen in what it finds.
        """
        n = min(_AHEAD, wanted.size - 1, self.low.size - 1 - k)
        out = np.zeros(values.size)
        for j in range(1, n + 1):
            T = 0.5 * (T_end_C[j - 1] + T_end_C[j])
            level = self.learned.loop.level(values, T, self.T_out_C[k + j], wanted[j - 1])
            off = np.abs(level - wanted[j])
            off += np.where((values < self.low[k + j] - SAME) | (values > self.high[k + j] + SAME), 1.0, 0.0)
            out += 0.3 * _FADES ** (j - 1) * off
        return out
