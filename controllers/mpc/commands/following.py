"""Buildings followed under commands: what the loops answer to rooms that warm and cool by what they answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.actuation.commands import CommandedLoop, CommandState
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.commands.command import SAME
from thermoforce_mpc.commands.loop import behind_levels
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OUTDOOR

# Rounds in which level and temperature of a step are made to agree, and levels of a table of their heat.
_ROUNDS, _CLOSE, _TABLE = 20, 5e-4, 65


Held = dict[int, tuple[Array, Array]]
"""What is set (S or 1,) and for how long it has been, s, by actuator."""


@dataclass(frozen=True, eq=False)
class Followed:
    """S houses under commands: levels (S, A, N), and forced states at the end (S, Z, A, r), K.

    `T_C` (S, Z, N + 1): temperatures of the zones, now and at the end of each step; `scatter` (S,): of the levels,
    summed like `BuildingMeters.used`.
    """

    levels: Array
    T_C: Array
    forced_K: Array
    scatter: Array

    @property
    def T_bounds_C(self) -> Array:
        """`T_C` of the first house, (Z, N + 1)."""
        return np.asarray(self.T_C[0])


def followed(
    operator: BuildingOperator,
    problem: MPCProblem,
    tables: LoopTables,
    u: Array,
    values_of: Callable[[int, int, Array, Array], Array],
    gain: Array | None = None,
    z: Array | None = None,
    away_K: Array | float = 0.0,
) -> Followed:
    """Follow a building under the commands of `tables`, step by step; an actuator without one has levels `u` (A, N).

    `values_of`: of an actuator in a step, for rooms now (S, Z), °C, and x of the last step (S, A), see `LoopMap`, its
    commands in the parts of the step (S or 1, n). `gain` (S, A): effect of what the actuators do from now on, as a
    multiple; `z` (S,): see `LoopMap.level`; `away_K` (S, Z, n): by how much free parts are higher than predicted.
    """
    A, n = u.shape
    gain = np.ones((1, A)) if gain is None else gain
    z = np.zeros(len(gain)) if z is None else z
    S, T_free = len(gain), problem.T_free_C + away_K
    new = np.zeros((S, *problem.forced_state_K.shape))
    T = np.repeat(problem.T_now_C[None], S, axis=0)
    before, levels, course = np.repeat(tables.before[None], S, axis=0), np.empty((S, A, n)), [T]
    scatter, held = np.zeros(S), tables.held
    for k in range(n):
        values = {a: values_of(a, k, T, before) for a in tables.loops}
        remains_C = T_free[..., k] + tables.fades_K[k + 1].sum(axis=(1, 2))
        at_rest = remains_C + (operator.poles * new).sum(axis=(2, 3))
        modulation = tables.modulation[k]
        if modulation is None:  # it sees what is forced
            modulation = operator.modulated(np.ones(A), problem.features[:, k], tables.fades_K[k] + new[0])
        level = np.repeat(u[None, :, k], S, axis=0)
        tables.settle(k, values, level, before, z, T, at_rest, modulation * gain, scatter)
        held = tank_first(tables.loops, k, values, level, held)
        drive = modulation * _heat(operator, problem, level, k) * gain
        new = operator.poles * new + operator.gains * drive[:, None, :, None]
        T = remains_C + new.sum(axis=(2, 3))
        levels[:, :, k] = level
        course.append(T)
    return Followed(levels, np.stack(course, axis=2), tables.fades_K[n] + new, scatter)


class LoopTables:
    """What houses under any commands have in common.

    `loops` by number of the actuator, one at least, and heat by level as arrays, for `_settle`; `held`: see
    `tank_first`; `fades_K` (n + 1) of (Z, A, r): what is left of the forced state of now where steps begin, K;
    `modulation` (n) of (A,), None where it depends on what is forced.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        problem: MPCProblem,
        loops: Mapping[int, CommandedLoop],
        charging: Mapping[int, CommandState],
    ) -> None:
        """`charging`: what is set now, of the actuators whose machine charges a tank first."""
        self.loops = loops
        self.held: Held = {a: (np.full(1, now.value), np.full(1, now.held_s)) for a, now in charging.items()}
        table = np.repeat(np.linspace(0.0, 1.0, _TABLE)[:, None], len(operator.home), axis=1)
        self._heat = [np.ascontiguousarray(_heat(operator, problem, table, k)) for k in range(problem.n_steps)]
        self._maps = _Maps.of(loops, operator.actuators)
        n, whole, nothing = problem.n_steps, np.ones(len(operator.home)), np.zeros(len(operator.home))
        self.fades_K = [problem.forced_state_K]
        for _ in range(n):
            self.fades_K.append(operator.advance(self.fades_K[-1], nothing))
        sees_forced = any(operator.of_actuator(a).feedback_active for a in range(nothing.size))
        self.modulation = [
            None if sees_forced else operator.modulated(whole, problem.features[:, k], problem.forced_state_K)
            for k in range(n)
        ]
        self._per_u, self._per_drive = power_of_levels(problem), np.ascontiguousarray(operator.gains.sum(axis=2))
        self.before = behind_levels(
            np.zeros(len(operator.home)) if problem.last_u is None else problem.last_u,
            {a: one.learned for a, one in loops.items()},
            {a: float(one.usual[0]) for a, one in loops.items()},
            problem.T_now_C[[loops[a].room if a in loops else z for a, z in enumerate(operator.home)]],
            float(next(iter(loops.values())).T_out_C[0]),
        )

    def settle(
        self,
        k: int,
        values: Mapping[int, Array],
        level: Array,
        before: Array,
        z: Array,
        T_C: Array,
        at_rest_C: Array,
        factor: Array,
        scatter: Array,
    ) -> None:
        """Set what loops answer in step `k` in `level` (S, A), and add to `scatter` (S,), see `Followed`.

        `values`: commands of the parts of the step (S or 1, n) by actuator; `before` (S, A): x of the last step, see
        `LoopMap`, which becomes that of this one; `z` (S,): see `LoopMap.level`; `T_C`, `at_rest_C` (S, Z): zones now,
        and at the end without heat in this step; `factor` (S, A): drive per unit of heat.
        """
        S = len(level)
        asked = np.stack(
            [
                np.broadcast_to(loop.learned.loop.index(values[a], 0.0, loop.T_out_C[k]), (S, np.shape(values[a])[1]))
                for a, loop in self.loops.items()
            ]
        )
        arrays = (z, T_C, at_rest_C, np.broadcast_to(factor, level.shape))
        numbers = [np.ascontiguousarray(one, dtype=np.float64) for one in (asked, *arrays)]
        _settle(level, scatter, before, *numbers, self._heat[k], self._per_drive, self._per_u, self._maps)
        for a, loop in self.loops.items():
            if loop.off:
                level[:, a] *= loop.is_on(values[a])


