"""Plans as commands: levels within what commands bring, the commands of all steps, and what they save.

The plan is made in heat. Before it, the level that the commands of each step can bring is worked out from the maps of
the loops and the predicted temperatures, and bounds the plan; where the plan's own temperatures say otherwise, it is
made anew. After it, levels become commands, and what counts is what the loops answer: temperatures, power and cost of
the plan are those of its commands, which are then searched for cheaper ones. A building left alone is the same model
under the commands of the record's week.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from controllers.actuation.actuator import ActuationConfig, ActuationState
from controllers.actuation.commands import CommandedLoop, CommandState, Turns
from controllers.mpc.commands.costs import (
    BuildingMeters,
    MeanCost,
    MeteredCommand,
    spread_of_savings,
    worth_of_states,
)
from controllers.mpc.commands.following import Followed, LoopTables, followed
from controllers.mpc.commands.search import Knob, better_commands
from controllers.mpc.config import MPCConfig
from controllers.mpc.state import MPCState
from controllers.optimisation.plan_model import Evaluator
from controllers.optimisation.problem import MPCProblem, ProblemShape, Weights
from thermoforce_mpc.commands.command import SAME
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import (
    MeterEffect,
    beyond_sd,
    off_commands,
)
from thermoforce_mpc.data import (
    HOUR_S,
    Array,
    Block,
    Boundary,
    HeldCommand,
    Layout,
    Plan,
    PlannedSaving,
    PlanStatus,
    energy_kWh,
)
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.dataframes import clock_s
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.card import JUDGED_H, ModelCard
from thermoforce_mpc.model.drawn import errors_K, expected_saving, free_errors_K, lasting, more_and_less, standard
from thermoforce_mpc.model.machine.change import weight_of_demand
from thermoforce_mpc.model.operator.building import BuildingOperator

# A plan that asks for more than this beyond what commands bring is made anew, at most so often in all. By judgement:
# laws of a command are not known better.
_BEYOND, MOST_SOLVES = 0.05, 3
NOT_BETTER = "commands that were found are not better than leaving the building alone: its own control acts"
"""What a plan says that is not carried out."""
# Houses that differ by what is not known, by which the band of a saving is told, and their seed: beyond either end of a
# 90 % band are two of them.
_DRAWS, _SEED = 40, 64
# Lead time whose error counts of rooms that are not known, h: the longest that is judged.
_ERROR_H = JUDGED_H[-1]
# What a change of a command must save, as a share of what levels cost when the building is left alone. By judgement: a
# change an hour all day costs as much as 5 %.
_PER_CHANGE = 0.002
# What the scatter of a level costs, as a share of that level's cost: a search takes what is judged too well (see
# `bench commands`, seed 100, 2026-11-28: without it power was 5 % more than the first steps of plans said).
_SCATTER = 0.15
# How often K·h outside the bounds, with their margins, count that a building left alone has not: a saving is one
# at equal comfort. By judgement: house 9583 of `bench commands` by SG-Ready, two days, is 1.6 K·h a week colder where
# they count by the bounds alone, not colder with margins, and saves 14.5 and 19.0 % (2026-11-29).
_WORSE = 4.0
# How many standard errors of what commands do on meters count as cost: a search takes what is judged too well.
_CAUTION = 1.0


@dataclass(frozen=True, eq=False)
class Commanded:
    """A plan in commands: levels `u` (A, N) that the loops answer with, and the command of each part of each step.

    `values[a]` (N, n) is None where an actuator has no command, or is in `left_alone`; `part_s`: length of its parts,
    s; `states` (A,): what is set after the first step; `most`: least and largest command of the first step of those
    that have one of their own and may change it now.
    """

    u: Array
    values: tuple[Array | None, ...]
    part_s: Mapping[int, float]
    states: tuple[CommandState | None, ...]
    left_alone: frozenset[int]
    most: Mapping[int, tuple[float, float]]

    def guard(self, step_s: float) -> dict[int, tuple[tuple[Block, ...], tuple[Block, ...]]]:
        """The first step with the least and with the most that each actuator may be commanded, by its number."""
        ends = {a: both for a, both in self.most.items() if self.values[a] is not None}
        return {a: ((Block(0.0, step_s, (low,)),), (Block(1.0, step_s, (high,)),)) for a, (low, high) in ends.items()}

    def blocks(self, a: int) -> tuple[Block, ...]:
        """The first step of actuator `a`."""
        steps = self.values[a]
        assert steps is not None  # of one that has a command
        return tuple(Block(float(self.u[a, 0]), s, (value,)) for value, s in _turns(steps[0], self.part_s[a]))


class BuildingCommands:
    """The commands of a building's actuators."""

    def __init__(
        self,
        layout: Layout,
        learned: Mapping[int, LearnedCommand],
        cards: Sequence[ModelCard],
        meters: Mapping[str, MeterEffect],
    ) -> None:
        """`learned`: by number of the actuator; `cards` (A,): of each actuator's model; `meters`: by machine."""
        self._layout, self._learned, self._cards = layout, dict(learned), tuple(cards)
        self._meters = dict(meters)
        self._spread = np.array([_effect_spread(card) for card in cards])

    def begin(
        self,
        operator: BuildingOperator,
        evaluator: Evaluator,
        problem: MPCProblem,
        boundary: Boundary,
        left_alone: Collection[int],
        origin: Any,
        states: Sequence[ActuationState],
        unknown: Collection[int] = (),
    ) -> CommandedPlan | None:
        """What is needed for one plan, None without commands.

        `left_alone`: actuators that will not follow it; `origin`: what the boundary's seconds count from, if known;
        `states` (A,): what is set now by the plan before; `unknown`: actuators that follow it though what they do to
        their rooms is not known.
        """
        if not self._learned:
            return None
        loops, T_out_C = {}, step_means(boundary.T_out_C)
        for a, learned in self._learned.items():
            time_s = learned.from_origin_s(boundary.time_s[:-1], origin)
            z = learned.room_of(self._layout.names.zones, self._layout.home[a])
            usual, age_s = learned.usual_at(time_s, T_out_C), float(time_s[0]) - learned.last_s
            low, high = learned.within_seen(
                *learned.command.limits(boundary.lower_C[z, 1:], boundary.upper_C[z, 1:], usual)
            )
            meter = self._meters.get(learned.machine)
            off = off_commands(learned, meter)
            loops[a] = CommandedLoop(learned, z, low, high, usual, T_out_C, boundary.step_s, age_s, off)
        now = {
            a: loop.begin() if state.command is None else CommandState(state.command, state.held_s)
            for a, loop in loops.items()
            for state in [states[a]]
        }
        groups: dict[str | int, list[int]] = {}
        for a, learned in self._learned.items():
            groups.setdefault(learned.machine or a, []).append(a)
        # What sets several is left alone as a whole.
        alone = {a for group in groups.values() if set(group) & set(left_alone) for a in group} | set(left_alone)
        together = tuple(tuple(group) for group in groups.values())
        held = {self._layout.home[a]: _HeldRoom.of(self._cards[a]) for a in unknown if a not in alone}
        problem = replace(problem, weights=_of_any_room(problem.weights))
        at_s = clock_s(boundary.time_s[:-1], origin)
        beside = tuple(
            MeteredCommand(group[0], self._layout.machine_of[group[0]], self._meters[name])
            for name, group in groups.items()
            if isinstance(name, str) and name in self._meters
        )
        layout = self._layout
        free_K = free_errors_K(self._cards, layout.home, len(layout.names.zones), boundary.time_s)
        acts = loops, now, together, frozenset(alone)
        plan = CommandedPlan(operator, evaluator, problem, boundary, *acts, self._spread, free_K, at_s, held, beside)
        return plan.margins_as_left_alone()


