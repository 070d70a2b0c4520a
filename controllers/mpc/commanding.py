"""Plans as commands: levels within what commands bring, the commands of all steps, and what they save.

The plan is made in heat. Before it, the level that the commands of each step can bring is worked out from the maps of
the loops and the predicted temperatures, and bounds the plan; where the plan's own temperatures say otherwise, it is
made anew. After it, levels become commands, and what counts is what the loops answer: temperatures, power and cost of
the plan are those of its commands, which are then searched for cheaper ones. A building left alone is the same model
under the commands of the record's week.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from controllers.actuation.actuator import ActuationConfig, ActuationState
from controllers.actuation.commands import CommandedLoop, CommandState, Turns
from controllers.mpc.command_search import Knob, better_commands
from controllers.mpc.config import MPCConfig
from controllers.mpc.state import MPCState
from controllers.optimisation.plan_model import Evaluation, Evaluator
from controllers.optimisation.problem import MPCProblem, Weights
from thermoforce_mpc.commands.command import SAME
from thermoforce_mpc.commands.loop import LearnedCommand, behind_levels
from thermoforce_mpc.commands.meter import (
    CourseState,
    MeterEffect,
    MeterRecord,
    beyond_sd,
    chance_sd,
    learn_meter,
    left_of,
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
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.data.dataframes import clock_s
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.card import JUDGED_H, ModelCard
from thermoforce_mpc.model.drawn import errors_K, expected_saving, free_errors_K, lasting, more_and_less, standard
from thermoforce_mpc.model.machine.change import weight_of_demand
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OUTDOOR
from thermoforce_mpc.model.thermal_model import ThermalModel

# A plan that asks for more than this beyond what commands bring is made anew, at most so often in all. By judgement:
# laws of a command are not known better.
_BEYOND, MOST_SOLVES = 0.05, 3
NOT_BETTER = "commands that were found are not better than leaving the building alone: its own control acts"
"""What a plan says that is not carried out."""
# Rounds in which level and temperature of a step are made to agree, and levels of a table of their heat.
_ROUNDS, _CLOSE, _TABLE = 20, 5e-4, 65
_DRAWS, _SEED = 40, 64
# Lead time whose error counts of rooms that are not known, h: the longest that is judged.
_ERROR_H = JUDGED_H[-1]
# What plans save at all, as a share of what levels cost: root mean square of what came true by set-points, offset and
# SG-Ready, .16, .09 and .11 of the whole cost (50 houses of `bench commands`, seeds 9530 to 9541 and 9550 to 9554,
# 2026-11-29), of which levels are .86. With it, what is said is off by .046 of the cost (.058 without). Standard
# deviations between the quantiles of a band.
_SAVES = 0.145
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
            _Beside(group[0], self._layout.machine_of[group[0]], self._meters[name])
            for name, group in groups.items()
            if isinstance(name, str) and name in self._meters
        )
        layout = self._layout
        free_K = free_errors_K(self._cards, layout.home, len(layout.names.zones), boundary.time_s)
        acts = loops, now, together, frozenset(alone)
        plan = CommandedPlan(operator, problem, boundary, *acts, self._spread, free_K, at_s, held, beside)
        return plan.margins_as_left_alone()


def meters_of(model: ThermalModel, learned: Iterable[LearnedCommand]) -> dict[str, MeterEffect]:
    """What the commands of machines do on their meters beside what levels take, by the machine's name."""
    out: dict[str, MeterEffect] = {}
    for one in learned:
        if not one.machine or one.machine in out or one.record is None or one.set_to is None:
            continue
        record, m = one.record, model.names.machines.index(one.machine)
        law_W = model.power_by_law_of(m, record)
        begins_s = record.time_s[:-1]
        T_out_C = step_means(record.T_out_C)
        usual = one.usual_at(one.from_origin_s(begins_s, record.origin), T_out_C)
        at_s = clock_s(begins_s, record.origin)
        seen = MeterRecord(one.set_to, usual, law_W, record.power_W[m], T_out_C, at_s, record.step_s)
        if (found := learn_meter(one.command, seen)) is not None:
            out[one.machine] = found
    return out