def tank_first(
    loops: Mapping[int, CommandedLoop], k: int, values: Mapping[int, Array], level: Array, held: Held
) -> Held:
    """Take from `level` (S, A) of step `k` what a tank gets first of commands `values` (S or 1, n), by actuator.

    `held`: what is set before it, of those of `loops` whose machine charges one; returned is what is set after it.
    """
    out: Held = {}
    for a, (last, since_s) in held.items():
        loop, parts = loops[a], values[a].shape[1]
        first = np.zeros(len(values[a]))
        for now in values[a].T:
            since_s = np.where(np.abs(now - last) > SAME, 0.0, since_s)
            first += (now > loop.usual[k] + SAME) & (since_s < HOUR_S - SAME)
            last, since_s = now, since_s + loop.step_s / parts
        level[:, a] *= 1.0 - loop.learned.command.tank_first * first / parts
        out[a] = last, since_s
    return out


class _Maps(NamedTuple):
    """The maps of L loops as arrays: actuator and room of each (L,), and what `LoopMap` has; shorter rows end level.

    `takes`, `open_mean` (L, L): w_b and ō_b of each loop.
    """

    actuator: Array
    room: Array
    zone: Array
    carry: Array
    holds_K: Array
    n_knots: Array
    knots: Array
    levels: Array
    uncertain: Array
    spread: Array
    n_shuts: Array
    shuts_C: Array
    opens: Array
    takes: Array
    open_mean: Array

    @classmethod
    def of(cls, loops: Mapping[int, CommandedLoop], actuators: Sequence[str]) -> _Maps:
        """The maps of `loops`, one at least, by number of the actuator in `actuators`."""
        maps = [loop.learned.loop for loop in loops.values()]

        def each(name: str) -> Array:
            return np.array([getattr(one, name) for one in maps], dtype=np.float64)

        def rows(name: str) -> Array:
            of = [getattr(one, name) for one in maps]
            m = max(row.size for row in of)
            return np.array([np.append(row, np.full(m - row.size, row[-1])) for row in of])

        def counts(name: str) -> Array:
            return np.array([getattr(one, name).size for one in maps], dtype=np.int64)

        others = np.array([[one.others.get(actuators[b], (0.0, 0.0)) for b in loops] for one in maps])
        return cls(
            actuator=np.array(list(loops), dtype=np.int64),
            room=np.array([loop.room for loop in loops.values()], dtype=np.int64),
            **{name: each(name) for name in ("zone", "carry", "holds_K")},
            **{name: rows(name) for name in ("knots", "levels", "uncertain", "spread", "shuts_C", "opens")},
            n_knots=counts("knots"),
            n_shuts=counts("shuts_C"),
            takes=np.ascontiguousarray(others[..., 0]),
            open_mean=np.ascontiguousarray(others[..., 1]),
        )


