"""The actuators of a building, acting together: levels of all become blocks of all.

On/off blocks of actuators that share a machine lie within those of the one that is on longest, so that the machine runs
no longer: all at the start of a step while it runs, all at its end while it stands; two such steps in a row join to one
run. Where together they would need more than the machine has they take turns in it, since beyond its capacity the water
cools and the warmest rooms go without; where turns do not suffice, each holds a part level for all of the run. Minimum
on and off times are those of the machine, whichever of its actuators is on. Where the plan sets the machine's water, it
is as warm as the valve with the highest level needs it when it is open for all of the step.

Of actuators that exclude one another one acts in a step: one that must stay on for its minimum time, else the one with
the largest demand.

What a limit of power leaves for actuators whose plan becomes blocks.

Blocks are whole, and carry on-time over from step to step: a step may take more than its plan gave it. Where power has
a cap or a peak has a price, actuators become blocks one after another, each within what those before it and the plans
of those to come leave. The power of levels is the one that plans count with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby

import numpy as np

from controllers.actuation.actuator import Actuation, ActuationState
from thermoforce_mpc.data import Array, Block, Layout, Names, Record, steps_in
from thermoforce_mpc.data.clock import CLOCK_TOLERANCE_S

# Power nearer than this to a limit is at it, W; levels of that distance, and of the search.
_SAME_W, _SAME_LEVEL = 1.0, 1e-6


@dataclass(frozen=True)
class PowerLimit:
    """How much all machines may take together, mean over one step.

    `cap_W`: infinite without a cap; blocks exceed it only as far as the plan does. `peak_W`: highest power that is free
    or planned, infinite where peaks are; blocks are rounded to it. `planned` (A,): levels of the plan; `power_W`:
    power, W, of mean levels (A,); `exempt`: numbers of the actuators of which something else than the plan decides.
    """

    cap_W: float
    peak_W: float
    planned: Array
    power_W: Callable[[Array], float]
    exempt: frozenset[int] = frozenset()

    @cached_property
    def within_W(self) -> float:
        """The cap, or what the plan takes where it pays for more, W."""
        return self.cap_W if math.isinf(self.cap_W) else max(self.cap_W, self.power_W(self.planned))

    def without(self, actuators: Collection[int]) -> PowerLimit:
        """The same where something else decides of `actuators`."""
        return replace(self, exempt=frozenset(actuators))


class PowerRoom:
    """What is left of a limit while actuators become blocks, one after another; without a limit, everything."""

    def __init__(self, limit: PowerLimit | None) -> None:
        self._limit, self._levels = limit, np.zeros(0) if limit is None else limit.planned.copy()
        self._forced: list[int] = []

    def limits(self, a: int) -> bool:
        """Whether actuator `a` is to stay within the limit."""
        return self._limit is not None and a not in self._limit.exempt

    def most(self, a: int, half_block: float) -> float:
        """Highest mean level that actuator `a` may have; `half_block`: by which a level is rounded up at a peak."""
        if self._limit is None or not self.limits(a):
            return math.inf
        within, peak = (self._level_at(a, self._limit.power_W, W) for W in (self._limit.within_W, self._limit.peak_W))
        return min(within, peak + half_block)

    def take(self, a: int, level: float | None, most: float = math.inf) -> None:
        """Count the mean `level` of actuator `a`, which had `most`; None, native control, counts as planned."""
        if self._limit is None or level is None:
            return
        self._levels[a] = level
        if level > most + _SAME_LEVEL:
            self._forced.append(a)

    def over_in_words(self, names: Names) -> str:
        """What takes the step above the limit, or ''."""
        limit = self._limit
        if limit is None:
            return ""
        takes_W = limit.power_W(self._levels)
        takes, most_W = f"this step takes {takes_W / 1000.0:.2f} kW", min(limit.within_W, limit.peak_W)
        if self._forced and takes_W > most_W + _SAME_W:
            which = ", ".join(names.actuators[a] for a in self._forced)
            return f"{takes} where {most_W / 1000.0:.2f} kW are planned at most: minimum on time of {which}"
        if takes_W > limit.cap_W + _SAME_W:
            return f"{takes}, above the cap of {limit.cap_W / 1000.0:g} kW: comfort is worth its price"
        return ""

    def _level_at(self, a: int, power_W: Callable[[Array], float], limit_W: float) -> float:
        """Level of actuator `a` at which all machines take `limit_W`; infinite where they do not take as much."""
        from scipy.optimize import brentq

        levels = self._levels.copy()

        def excess_W(level: float) -> float:
            levels[a] = level
            return power_W(levels) - limit_W

        if math.isinf(limit_W) or excess_W(1.0) <= _SAME_W:
            return math.inf
        return 0.0 if excess_W(0.0) >= 0.0 else float(brentq(excess_W, 0.0, 1.0, xtol=_SAME_LEVEL))


# Two instants nearer than this are one, s: rounding.
_SAME_S = 1e-6
# Least capacity of a machine, so that nothing is divided by 0.
_LEAST = 1e-6

Demand = float | None | tuple[Block, ...]
"""What one actuator is to do in a step: a mean level, native control (None), or blocks of its own (commands)."""


@dataclass(frozen=True)
class ActuatorBlocks:
    """Blocks of each actuator (A,), each of one actuator, and the states after them (A,).

    `excluded`: actuators that do not meet their demand, each with the one that excludes it. `over`: what
    takes the step above a limit of power, in words.
    """

    blocks: tuple[tuple[Block, ...], ...]
    states: tuple[ActuationState, ...]
    excluded: Mapping[int, int] = field(default_factory=dict)
    over: str = ""

    def together(self) -> tuple[Block, ...]:
        """The blocks of all actuators: one wherever any of them changes."""
        return merged(self.blocks)


class Actuators:
    """Converts demands on all actuators (A,) into blocks."""

    def __init__(self, layout: Layout, actuations: Sequence[Actuation]) -> None:
        self.layout, self.each = layout, tuple(actuations)
        self._shared = [fed for fed in layout.actuators_of_machines if len(fed) > 1]
        self._water = [fed for fed in layout.actuators_of_machines if all(self.each[a].by_supply for a in fed)]

    def check_step(self, step_s: float) -> None:
        """Raise `ControllerConfigError` where a step of `step_s` seconds is too short for blocks."""
        for actuation in self.each:
            actuation.check_step(step_s)

    def now(
        self, states: Sequence[ActuationState] | None, history: Record, until_s: float | None = None
    ) -> tuple[ActuationState, ...]:
        """States at the start of the next step, see `Actuation.now`.

        `until_s`: end of the step that led to `states`, s. Where that is not now, what came after had no plan: native
        control has acted.
        """
        if states is not None and (until_s is None or abs(until_s - history.time_s[-1]) > CLOCK_TOLERANCE_S):
            states = (ActuationState(native=True),) * len(self.each)
        return tuple(
            actuation.now(
                None if states is None else states[a], history.u[a], history.step_s, self._of_machine(a, history.u)
            )
            for a, actuation in enumerate(self.each)
        )

    def _of_machine(self, a: int, u: Array) -> Array | None:
        """The highest of the levels `u` (A, n) that the machine of actuator `a` feeds (n,); None where no limit of
        starts asks for it."""
        if self.each[a].config.starts_per_hour is None:
            return None
        return np.asarray(np.max(np.nan_to_num(u[self.layout.fed_by(self.layout.machine_of[a])]), axis=0))

    def realise(
        self,
        demands: Sequence[Demand],
        step_s: float,
        states: Sequence[ActuationState],
        limit: PowerLimit | None = None,
        capacity: Array | None = None,
    ) -> ActuatorBlocks:
        """Blocks of length `step_s` that come as near to `demands` (A,) as the limits allow, and the states after.

        `capacity` (M,): what the actuators of each machine take together at most in this weather, in the unit of their
        shares; None: 1.
        """
        wanted = [self._demand_size(a, demand, states[a]) for a, demand in enumerate(demands)]
        excluded = self.layout.excluded(wanted)
        native = {a for a in excluded if demands[excluded[a]] is None}
        exclusions = {a: by for a, by in excluded.items() if a in native or demands[a]}
        demands = [None if a in native else 0.0 if a in excluded else demand for a, demand in enumerate(demands)]
        room = PowerRoom(limit)
        loads = [share / most for share, most in zip(self.layout.shares, self._capacity(capacity), strict=True)]
        realised = self._realise_each(demands, step_s, states, excluded, room, loads)
        # Exclusion comes before minimum times, for which one may be on without a demand.
        acts = [
            None if demands[a] is None else any(block.u[0] for block in blocks) * (1.0 + (wanted[a] or 0.0))
            for a, (blocks, _) in enumerate(realised)
        ]
        for a in self.layout.excluded(acts):
            starts_s = self.each[a].starts_after(states[a], step_s)
            realised[a] = (Block(0.0, step_s),), ActuationState(on=False, held_s=step_s, starts_s=starts_s)
            room.take(a, 0.0)
        exclusions = {a: by for a, by in exclusions.items() if not any(block.u[0] for block in realised[a][0])}
        return ActuatorBlocks(
            tuple(blocks for blocks, _ in realised),
            tuple(state for _, state in realised),
            exclusions,
            room.over_in_words(self.layout.names),
        )

    def _capacity(self, capacity: Array | None) -> Array:
        """That of the machine of each actuator (A,)."""
        return (
            np.ones(len(self.each)) if capacity is None else np.maximum(capacity, _LEAST)[list(self.layout.machine_of)]
        )

    def excluded_in_words(self, acted: ActuatorBlocks) -> list[str]:
        """Which actuators do not meet their demand because another one acts."""
        names = self.layout.names
        return [
            names.of_actuator(
                a, f"excluded by {names.actuators[by]}" + (", which is native: native control" if native else "")
            )
            for a, by in acted.excluded.items()
            for native in [acted.states[by].native]
        ]

    def _demand_size(self, a: int, demand: Demand, state: ActuationState) -> float | None:
        """How much actuator `a` is wanted, see `Layout.excluded`; one that must stay on comes before all others."""
        if demand is None or isinstance(demand, tuple):
            return None if demand is None else max(abs(block.u[0] or 0.0) for block in demand)
        return demand / self.each[a].highest + self.each[a].must_stay_on(state)

    def _realise_each(
        self,
        demands: Sequence[Demand],
        step_s: float,
        states: Sequence[ActuationState],
        excluded: Collection[int],
        room: PowerRoom,
        loads: Sequence[float],
    ) -> list[tuple[tuple[Block, ...], ActuationState]]:
        """Blocks and states of all actuators (A,), one after another where power is limited.

        First those that the limit does not move, then those that must stay on, then those to which most is owed.
        `loads` (A,): what full level of each takes of its machine's capacity.
        """
        levels = {a: float(level) for a, level in enumerate(demands) if isinstance(level, float | int)}
        shared = [{a: levels[a] for a in fed if a in levels and not self.each[a].modulates} for fed in self._shared]
        shared = [of_machine for of_machine in shared if len(of_machine) > 1]
        water = {
            a: max((self.each[b].water(levels[b]) for b in fed if b in levels), default=0.0)
            for fed in self._water
            for a in fed
        }
        realised: dict[int, tuple[tuple[Block, ...], ActuationState]] = {}
        alone = [a for a in range(len(demands)) if not any(a in of_machine for of_machine in shared)]
        for a in sorted(
            alone, key=lambda a: (room.limits(a), not self.each[a].must_stay_on(states[a]), -states[a].owed_s)
        ):
            demand, most = demands[a], room.most(a, self.each[a].half_block(step_s))
            if isinstance(demand, tuple):
                realised[a] = demand, states[a]
            else:
                realised[a] = self.each[a].realise(demand, step_s, states[a], water.get(a, 0.0), most)
            room.take(a, _mean_level(realised[a][0]), most)
        for of_machine in shared:
            realised |= self._realise_shared(of_machine, step_s, states, excluded, room, loads)
        return [realised[a] for a in range(len(demands))]

    def _realise_shared(
        self,
        levels: Mapping[int, float],
        step_s: float,
        states: Sequence[ActuationState],
        excluded: Collection[int],
        room: PowerRoom,
        loads: Sequence[float],
    ) -> dict[int, tuple[tuple[Block, ...], ActuationState]]:
        """Blocks of the actuators of one machine at mean `levels`, beside those of the one that is on longest."""
        wanted_s = {
            a: level / self.each[a].config.level * step_s + states[a].owed_s if level > 0 else 0.0
            for a, level in levels.items()
        }
        lead = max(levels, key=lambda a: (wanted_s[a], a not in excluded, states[a].on))
        running = machine_state([states[a] for a in levels])
        most = room.most(lead, self.each[lead].half_block(step_s))
        begun = replace(running, owed_s=states[lead].owed_s)
        blocks, after = self.each[lead].realise(levels[lead], step_s, begun, most=most)
        room.take(lead, _mean_level(blocks), most)
        runs_s = sum(block.duration_s for block in blocks if block.u[0])
        realised = {lead: (blocks, after)}
        block_s = {a: self.each[a].config.block_s for a in levels}
        on_s = {a: min(round(max(wanted_s[a], 0.0) / block_s[a]) * block_s[a], runs_s) for a in levels if a != lead}
        for a in sorted(on_s, key=lambda a: -states[a].owed_s):
            full = self.each[a].config.level
            within_s = room.most(a, self.each[a].half_block(step_s)) / full * step_s
            if within_s < on_s[a]:
                on_s[a] = math.floor(within_s / block_s[a]) * block_s[a]
            room.take(a, on_s[a] / step_s * full)
        slots, load = self._assign_slots(lead, on_s, runs_s, loads)
        acting = [lead, *(a for a, seconds in on_s.items() if seconds)]
        if load > 1.0 and all(self.each[a].part_levels for a in acting):
            return self._at_part_levels(levels, step_s, running, lead, most, loads)
        starts_on, idle = bool(blocks[0].u[0]), Block(0.0, step_s - runs_s)
        for a, of_run in slots.items():
            level, slot_s = self.each[a].config.level, runs_s / len(of_run)
            run = [Block(level if on else 0.0, slot_s * len(list(same))) for on, same in groupby(of_run)]
            sequence = [*run, idle] if starts_on else [idle, *run[::-1]]
            owed_s = min(max(wanted_s[a] - on_s[a], -block_s[a]), block_s[a])
            own_blocks = tuple(block for block in sequence if block.duration_s > _SAME_S)
            realised[a] = own_blocks, replace(after, owed_s=owed_s)
        return realised

    def _assign_slots(
        self, lead: int, on_s: Mapping[int, float], runs_s: float, shares: Sequence[float]
    ) -> tuple[dict[int, list[bool]], float]:
        """Whether each actuator beside the `lead` is on in each slot of a run, and the largest load of a slot.

        The load is a share of the machine's capacity. Actuators that take most choose first: the first slots in which
        the machine can feed them too, since a machine that cycles at a low load runs least where all are on together,
        then those with the least excess.
        """
        loads = [shares[lead]] * steps_in(runs_s, self.each[lead].config.block_s)
        is_on: dict[int, list[bool]] = {}
        for a in sorted(on_s, key=lambda a: -shares[a] * on_s[a]):
            count = round(on_s[a] / runs_s * len(loads)) if runs_s else 0
            excess = [max(load + shares[a] - 1.0, 0.0) for load in loads]
            slots = sorted(range(len(loads)), key=lambda i: excess[i])[:count]
            is_on[a] = [i in slots for i in range(len(loads))]
            loads = [load + shares[a] * on for load, on in zip(loads, is_on[a], strict=True)]
        return is_on, max(loads)

    def _at_part_levels(
        self,
        levels: Mapping[int, float],
        step_s: float,
        running: ActuationState,
        lead: int,
        most: float,
        loads: Sequence[float],
    ) -> dict[int, tuple[tuple[Block, ...], ActuationState]]:
        """One run for all actuators of a machine, each at the level that gives its mean of `levels`.

        The run is as long as the `lead` is to be on, and as the load of all needs at full capacity.
        """
        load = min(sum(loads[a] * level for a, level in levels.items()), 1.0)
        on = max(levels[lead], load * self.each[lead].config.level)
        blocks, after = self.each[lead].realise(on, step_s, running, most=most)
        runs_s = sum(block.duration_s for block in blocks if block.u[0])
        after, realised = replace(after, owed_s=0.0), {}
        for a, level in levels.items():
            run_level = min(level * step_s / runs_s, self.each[a].config.level) if runs_s else 0.0
            realised[a] = tuple(Block(run_level if block.u[0] else 0.0, block.duration_s) for block in blocks), after
        return realised


def machine_state(states: Sequence[ActuationState]) -> ActuationState:
    """State of a machine from those of its actuators: it runs while one of them is on, since the first came on."""
    running = [state.held_s for state in states if state.on]
    held_s = max(running) if running else min(state.held_s for state in states)
    ages_s = sorted(age_s for state in states for age_s in state.starts_s)
    starts_s = tuple(age_s for i, age_s in enumerate(ages_s) if i == 0 or age_s - ages_s[i - 1] > _SAME_S)
    return ActuationState(bool(running), held_s, starts_s=starts_s)


def _mean_level(blocks: Sequence[Block]) -> float | None:
    if any(block.u[0] is None for block in blocks):
        return None
    return sum((block.u[0] or 0.0) * block.duration_s for block in blocks) / sum(block.duration_s for block in blocks)


def merged(blocks: Sequence[Sequence[Block]]) -> tuple[Block, ...]:
    """Blocks of single actuators (A,), each sequence of one length in time, as blocks of all."""
    if len(blocks) == 1:
        return tuple(blocks[0])
    ends = sorted({end for own_blocks in blocks for end in _end_times(own_blocks)})
    instants = [end for i, end in enumerate(ends) if i == 0 or end - ends[i - 1] > _SAME_S]
    out, start = [], 0.0
    for end in instants:
        at = [_block_at(own_blocks, 0.5 * (start + end)) for own_blocks in blocks]
        out.append(Block(tuple(block.u[0] for block in at), end - start, [block.command[0] for block in at]))
        start = end
    return tuple(out)


def _end_times(blocks: Sequence[Block]) -> list[float]:
    ends, t = [], 0.0
    for block in blocks:
        t += block.duration_s
        ends.append(t)
    return ends


def _block_at(blocks: Sequence[Block], time_s: float) -> Block:
    t = 0.0
    for block in blocks:
        t += block.duration_s
        if time_s < t:
            return block
    return blocks[-1]