@dataclass(frozen=True, eq=False)
class _Beside:
    """What the command of actuator `first` does on the meter of machine `m`."""

    first: int
    m: int
    meter: MeterEffect


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
    beside: tuple[_Beside, ...] = ()

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

    def beyond(self, u: Array) -> bool:
        """Whether levels (A, N) ask for more than commands bring at the temperatures that they lead to."""
        reach = self._reach(_zone_C(self.problem, self.operator, u))
        return any((u[a] > high + _BEYOND).any() for a, (_, high) in reach.items())

    def _reach(self, T_C: Array) -> dict[int, tuple[Array, Array]]:
        """Least and largest levels that commands bring at temperatures of the zones (Z, N + 1), by actuator."""
        mean_C = step_means(T_C)
        names = self.operator.actuators
        opened = {names[a]: loop.learned.loop.opened(mean_C[loop.room]) for a, loop in self.loops.items()}
        return {
            a: loop.reach(mean_C[loop.room], loop.learned.loop.taken(opened), float(self._tables.before[a]))
            for a, loop in self.loops.items()
        }

    def realise(self, u: Array, evaluator: Evaluator) -> Commanded:
        """Commands for levels `u` (A, N) from what is set now, and what the loops answer."""
        knobs = self._knobs()
        left = [a for a in self.loops if a in self.left_alone]
        values: dict[int, Array] = {}
        if knobs:
            dearest = self._dearest(evaluator)

            def cost(rows: Array) -> Array:
                held = {a: rows[:, i] for i, (members, _) in enumerate(knobs) for a in members}
                found = self._brought(u, held | {a: self._usual_row(a)[None] for a in left}, len(rows))
                at_meter = self._at_meter(evaluator, found.levels, held, dearest.per_kWh)
                beside = at_meter.beside
                each = at_meter.cost + beside.after + _CAUTION * beside.sd
                changes = (np.abs(np.diff(rows, axis=2)) > SAME).sum(axis=(1, 2))
                # Less heat than there would be is missing after the plan; more of it earns nothing.
                more_K = found.forced_K - self._alone.forced_K
                worth = np.minimum(_worth(self.operator, self.problem, more_K, dearest), 0.0)
                unsure = _SCATTER * dearest.per_used * found.scatter
                worse = self._held_cost(found.T_C) + self._worse_cost(found.T_C)
                return np.asarray(each - worth + unsure + worse + _PER_CHANGE * dearest.of_levels * changes)

            rows, _ = better_commands([knob for _, knob in knobs], self._starts(u, knobs), cost)
            values = {a: rows[i] for i, (members, _) in enumerate(knobs) for a in members}
        held = {a: row[None] for a, row in values.items()} | {a: self._usual_row(a)[None] for a in left}
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
        usual = [self._usual_row(members[0]) for members, _ in knobs]
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
                return self._usual_row(a).reshape(self.problem.n_steps, -1)[None, k]
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

        _followed(self.operator, self.problem, self._tables, u, choose)
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

    def saving(
        self, plan: Commanded, evaluator: Evaluator, power_spread: float, scatter_W: Sequence[Array] = ()
    ) -> PlannedSaving:
        """What the commands of a plan save against the usual ones, by the same model.

        Both are followed in houses that differ by the uncertainty of effects, maps and free part, with what is stored
        at the end at its mean cost. `power_spread`: error of what a change of levels does to power, as a share: where
        the record does not tell it, energy lies between what the law of power says of the levels and what the rooms'
        temperatures ask for, the figure in the middle; the better it tells it, the nearer to the law. `scatter_W` (M)
        of machines' meters around their laws, see `scatter_of_days`.
        """
        usual = {a: self._usual_row(a)[None] for a in self.loops}
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
        per_kWh = self._dearest(evaluator).per_kWh
        with_meter, alone_meter = (
            self._at_meter(evaluator, one.levels, held, per_kWh, drawn)
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
        of_levels = cost_alone - self._idle_cost(evaluator)
        cost, energy = cost + beside.cost, energy + beside.kWh
        cost_alone, energy_alone = cost_alone + beside_alone.cost, energy_alone + beside_alone.kWh
        dearest = _MeanCost(cost_alone, of_levels, self._used(alone.levels), energy_alone)
        worth = _worth(self.operator, problem, with_plan.forced_K - alone.forced_K, dearest)
        worth = worth - beside.after + beside_alone.after
        off_peak = alone_meter.peak - with_meter.peak
        saved = cost_alone - cost + worth + by_levels + off_peak
        moved = (beside.cost + beside.after - beside_alone.cost - beside_alone.after)[0]
        by_chance = self._chance_sd({a for a in planned if not np.array_equal(own[a], usual[a])}, scatter_W)
        if by_chance is not None:
            sd = beyond_sd(float(moved), float(of_levels[0]), by_chance)
            saved = saved + sd * standard((len(z), 1), rng)[:, 0]
        # Of peaks no prior is known but what is said.
        prior = float(np.hypot(_SAVES * of_levels[0], off_peak[0]))
        expected, low, high = expected_saving(saved, prior)
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

    def _chance_sd(self, moved: Collection[int], scatter_W: Sequence[Array]) -> float | None:
        """What chance does to the cost of machines whose actuators `moved` have other commands, currency; None: none.

        `scatter_W` (M): of the meters, where no command was learned on them.
        """
        known = dict(enumerate(scatter_W)) | {one.m: one.meter.scatter_W for one in self.beside}
        price, step_s = self.problem.price_per_kWh, self.problem.step_s
        machines = {int(self.problem.machinery.machine_of[a]) for a in moved}
        each = [chance_sd(known[m], price[m], self.clock_s, step_s) for m in machines if m in known]
        return float(np.sqrt(sum(one**2 for one in each))) if moved else None

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
    def _alone(self) -> _Followed:
        """The building under its usual commands."""
        nothing = np.zeros((len(self.spread), self.problem.n_steps))
        return self._brought(nothing, {a: self._usual_row(a)[None] for a in self.loops}, 1)

    @cached_property
    def _tables(self) -> _LoopTables:
        return _LoopTables(self.operator, self.problem, self.loops)

    def _usual_row(self, a: int) -> Array:
        """What the command of actuator `a` usually is, in all parts (P,)."""
        return np.repeat(self.loops[a].usual, self.loops[a].parts)

    def _brought(
        self,
        u: Array,
        held: Mapping[int, Array],
        S: int,
        gain: Array | None = None,
        z: Array | None = None,
        away_K: Array | float = 0.0,
    ) -> _Followed:
        """S buildings under commands `held` (S or 1, P) of all parts, by actuator; see `_followed`."""
        of_step = {a: rows.reshape(len(rows), self.problem.n_steps, -1) for a, rows in held.items()}
        gain = np.ones((S, len(u))) if gain is None else gain

        def told(a: int, k: int, T_C: Array, before: Array) -> Array:
            return of_step[a][:, k]

        return _followed(self.operator, self.problem, self._tables, u, told, gain, z, away_K)

    def _dearest(self, evaluator: Evaluator) -> _MeanCost:
        """What the building costs when it is left alone."""
        levels = self._alone.levels
        usual = {one.first: self._usual_row(one.first)[None] for one in self.beside}
        at_meter = self._at_meter(evaluator, levels, usual, 0.0)
        (brought,), more = at_meter.law, at_meter.beside
        kWh = energy_kWh(brought.power_W.sum(), self.problem.step_s) + more.kWh
        cost = brought.energy_cost.sum()
        of_levels = np.array([cost - self._idle_cost(evaluator)])
        return _MeanCost(cost + more.cost, of_levels, self._used(levels), kWh)

    def _idle_cost(self, evaluator: Evaluator) -> float:
        """What is on the meters at no level, currency: it is no cost of heat."""
        nothing = np.zeros((len(self.spread), self.problem.n_steps))
        return float(evaluator.brings(self.problem, nothing).energy_cost.sum())

    def _at_meter(
        self,
        evaluator: Evaluator,
        levels: Array,
        held: Mapping[int, Array],
        per_kWh: Array | float,
        effects: Sequence[Array] = (),
    ) -> _AtMeter:
        """What levels (S, A, N) under commands `held` cost by the statement, see `_on_meters`."""
        numbers = evaluator.numbers(self.problem)
        law = whole = [evaluator.evaluate(numbers, u) for u in levels]
        beside = self._on_meters(held, np.stack([one.power_W for one in law]), per_kWh, effects)
        if self.beside and evaluator.sees_the_meter:
            whole = [
                evaluator.evaluate(evaluator.beside(numbers, W), u) for u, W in zip(levels, beside.power_W, strict=True)
            ]
            bought = [one.parts["energy"] - by.parts["energy"] for one, by in zip(whole, law, strict=True)]
            beside = replace(beside, cost=beside.cost + np.array(bought))
        peak, cap = (np.array([one.parts[part] for one in whole]) for part in ("peak", "cap"))
        moved = [one.parts["peak"] + one.parts["cap"] for one in law]
        cost = np.array([one.cost for one in law]) - moved + peak + cap + beside.cost
        return _AtMeter(law, beside, cost, peak, cap)

    def _on_meters(
        self, held: Mapping[int, Array], law_W: Array, per_kWh: Array | float, effects: Sequence[Array] = ()
    ) -> _OnMeters:
        """What commands `held` (S or 1, P), by actuator, cost and take on meters beside what levels do there.

        `law_W` (S, M, N): power by levels; `per_kWh`: what energy that follows after the plan counts; `effects` (S, p)
        of each of `beside`, the most likely ones by default.
        """
        S = len(law_W)
        cost, kWh, after, variance = np.zeros(S), np.zeros(S), np.zeros(S), np.zeros(S)
        power_W = np.zeros((S, self.problem.n_steps))
        for i, one in enumerate(self.beside):
            loop, meter, law = self.loops[one.first], one.meter, law_W[:, one.m]
            usual, (now, left) = self._usual_row(one.first), self._courses_begin[i]
            values = held.get(one.first, usual[None])
            course = meter.course(values, usual, loop.step_s / loop.parts, loop.parts, law, self.clock_s, now, left)
            of = effects[i] if effects else meter.mean[None]
            beside_W = meter.power_W(course, of, law, self.clock_s)
            each_kWh = energy_kWh(beside_W, self.problem.step_s)
            power_W += beside_W
            price = self.problem.price_per_kWh[one.m]
            cost += each_kWh @ price
            kWh += each_kWh.sum(axis=1)
            after += np.einsum("ps,sp->s", course.after_h, np.broadcast_to(of, (S, of.shape[-1]))) / 1000.0 * per_kWh
            moved = energy_kWh(course.columns @ price, self.problem.step_s) + course.after_h * per_kWh / 1000.0
            variance += ((moved.T @ meter.root) ** 2).sum(axis=1)
        return _OnMeters(cost, kWh, after, np.sqrt(variance), power_W)

    @cached_property
    def _courses_begin(self) -> tuple[tuple[CourseState, float], ...]:
        """Where the course of each of `beside` begins, and what warm water still gives while the machine is off."""
        found = []
        for one in self.beside:
            loop, usual = self.loops[one.first], float(self._usual_row(one.first)[0])
            state, T_C = self.now[one.first], float(self.problem.T_now_C[loop.room])
            now = one.meter.begin(state.value, usual, state.held_s, float(self.clock_s[0]))
            found.append((now, left_of(loop.learned, one.meter, usual, T_C, float(loop.T_out_C[0]))))
        return tuple(found)

    def _used(self, levels: Array) -> Array:
        """Levels (S, A, N) by what their actuators take of the power, (S,)."""
        return np.asarray((_per_u(self.problem) * levels.sum(axis=2)).sum(axis=1))


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


@dataclass(frozen=True, eq=False)
class _Followed:
    """S houses under commands: levels (S, A, N), and forced states at the end (S, Z, A, r), K.

    `T_C` (S, Z, N + 1): temperatures of the zones, now and at the end of each step; `scatter` (S,): of the levels,
    summed like `CommandedPlan._used`.
    """

    levels: Array
    T_C: Array
    forced_K: Array
    scatter: Array

    @property
    def T_bounds_C(self) -> Array:
        """`T_C` of the first house, (Z, N + 1)."""
        return np.asarray(self.T_C[0])


def _followed(
    operator: BuildingOperator,
    problem: MPCProblem,
    tables: _LoopTables,
    u: Array,
    values_of: Callable[[int, int, Array, Array], Array],
    gain: Array | None = None,
    z: Array | None = None,
    away_K: Array | float = 0.0,
) -> _Followed:
    """Follow a building under the commands of `tables`, step by step; an actuator without one has levels `u` (A, N).

    `values_of`: of an actuator in a step, for rooms now (S, Z), °C, and x of the last step (S, A), see `LoopMap`, its
    commands in the parts of the step (S or 1, n). `gain` (S, A): effect of what the actuators do from now on, as a
    multiple; `z` (S,): see `LoopMap.level`; `away_K` (S, Z, n): by how much free parts are higher than predicted.
    """
    A, n = u.shape
    gain = np.ones((1, A)) if gain is None else gain
    z = np.zeros(len(gain)) if z is None else z
    S, T_free = len(gain), problem.T_free_C + away_K
    old, new = problem.forced_state_K, np.zeros((S, *problem.forced_state_K.shape))
    T = np.repeat(problem.T_now_C[None], S, axis=0)
    before, levels, course = np.repeat(tables.before[None], S, axis=0), np.empty((S, A, n)), [T]
    nothing, scatter = np.zeros(A), np.zeros(S)
    for k in range(n):
        values = {a: values_of(a, k, T, before) for a in tables.loops}
        faded = operator.advance(old, nothing)
        at_rest = T_free[..., k] + faded.sum(axis=(1, 2)) + (operator.poles * new).sum(axis=(2, 3))
        seen = old + new[0]
        modulation = operator.modulated(np.ones(A), problem.features[:, k], seen)
        level = np.repeat(u[None, :, k], S, axis=0)
        tables.settle(k, values, level, before, z, T, at_rest, modulation * gain, scatter)
        drive = modulation * _heat(operator, problem, level, k) * gain
        old, new = faded, operator.poles * new + operator.gains * drive[:, None, :, None]
        T = T_free[..., k] + old.sum(axis=(1, 2)) + new.sum(axis=(2, 3))
        levels[:, :, k] = level
        course.append(T)
    return _Followed(levels, np.stack(course, axis=2), old + new, scatter)


class _LoopTables:
    """`loops` by number of the actuator, one at least, and heat by level as arrays, for `_settle`."""

    def __init__(self, operator: BuildingOperator, problem: MPCProblem, loops: Mapping[int, CommandedLoop]) -> None:
        self.loops = loops
        table = np.repeat(np.linspace(0.0, 1.0, _TABLE)[:, None], len(operator.home), axis=1)
        self._heat = [np.ascontiguousarray(_heat(operator, problem, table, k)) for k in range(problem.n_steps)]
        self._maps = _Maps.of(loops, operator.actuators)
        self._per_u, self._per_drive = _per_u(problem), np.ascontiguousarray(operator.gains.sum(axis=2))
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
        """Set what loops answer in step `k` in `level` (S, A), and add to `scatter` (S,), see `_Followed`.

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
    `_LoopTables`. Writes `level` and `before` (S, A) and adds to `scatter` (S,).
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


def _zone_C(problem: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Zone temperatures at the boundaries under levels (A, N), (Z, N + 1), °C."""
    comes = u if problem.available is None else u * problem.available
    brought = operator.rollout(problem.forced_state_K, comes, problem.features).sum(axis=(1, 3))
    return np.concatenate([problem.T_now_C[:, None], compose(problem.T_free_C, brought)], axis=1)


@dataclass(frozen=True, eq=False)
class _OnMeters:
    """What S buildings take on meters beside what levels do: currency and kWh (S,), and after the plan; `sd` of both
    costs by what is not known of effects; mean `power_W` (S, N) over each step."""

    cost: Array
    kWh: Array
    after: Array
    sd: Array
    power_W: Array


@dataclass(frozen=True, eq=False)
class _AtMeter:
    """What S buildings cost (S,), currency, all in all, and of it the `peak` and power above a `cap`.

    `law`: what levels alone bring; `beside`: what commands do beside them, with what it changes of what is bought.
    """

    law: Sequence[Evaluation]
    beside: _OnMeters
    cost: Array
    peak: Array
    cap: Array


@dataclass(frozen=True, eq=False)
class _MeanCost:
    """What S buildings cost (S,), currency, of it for levels, the levels (S,) and energy (S,), kWh, that they used for
    it, see `CommandedPlan._used`."""

    cost: Array
    of_levels: Array
    used: Array
    kWh: Array

    @property
    def per_kWh(self) -> Array:
        """Mean price of energy, (S,)."""
        return np.asarray(self.cost / np.maximum(self.kWh, 1e-6))

    @property
    def per_used(self) -> Array:
        """Mean cost of a level, (S,)."""
        return np.where(self.used > 1e-6, np.maximum(self.of_levels, 0.0) / np.maximum(self.used, 1e-6), 0.0)


def _beyond(out_K: Array, sd_K: Array) -> Array:
    """How far beyond a bound a room is on average, K, more than by `out_K` (negative inside) itself; error `sd_K`."""
    from scipy.special import ndtr

    sd_K = np.maximum(sd_K, 1e-6)
    density = np.exp(-0.5 * (out_K / sd_K) ** 2) / np.sqrt(2.0 * np.pi)
    return np.asarray(out_K * ndtr(out_K / sd_K) + sd_K * density - np.maximum(out_K, 0.0))


def _per_u(problem: MPCProblem) -> Array:
    """What a level of each actuator (A,) takes of the power, in any unit."""
    per_u = np.maximum(problem.power_per_u_W.mean(axis=1), 0.0)
    return per_u if per_u.any() else np.ones(per_u.size)


def _worth(operator: BuildingOperator, problem: MPCProblem, more_K: Array, mean: _MeanCost) -> Array:
    """What the states at the end (S, Z, A, r) that differ by `more_K` are worth, (S,).

    A kelvin of an actuator's slowest mode in its home zone took so many steps at full level; they count at the `mean`
    cost of a level, by what its actuator takes of the power.
    """
    per_u, price = _per_u(problem), mean.per_used
    worth, ones = np.zeros(len(more_K)), np.ones(1)
    for a, home in enumerate(operator.home):
        pair, features = operator.of_actuator(a), problem.features[home, -1]
        slowest = int(np.flatnonzero(pair.acting)[-1])
        drive = float(pair.drive(ones, features[None])[0])
        if pair.gains[slowest] * drive:
            worth += price * per_u[a] * more_K[:, home, a, slowest] / (pair.gains[slowest] * drive)
    return worth


def _turns(row: Array, part_s: float) -> Turns:
    """Commands of the parts of a step (n,) as turns."""
    return tuple((value, part_s * len(list(same))) for value, same in groupby(row.tolist()))