@njit(cache=True)
def _between(x: float, count: int, knots: np.ndarray, values: np.ndarray) -> float:
    """`np.interp` of one number, in the first `count` of `knots`."""
    if x <= knots[0]:
        return float(values[0])
    if x >= knots[count - 1]:
        return float(values[count - 1])
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= x:
            low = middle
        else:
            high = middle
    return float(values[low] + (values[high] - values[low]) * (x - knots[low]) / (knots[high] - knots[low]))


@njit(cache=True)
def _settle(
    level: np.ndarray, scatter: np.ndarray, before: np.ndarray, asked: np.ndarray, z: np.ndarray, T_C: np.ndarray,
    at_rest_C: np.ndarray, factor: np.ndarray, heat: np.ndarray, per_drive: np.ndarray, per_u: np.ndarray, maps: _Maps,
) -> None:  # fmt: skip
    """Levels and temperatures of a step that agree, house by house: half way to what the loops answer, again and again.

    `asked` (L, S, n): s of the commands but for the room; `heat` (V, A): of levels from 0 to 1; the others as in
    `LoopTables`. Writes `level` and `before` (S, A) and adds to `scatter` (S,).
    """
    S, A = level.shape
    Z, n, last = T_C.shape[1], asked.shape[2], heat.shape[0] - 1
    acts, rooms, n_knots, knots = maps.actuator, maps.room, maps.n_knots, maps.knots
    T_end, moved, x_mean, opened = np.empty(Z), np.empty(acts.size), np.empty(acts.size), np.empty(acts.size)
    room, s_of = np.empty(acts.size), np.empty((acts.size, n))
    for s in range(S):
        for i in range(acts.size):
            level[s, acts[i]] = before[s, acts[i]]
        for _ in range(_ROUNDS):
            for j in range(Z):
                T_end[j] = at_rest_C[s, j]
            for a in range(A):
                at = min(max(level[s, a], 0.0), 1.0) * last
                low = min(int(at), last - 1)
                drive = factor[s, a] * (heat[low, a] + (at - low) * (heat[low + 1, a] - heat[low, a]))
                for j in range(Z):
                    T_end[j] += per_drive[j, a] * drive
            worst = 0.0
            for i in range(acts.size):
                x_mean[i] = moved[i] = 0.0
            for part in range(n):
                for i in range(acts.size):
                    room[i] = T_C[s, rooms[i]] + (part + 0.5) / n * (T_end[rooms[i]] - T_C[s, rooms[i]])
                    opened[i] = _between(room[i], maps.n_shuts[i], maps.shuts_C[i], maps.opens[i])
                for i in range(acts.size):
                    a = acts[i]
                    x = asked[i, s, part] - maps.zone[i] * room[i] + maps.holds_K[i] * (before[s, a] - 0.5)
                    for b in range(acts.size):
                        if maps.takes[i, b] != 0.0:
                            x -= maps.takes[i, b] * (opened[b] - maps.open_mean[i, b])
                    s_of[i, part] = x
                    up = _between(x, n_knots[i], knots[i], maps.levels[i])
                    if z[s] != 0.0:
                        up += z[s] * _between(x, n_knots[i], knots[i], maps.uncertain[i])
                    behind = min(max(maps.carry[i] * before[s, a] + up, 0.0), 1.0)
                    x_mean[i] += behind / n
                    moved[i] += opened[i] * behind / n
            for i in range(acts.size):
                moved[i] = 0.5 * (level[s, acts[i]] + moved[i])
                worst = max(worst, abs(moved[i] - level[s, acts[i]]))
            if worst < _CLOSE:
                break
            for i in range(acts.size):
                level[s, acts[i]] = moved[i]
        for i in range(acts.size):
            before[s, acts[i]] = x_mean[i]
            for part in range(n):
                scatter[s] += per_u[acts[i]] * _between(s_of[i, part], n_knots[i], knots[i], maps.spread[i]) / n


def _heat(operator: BuildingOperator, problem: MPCProblem, level: Array, k: int) -> Array:
    """Heat v (S, A) of levels (S, A) in step `k`."""
    T_out_C = problem.features[:, k, OUTDOOR]
    each = [
        operator.of_actuator(a).heat_input(level[:, a], np.full(len(level), T_out_C[home]))
        for a, home in enumerate(operator.home)
    ]
    heat = np.stack(each, axis=-1)
    return heat if problem.available is None else heat * problem.available[:, k]


def power_of_levels(problem: MPCProblem) -> Array:
    """What a level of each actuator (A,) takes of the power, in any unit."""
    per_u = np.maximum(problem.power_per_u_W.mean(axis=1), 0.0)
    return per_u if per_u.any() else np.ones(per_u.size)