@dataclass(frozen=True)
class _HeldRoom:
    """A room that is not known: how far off predictions are, K, and what a plan changes there, as a share."""

    error_K: float
    relative_sd: float

    @classmethod
    def of(cls, card: ModelCard) -> _HeldRoom:
        """By the errors 6 h ahead, and what all actuators do there together, as `card` has it."""
        return cls(errors_K(card)[JUDGED_H.index(_ERROR_H)], min(card.together_sd, 1.0))


@dataclass(frozen=True, eq=False)
class CommandedPlan:
    """One plan in commands: `loops` by number of the actuator, of which those `left_alone` keep their usual commands.

    `now`: what is set when it begins, likewise; `together`: the actuators of each command; `spread` (A,): standard
    error of each one's effect, as a share; `free_K` (Z, N): error of the free part at the ends of steps, K; `clock_s`
    (N,): where steps begin; `held`: the rooms that are not known, by number of the zone; `beside`: what commands do on
    meters beside levels.
    """

    operator: BuildingOperator
    evaluator: Evaluator
    problem: MPCProblem
    boundary: Boundary
    loops: Mapping[int, CommandedLoop]
    now: Mapping[int, CommandState]
    together: tuple[tuple[int, ...], ...]
    left_alone: frozenset[int]
    spread: Array
    free_K: Array
    clock_s: Array
    held: Mapping[int, _HeldRoom]
    beside: tuple[MeteredCommand, ...] = ()

    @property
    def left_alone_C(self) -> Array:
        """What zones are at the ends of steps under the usual commands, (Z, N), °C."""
        return self._alone.T_bounds_C[:, 1:]

    def margins_as_left_alone(self) -> CommandedPlan:
        """The same plan with margins inside the bounds of rooms as far as the building left alone keeps them.

        Of rooms all of whose actuators have commands. A saving is one at equal comfort: a plan that keeps more inside
        the bounds than the building's own control does pays for warmth that nobody asked for. House 9717 of `bench
        commands`, whose bath is at its limit, saved 1.0 % of three days by set-points and 9.6 % by SG-Ready with all of
        the margins, 4.7 and 11.4 % as far as left alone, neither colder (2026-11-29).
        """
        problem, asked, alone_C = self.problem, self.boundary, self.left_alone_C
        lower_C, upper_C = problem.lower_C.copy(), problem.upper_C.copy()
        for z in set(self.operator.home) - {z for a, z in enumerate(self.operator.home) if a not in self.loops}:
            lower_C[z] = np.minimum(lower_C[z], np.maximum(alone_C[z], asked.lower_C[z, 1:]))
            upper_C[z] = np.maximum(upper_C[z], np.minimum(alone_C[z], asked.upper_C[z, 1:]))
        return replace(self, problem=replace(problem, lower_C=lower_C, upper_C=upper_C))

    def within_reach(self, guess: Array | None) -> MPCProblem:
        """The problem with the levels that commands bring at the temperatures of a plan `guess` (A, N).

        None: those of the usual commands. What is left alone has the levels of its usual commands, and no more is asked
        of its zone than these bring.
        """
        problem, m = self.problem, self.problem.machinery
        least, most = (np.repeat(u[:, None], problem.n_steps, axis=1) for u in (m.u_min, m.u_max))
        T_C = self._alone.T_bounds_C if guess is None else _zone_C(problem, self.operator, guess)
        for a, (low, high) in self._reach(T_C).items():
            low, high = (self._alone.levels[0, a],) * 2 if a in self.left_alone else (low, high)
            most[a] = np.clip(high, 0.0, m.u_max[a])
            least[a] = np.minimum(low, most[a])
        for machine, fed in enumerate(m.fed_by > 0.0):  # what valves ask for beyond the machine is not given
            room = np.ones(problem.n_steps) if problem.capacity is None else problem.capacity[machine]
            asked = (m.share[fed, None] * np.maximum(least[fed], 0.0)).sum(axis=0)
            least[fed] *= np.minimum(1.0, 0.99 * np.maximum(room, 0.0) / np.maximum(asked, 1e-9))
        for group in m.exclusive:
            least[list(group)] = np.minimum(least[list(group)], 0.0)
        alone_C, lower_C, upper_C = self.left_alone_C, problem.lower_C.copy(), problem.upper_C.copy()
        for z in range(len(lower_C)):
            own = {a for a, home in enumerate(self.operator.home) if home == z}
            if own and own <= self.left_alone & set(self.loops):
                lower_C[z], upper_C[z] = np.fmin(lower_C[z], alone_C[z]), np.fmax(upper_C[z], alone_C[z])
        return replace(problem, least_u=least, most_u=most, lower_C=lower_C, upper_C=upper_C)

    def beyond(self, u: Array, shape: ProblemShape) -> bool:
        """Whether levels (A, N) ask for more than commands bring in their moves at the temperatures they lead to."""
        reach = self._reach(_zone_C(self.problem, self.operator, u))
        return any((u[a] > shape.in_moves(high) + _BEYOND).any() for a, (_, high) in reach.items())

    def _reach(self, T_C: Array) -> dict[int, tuple[Array, Array]]:
        """Least and largest levels that commands bring at temperatures of the zones (Z, N + 1), by actuator."""
        mean_C = step_means(T_C)
        names = self.operator.actuators
        opened = {names[a]: loop.learned.loop.opened(mean_C[loop.room]) for a, loop in self.loops.items()}
        return {
            a: loop.reach(mean_C[loop.room], loop.learned.loop.taken(opened), float(self._tables.before[a]))
            for a, loop in self.loops.items()
        }

    def realise(self, u: Array) -> Commanded:
        """Commands for levels `u` (A, N) from what is set now, and what the loops answer."""
        knobs = self._knobs()
        left = [a for a in self.loops if a in self.left_alone]
        values: dict[int, Array] = {}
        if knobs:
            mean = self._mean_cost

            def cost(rows: Array) -> Array:
                held = {a: rows[:, i] for i, (members, _) in enumerate(knobs) for a in members}
                found = self._brought(u, held | {a: self.loops[a].usual_row[None] for a in left}, len(rows))
                at_meter = self._meters.at_meter(found.levels, held, mean.per_kWh)
                beside = at_meter.beside
                each = at_meter.cost + beside.after + _CAUTION * beside.sd
                changes = (np.abs(np.diff(rows, axis=2)) > SAME).sum(axis=(1, 2))
                # Less heat than there would be is missing after the plan; more of it earns nothing.
                more_K = found.forced_K - self._alone.forced_K
                worth = np.minimum(worth_of_states(self.operator, self.problem, more_K, mean), 0.0)
                unsure = _SCATTER * mean.per_used * found.scatter
                worse = self._held_cost(found.T_C) + self._worse_cost(found.T_C)
                return np.asarray(each - worth + unsure + worse + _PER_CHANGE * mean.of_levels * changes)

            rows, _ = better_commands([knob for _, knob in knobs], self._starts(u, knobs), cost)
            values = {a: rows[i] for i, (members, _) in enumerate(knobs) for a in members}
        held = {a: row[None] for a, row in values.items()} | {a: self.loops[a].usual_row[None] for a in left}
        levels, N = self._brought(u, held, 1).levels[0], self.problem.n_steps
        after = {a: knob.after(values[a]) for members, knob in knobs for a in members}
        return Commanded(
            levels,
            tuple(values[a].reshape(N, -1) if a in values else None for a in range(len(u))),
            {a: loop.step_s / loop.parts for a, loop in self.loops.items()},
            tuple(after.get(a) for a in range(len(u))),
            self.left_alone & set(self.loops),
            {members[0]: ends for members, knob in knobs if len(members) == 1 and (ends := knob.ends()) is not None},
        )

    def _knobs(self) -> list[tuple[tuple[int, ...], Knob]]:
        """What is set: the actuators of each command that is not left alone, and the command as it is now."""
        out = []
        for members in self.together:
            if self.left_alone.intersection(members):
                continue
            loops = [self.loops[a] for a in members]
            low, high = np.max([loop.low for loop in loops], axis=0), np.min([loop.high for loop in loops], axis=0)
            if (low > high).any():  # bounds of rooms that have no set-point in common
                low, high = np.min([loop.low for loop in loops], axis=0), np.max([loop.high for loop in loops], axis=0)
            one, now = loops[0], self.now[members[0]]
            out.append((members, Knob(one.learned.command, low, high, now, one.parts, one.step_s / one.parts)))
        return out

    def _starts(self, u: Array, knobs: Sequence[tuple[tuple[int, ...], Knob]]) -> list[Array]:
        """Commands (K, P) where the search begins: those that follow `u` (A, N) room by room, and the usual ones."""
        out = []
        for turn in range(max(len(members) for members, _ in knobs)):
            lead = {members[turn % len(members)]: members for members, _ in knobs}
            found = self._followed_levels(u, lead, {a: knob for members, knob in knobs for a in members})
            out.append(np.stack([found[a] for a in lead]))
        usual = [self.loops[members[0]].usual_row for members, _ in knobs]
        if all(knob.keeps(row) and not knob.outside(row) for row, (_, knob) in zip(usual, knobs, strict=True)):
            out.append(np.stack(usual))
        return out

    def _followed_levels(
        self, u: Array, lead: Mapping[int, tuple[int, ...]], knobs: Mapping[int, Knob]
    ) -> dict[int, Array]:
        """Commands (P,) of the actuators `lead`, each of which sets those of its members, that follow levels `u`."""
        planned = _zone_C(self.problem, self.operator, u)
        set_now = {a: knobs[a].state for a in lead}
        of = {member: a for a, members in lead.items() for member in members}
        rows: dict[int, list[Array]] = {a: [] for a in lead}

        def choose(a: int, k: int, T_C: Array, before: Array) -> Array:
            if a not in of:
                return self.loops[a].usual_row.reshape(self.problem.n_steps, -1)[None, k]
            first = of[a]
            if len(rows[first]) == k:
                z = self.loops[first].room
                # From where the commands have brought the room, the rest of the way is as planned.
                T_end_C = planned[z, k + 1 :] + (T_C[0, z] - planned[z, k])
                turns, set_now[first] = self.loops[first].choose(
                    k, u[first, k:], float(T_C[0, z]), T_end_C, float(before[0, first]), set_now[first]
                )
                part_s = self.loops[first].step_s / self.loops[first].parts
                rows[first].append(np.concatenate([np.full(round(s / part_s), value) for value, s in turns]))
            return rows[first][k][None]

        followed(self.operator, self.problem, self._tables, u, choose)
        return {a: np.concatenate(row) for a, row in rows.items()}

    @property
    def without(self) -> CommandedPlan:
        """The same plan with all loops left alone."""
        return replace(self, left_alone=self.left_alone | set(self.loops))

    def settings(self, commanded: Commanded, time_s: Array) -> tuple[tuple[HeldCommand, ...], ...]:
        """The commands of each actuator in time, (A,); of one that is left to itself, that it is."""
        out, step_s = [], self.problem.step_s
        for a, steps in enumerate(commanded.values):
            found: list[HeldCommand] = []
            if steps is None and a in self.loops:
                found = [HeldCommand(float(time_s[0]), float(time_s[-1]) + step_s, None)]
            for at_s, row in zip(time_s.tolist(), () if steps is None else steps, strict=steps is not None):
                for value, seconds in _turns(row, commanded.part_s[a]):
                    if found and found[-1].value == value:
                        found[-1] = replace(found[-1], end_s=at_s + seconds)
                    else:
                        found.append(HeldCommand(at_s, at_s + seconds, value))
                    at_s += seconds
            out.append(tuple(found))
        return tuple(out)

    def saving(self, plan: Commanded, power_spread: float, scatter_W: Sequence[Array] = ()) -> PlannedSaving:
        """What the commands of a plan save against the usual ones, by the same model.

        Both are followed in houses that differ by the uncertainty of effects, maps and free part, with what is stored
        at the end at its mean cost. `power_spread`: error of what a change of levels does to power, as a share: where
        the record does not tell it, energy lies between what the law of power says of the levels and what the rooms'
        temperatures ask for, the figure in the middle; the better it tells it, the nearer to the law. `scatter_W` (M)
        of machines' meters around their laws, see `scatter_of_days`.
        """
        usual = {a: self.loops[a].usual_row[None] for a in self.loops}
        planned = {a: row.reshape(1, -1) for a, row in enumerate(plan.values) if row is not None}
        own = usual | planned
        problem, A = self.problem, len(self.spread)
        rng = np.random.default_rng(_SEED)
        z = np.vstack([np.zeros(A + 3), rng.standard_normal((_DRAWS, A + 3))])
        uniform = rng.random(len(z))
        gain = np.exp(np.clip(z[:, :A] * self.spread, -1.0, 1.0))
        step_h = problem.step_s / HOUR_S
        away_K: Array = self.free_K * lasting((len(z), *self.free_K.shape), problem.step_s, rng)
        with_plan, alone = (self._brought(plan.u, held, len(z), gain, z[:, A], away_K) for held in (own, usual))
        # What commands do on the meter beside levels, by effects that differ too.
        drawn = [one.meter.drawn(standard((len(z), one.meter.mean.size), rng)) for one in self.beside]
        with_meter, alone_meter = (
            self._meters.at_meter(one.levels, held, self._mean_cost.per_kWh, drawn)
            for one, held in ((with_plan, own), (alone, usual))
        )
        found = [with_meter.law, alone_meter.law]
        cost, cost_alone = (np.array([one.energy_cost.sum() for one in of]) for of in found)
        energy, energy_alone = (energy_kWh(np.array([one.power_W.sum() for one in of]), problem.step_s) for of in found)
        # The energy of the rooms' demand: what is lost to outdoors follows their temperature, whatever the levels.
        T_out_C = step_means(self.boundary.T_out_C)
        lost_K = [float(np.maximum(one.T_bounds_C[:, 1:] - T_out_C, 1.0).mean()) for one in (with_plan, alone)]
        by_demand = energy_alone * lost_K[0] / lost_K[1] / np.maximum(energy, 1e-9)
        demand = np.where(np.arange(len(z)) > 0, uniform, 0.5) * weight_of_demand(power_spread)
        as_asked = 1.0 + demand * (by_demand - 1.0)
        cost, energy = cost * as_asked, energy * as_asked
        more, less = more_and_less(found[0][0].energy_cost - found[1][0].energy_cost, problem.step_s)
        by_levels = power_spread * (less * z[:, A + 1] - more * z[:, A + 2])
        # What follows after the plan counts as heat that is stored does.
        beside, beside_alone = with_meter.beside, alone_meter.beside
        of_levels = cost_alone - self._meters.idle_cost
        cost, energy = cost + beside.cost, energy + beside.kWh
        cost_alone, energy_alone = cost_alone + beside_alone.cost, energy_alone + beside_alone.kWh
        mean = MeanCost(cost_alone, of_levels, self._meters.used(alone.levels), energy_alone)
        worth = worth_of_states(self.operator, problem, with_plan.forced_K - alone.forced_K, mean)
        worth = worth - beside.after + beside_alone.after
        off_peak = alone_meter.peak - with_meter.peak
        saved = cost_alone - cost + worth + by_levels + off_peak
        moved = (beside.cost + beside.after - beside_alone.cost - beside_alone.after)[0]
        by_chance = self._meters.chance_sd({a for a in planned if not np.array_equal(own[a], usual[a])}, scatter_W)
        if by_chance is not None:
            sd = beyond_sd(float(moved), more + less, float(of_levels[0]), by_chance)
            saved = saved + sd * standard((len(z), 1), rng)[:, 0]
        spread = spread_of_savings(float(of_levels[0]), float(moved), float(off_peak[0]))
        expected, low, high = expected_saving(saved, spread)
        outside = [self.boundary.outside_K(one.T_bounds_C[:, 1:]).sum(axis=1) * step_h for one in (with_plan, alone)]
        comfort = float((problem.weights.comfort * (outside[1] - outside[0])).sum())
        kept_caps = float(alone_meter.cap[0] - with_meter.cap[0])
        peak, peak_alone = float(with_meter.peak[0]), float(alone_meter.peak[0])
        return PlannedSaving(
            saved=expected,
            low=low,
            high=high,
            cost=float(cost[0]) + float(saved[0]) - expected + peak,
            cost_alone=float(cost_alone[0]) + peak_alone,
            energy_kWh=float(energy[0]),
            energy_alone_kWh=float(energy_alone[0]),
            outside_Kh=float(outside[0].sum()),
            outside_alone_Kh=float(outside[1].sum()),
            gain=expected
            + comfort
            + kept_caps
            - float((self._held_cost(with_plan.T_C) + self._worse_cost(with_plan.T_C))[0]),
            peak=peak,
            peak_alone=peak_alone,
        )

    def _worse_cost(self, T_C: Array) -> Array:
        """What K·h outside the bounds, with their margins, beyond those of the building left alone count more than
        others, (S,), in houses with zones at (S, Z, N + 1), °C.
        """
        problem, alone_C = self.problem, self.left_alone_C
        both_C = np.concatenate([T_C[..., 1:], alone_C[None]])
        out_K = excess(both_C, problem.lower_C, problem.upper_C)
        worse_K = np.maximum(out_K[:-1] - out_K[-1], 0.0)
        return np.asarray((_WORSE - 1.0) * np.einsum("z,szn->s", problem.comfort_price, np.nan_to_num(worse_K)))

    def _held_cost(self, T_C: Array) -> Array:
        """What rooms that are not known are expected to cost beyond what is said of them, (S,), in houses with zones
        at (S, Z, N + 1), °C.

        Predictions err there, and what a plan changes may be more or less than is said: discomfort is what it is on
        average over both. It counts where it is more than left alone; where it is less, nothing is earned.
        """
        cost, problem, alone_C = np.zeros(len(T_C)), self.problem, self._alone.T_bounds_C
        for z, room in self.held.items():
            both_C = np.stack([*T_C[:, z, 1:], alone_C[z, 1:]])
            sd_K = np.hypot(room.error_K, room.relative_sd * (both_C - alone_C[z, 1:]))
            out_K = _beyond(problem.lower_C[z] - both_C, sd_K) + _beyond(both_C - problem.upper_C[z], sd_K)
            worse_K = np.maximum(out_K[:-1] - out_K[-1], 0.0)
            cost += problem.comfort_price[z] * np.nansum(worse_K, axis=1)
        return cost

    @cached_property
    def _alone(self) -> Followed:
        """The building under its usual commands."""
        nothing = np.zeros((len(self.spread), self.problem.n_steps))
        return self._brought(nothing, {a: self.loops[a].usual_row[None] for a in self.loops}, 1)

    @cached_property
    def _meters(self) -> BuildingMeters:
        return BuildingMeters(self.problem, self.evaluator, self.loops, self.now, self.clock_s, self.beside)

    @cached_property
    def _mean_cost(self) -> MeanCost:
        """What the building costs under its usual commands."""
        return self._meters.mean_cost(self._alone.levels)

    @cached_property
    def _tables(self) -> LoopTables:
        machine_of = self.problem.machinery.machine_of
        none = {one.m for one in self.beside if not one.meter.shows_a_charge}
        charging = {
            a: self.now[a]
            for a, loop in self.loops.items()
            if loop.learned.command.tank_first and machine_of[a] not in none
        }
        return LoopTables(self.operator, self.problem, self.loops, charging)

    def _brought(
        self,
        u: Array,
        held: Mapping[int, Array],
        S: int,
        gain: Array | None = None,
        z: Array | None = None,
        away_K: Array | float = 0.0,
    ) -> Followed:
        """S buildings under commands `held` (S or 1, P) of all parts, by actuator; see `followed`."""
        of_step = {a: rows.reshape(len(rows), self.problem.n_steps, -1) for a, rows in held.items()}
        gain = np.ones((S, len(u))) if gain is None else gain

        def told(a: int, k: int, T_C: Array, before: Array) -> Array:
            return of_step[a][:, k]

        return followed(self.operator, self.problem, self._tables, u, told, gain, z, away_K)


def with_commands(config: MPCConfig, commands: Collection[str]) -> MPCConfig:
    """`config` with any level held for actuators that are set by `commands`: the mean of what their loops answer."""
    any_level = ActuationConfig(mode="modulating", lowest_level=0.0)
    if not commands:
        return config
    return config.model_copy(update={"actuations": {**config.actuations, **dict.fromkeys(commands, any_level)}})


def _of_any_room(weights: Weights) -> Weights:
    """`weights` with a K·h outside the bounds that costs in each room what it costs in the largest one.

    Weights go by floor area, and a kelvin in a small bath costs less than the hour of heat that it takes: a plan let it
    be cold, which the building left alone never did (`bench commands`, seed 421, 2026-11-28: 0.76 K·h a week).
    """
    return replace(weights, comfort=float(np.max(weights.comfort)))


def _effect_spread(card: ModelCard) -> float:
    """Standard error of an actuator's effect of a day on its home zone, as a share; 0 where its card has none."""
    effect, sd = (card.uncertainty.get(f"step_response_24h{what}_K", 0.0) for what in ("", "_sd"))
    return min(sd / abs(effect), 1.0) if effect else 0.0


def with_command_states(plan: Plan, commanded: Commanded) -> Plan:
    """The plan, its state with what is set after its first step."""
    assert isinstance(plan.state, MPCState)
    states = tuple(
        state if told is None or state.native else replace(state, command=told.value, held_s=told.held_s, owed_s=0.0)
        for state, told in zip(plan.state.actuation, commanded.states, strict=True)
    )
    for a, status in enumerate(plan.acting):
        told = plan.blocks[-1].command[a] if plan.blocks else None
        if status is PlanStatus.GUARD and a in commanded.most and isinstance(told, float):
            held = CommandState(told, sum(block.duration_s for block in plan.blocks))
            states = (*states[:a], replace(states[a], command=held.value, held_s=held.held_s), *states[a + 1 :])
    return replace(plan, state=replace(plan.state, actuation=states))


def _zone_C(problem: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Zone temperatures at the boundaries under levels (A, N), (Z, N + 1), °C."""
    comes = u if problem.available is None else u * problem.available
    brought = operator.rollout(problem.forced_state_K, comes, problem.features).sum(axis=(1, 3))
    return np.concatenate([problem.T_now_C[:, None], compose(problem.T_free_C, brought)], axis=1)


def _beyond(out_K: Array, sd_K: Array) -> Array:
    """How far beyond a bound a room is on average, K, more than by `out_K` (negative inside) itself; error `sd_K`."""
    from scipy.special import ndtr

    sd_K = np.maximum(sd_K, 1e-6)
    density = np.exp(-0.5 * (out_K / sd_K) ** 2) / np.sqrt(2.0 * np.pi)
    return np.asarray(out_K * ndtr(out_K / sd_K) + sd_K * density - np.maximum(out_K, 0.0))


def _turns(row: Array, part_s: float) -> Turns:
    """Commands of the parts of a step (n,) as turns."""
    return tuple((value, part_s * len(list(same))) for value, same in groupby(row.tolist()))
