"""Conversion of a planned level into actuator blocks: on/off blocks at one level, or one level held for the step.

In `modulating` mode higher levels are held for the step, and lower ones are made of blocks at the lowest, at which heat
is cheapest; in `duty` mode there is no higher one. Blocks respect minimum on and off times across steps, and what they
leave of the on-time is carried over to the next step. With a lowest level of 0 any level is held (the paper's setting).
In `supply` mode the level is the heat that the machine's water gives, which all its valves share: one that needs less
is open for a part of the step.

The choice of the actuation where `mode` is auto, and the power that plans count with.

Each machine gives heat most cheaply at one level: one with a fixed loss while it runs at a high one, one whose water
gets hotter with the level at a low one. What heat costs at the levels that were tried is on the model card
(`LevelCost`). At the cheapest of them the machine is switched, and higher levels are held where they are needed. Where
nothing is known of part load it is switched at full level, as where power has a fixed part and heat is not measured, or
power depends on the return water, which was cooler in the trials.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from controllers.checks import ControllerConfigError
from thermoforce_mpc.data import HOUR_S, Array, Block
from thermoforce_mpc.model.machine.power import (
    LevelCost,
    PowerModel,
    PowerShape,
    cheapest,
    fixed_part,
    part_load,
)
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.scenario.settings import StrictModel

# Shares and levels below this mean off (signed: neither heating nor cooling); also the tolerance on measured mean
# levels. A tolerance of solvers and meters, not tuned.
OFF = 1e-3
# Shares of a step nearer than this are one: rounding.
_SAME = 1e-6


class ActuationConfig(StrictModel):
    """Options of the conversion from planned level to actuator signal."""

    mode: Literal["auto", "duty", "modulating", "supply", "room_setpoints"] = Field(
        "auto",
        description="duty: on/off blocks at `level`; modulating: a level held for the step, blocks below "
        "`lowest_level`; auto: at the level at which heat costs least by the identified laws, see `tf-mpc inspect` "
        "(duty where they say nothing of part load); supply: water as warm as the "
        "neediest valve asks for (test cases whose machine has `supply`); room_setpoints: the plant's own loops keep "
        "the planned temperature (test cases of that kind)",
    )
    level: float = Field(1.0, gt=0, le=1, description="duty: level while on")
    # Five minutes, three blocks a step: half of the shortest times below.
    block_s: float = Field(300.0, ge=30, description="duty: on and off times are multiples of this, s")
    # Compressors are kept from short cycles by 3 to 10 minutes, as their makers ask: the longest of these.
    min_on_s: float = Field(600.0, ge=0, description="duty: minimum on time, s")
    min_off_s: float = Field(600.0, ge=0, description="duty: minimum off time, s")
    starts_per_hour: int | None = Field(
        None,
        ge=1,
        le=60,
        description="duty: most starts of a machine in any hour, as its data sheet says; null: as many as minimum on "
        "and off times leave",
    )
    # Inverters of heat pumps go down to a quarter or a third of full power, which is the usual range.
    lowest_level: float = Field(
        0.3,
        ge=0,
        le=1,
        description="modulating: level below which blocks at it are made; 0: any level is held, and its power and "
        "heat count in proportion to it (the paper's); supply: level below which valves open for a part of the step",
    )

    @model_validator(mode="after")
    def _consistent(self) -> ActuationConfig:
        for name in ("min_on_s", "min_off_s"):
            if getattr(self, name) % self.block_s:
                raise ValueError(f"{name} must be a multiple of block_s ({self.block_s:g} s)")
        return self

    @property
    def least_cycle_s(self) -> float:
        """Least mean time from one start to the next, s."""
        return max(self.min_on_s + self.min_off_s, HOUR_S / self.starts_per_hour if self.starts_per_hour else 0.0)


@dataclass(frozen=True)
class ActuationState:
    """State of the machine between steps.

    `on`: on or off; `held_s`: time in that state, s; `owed_s`: on-time carried over to later plans, s; `native`: the
    plant has been under native control since, so the other fields are unknown. `command`: of an actuator that is set by
    one, the command that has been held for `held_s`; `owed_s` is at full level then. `starts_s`: how long ago it
    started, each time within the last hour, the last first, s; kept where `starts_per_hour` is limited.
    """

    on: bool = False
    held_s: float = math.inf
    owed_s: float = 0.0
    native: bool = False
    command: float | None = None
    starts_s: tuple[float, ...] = ()


# Unknown state: assume it has just switched off, so the full minimum off time applies.
_UNKNOWN = ActuationState(on=False, held_s=0.0)


class Actuation:
    """Converts planned levels into blocks; the machine's state is passed from step to step as a value.

    `mode` auto, which only a model can decide (`choice`), is duty here. `part_levels`: in `duty` mode a level between
    off and `level` may be held where blocks would not do.

    `by_supply`: the plan sets the machine's water; `by_rooms`: the plant's own loops keep room set-points; `modulates`:
    levels above that of blocks, `block_level`, are held for the step; `switches`: it makes blocks, at one level or
    below its lowest. `highest`: of a plan; levels below `lowest_level` cost and heat as their share of it, all where it
    is `highest`.
    """

    def __init__(self, config: ActuationConfig, *, part_levels: bool = False) -> None:
        self.config, self.part_levels = config, part_levels
        self.by_supply, self.by_rooms = config.mode == "supply", config.mode == "room_setpoints"
        self.modulates = config.mode in ("modulating", "supply")
        self.switches = not self.modulates or (not self.by_supply and config.lowest_level > 0.0)
        self.block_level = config.lowest_level if self.modulates else config.level
        self.highest = 1.0 if self.modulates else config.level
        self.lowest_level = self.block_level if self.switches else self.highest

    @property
    def in_words(self) -> str:
        """The actuation in a few words."""
        if self.by_rooms:
            return "room set-points, kept by the plant's own loops"
        if self.by_supply:
            return "water as warm as the neediest valve asks for"
        if not self.modulates:
            return f"on/off blocks at {self.config.level:.2f}"
        if self.config.lowest_level == 0:
            return "modulating, any level held for the step"
        return f"modulating, levels from {self.config.lowest_level:.2f} held for the step, on/off blocks below"

    def must_stay_on(self, state: ActuationState) -> bool:
        """Whether the minimum on time of a machine in `state` has not passed."""
        return self.switches and state.on and state.held_s < self.config.min_on_s

    def starts_after(self, state: ActuationState, step_s: float, ran_s: float | None = None) -> tuple[float, ...]:
        """`ActuationState.starts_s` after a step of `step_s` seconds; `ran_s`: time since a start in it, s."""
        if self.config.starts_per_hour is None:
            return ()
        ages_s = [*([] if ran_s is None else [ran_s]), *(age_s + step_s for age_s in state.starts_s)]
        return tuple(age_s for age_s in ages_s if age_s < HOUR_S)

    def half_block(self, step_s: float) -> float:
        """Mean level of half a block over a step, by which blocks round a level up."""
        return 0.5 * self.config.block_s / step_s * self.block_level if self.switches else 0.0

    def check_step(self, step_s: float) -> None:
        """Raise `ControllerConfigError` where a step of `step_s` seconds is shorter than two blocks."""
        c = self.config
        if (self.by_supply or self.switches) and step_s < 2 * c.block_s:
            raise ControllerConfigError(
                f"controller.options.actuation.block_s: blocks of {c.block_s:g} s cannot share a step of"
                f" {step_s:g} s; use shorter blocks, or mode: modulating with lowest_level: 0"
            )

    def now(
        self, state: ActuationState | None, u: Array, step_s: float, machine_u: Array | None = None
    ) -> ActuationState:
        """State of the machine at the start of the next step.

        It is `state`, except after native control (in the last step, or before the run: `state` None), where it is
        estimated from the measured levels `u` (n,) of the steps of `step_s` seconds until now. `machine_u` (n,): the
        highest level of all that its machine feeds; None: it feeds this one alone.
        """
        if state is not None and not state.native:
            return state
        starts_s = self._starts_from_levels(u if machine_u is None else machine_u, step_s)
        if not (u.size and np.isfinite(u[-1])):
            return replace(ActuationState() if state is None else _UNKNOWN, starts_s=starts_s)
        return replace(self._state_from_levels(u, step_s), starts_s=starts_s)

    def _starts_from_levels(self, u: Array, step_s: float) -> tuple[float, ...]:
        """Starts of the last hour in mean levels of past steps: each as late as its step leaves it."""
        if self.config.starts_per_hour is None:
            return ()
        last = u[-(math.ceil(HOUR_S / step_s) + 1) :]
        on = np.nan_to_num(last) > OFF
        begun = np.flatnonzero(on[1:] & ~on[:-1]) + 1
        share = np.minimum(np.nan_to_num(last) / self.block_level, 1.0)
        ages_s = ((on.size - 1 - begun) + share[begun]) * step_s
        return tuple(sorted(age_s for age_s in ages_s.tolist() if age_s < HOUR_S))

    def _state_from_levels(self, u: Array, step_s: float) -> ActuationState:
        """State estimated from the mean levels of past steps; where ambiguous, the one with the longer wait."""
        level = self.block_level
        off, full = u <= OFF, u >= level - OFF
        between = np.isfinite(u) & ~off & ~full
        if off[-1]:
            return ActuationState(on=False, held_s=_last_run(off) * step_s)
        if full[-1]:
            return ActuationState(on=True, held_s=_last_run(full) * step_s)
        if u.size > 1 and off[-2]:  # on since the last step, at least for its mean share
            return ActuationState(on=True, held_s=float(u[-1]) / level * step_s)
        if u.size > 1 and between[-2]:  # part load for several steps: native modulation
            return ActuationState(on=True, held_s=_last_run(between) * step_s)
        return _UNKNOWN  # full before, or unknown: may have switched off in the last step

    def realise(
        self, u: float | None, step_s: float, state: ActuationState, water: float = 0.0, most: float = math.inf
    ) -> tuple[tuple[Block, ...], ActuationState]:
        """Blocks of total length `step_s` whose mean level is as near to `u` (in [0, `highest`]) as the limits allow.

        `u` None is native control; `water`: level of an open valve, by `supply` (0: as this one needs it); `most`: mean
        level that only a minimum on time exceeds. Returns the blocks and the machine's state after them.
        """
        if u is None:
            return (Block(None, step_s),), ActuationState(native=True)
        if self.by_supply:
            return self._valve_blocks(u, step_s, state, water or self.water(u), most)
        if not self.switches:
            return (Block(min(u, most, 1.0) if u > OFF else 0.0, step_s),), state
        return self._on_off_blocks(u, step_s, state, most)

    def longest_on_s(self, most_s: float, step_s: float) -> float:
        """Longest on-time of a step of `step_s` seconds, at most `most_s`, that blocks can keep up, s.

        A run of the minimum on time may begin at the end of one step and end in the next. Where even half of it takes
        more than `most_s` there is none.
        """
        c = self.config
        if most_s >= step_s:
            return step_s
        on_s = math.floor(most_s / c.block_s + _SAME) * c.block_s
        return on_s if 2.0 * on_s >= c.min_on_s else 0.0

    def water(self, u: float) -> float:
        """Least level at which an open valve can give `u` over a step."""
        return min(max(u, self.config.lowest_level, OFF), 1.0)

    def _valve_blocks(
        self, u: float, step_s: float, state: ActuationState, water: float, most: float
    ) -> tuple[tuple[Block, ...], ActuationState]:
        """Open for about the share of the step in which level `water` gives `u`.

        A valve that was open closes in the step, one that was closed opens in it, so that it moves once. What it gives
        too much or too little is not carried over: closing a valve may stop a machine that hardly runs for the others,
        and the next plan knows the zone.
        """
        c = self.config
        within = np.arange(c.min_on_s, step_s - c.min_off_s + 1e-6, c.block_s)
        wanted_s = u / water * step_s if u > OFF else 0.0
        allowed = [open_s for open_s in (*within.tolist(), step_s) if open_s * water <= (most + _SAME) * step_s]
        on_s = min([0.0, *allowed], key=lambda open_s: abs(open_s - wanted_s))
        parts = ((water, on_s), (0.0, step_s - on_s)) if state.on else ((0.0, step_s - on_s), (water, on_s))
        blocks = tuple(Block(level, t) for level, t in parts if t > 0)
        return blocks, ActuationState(bool(blocks[-1].u[0]), blocks[-1].duration_s)

    def _on_off_blocks(
        self, u: float, step_s: float, state: ActuationState, most: float
    ) -> tuple[tuple[Block, ...], ActuationState]:
        c, on = self.config, state.on
        on_level = min(max(min(u, most), self.block_level), self.highest)
        share = min(max(u / on_level, 0.0), 1.0)
        # A plan of "off" discards the carried-over on-time: it must not heat a zone that needs no heat.
        wanted_s = share * step_s + state.owed_s if share > OFF else 0.0
        longest_s = self.longest_on_s((most / on_level + _SAME) * step_s, step_s)
        stays_s = self._time_in_state(wanted_s, longest_s, step_s, state)
        on_s = stays_s if on else step_s - stays_s
        # The remainder exceeds one block only through minimum times; the cap limits its accumulation.
        cap = max(c.block_s, c.min_on_s, c.min_off_s, self._wait_s(state) if c.starts_per_hour else 0.0)
        owed_s = min(max(wanted_s - on_s, -cap), cap)
        level, level_after = (on_level, 0.0) if on else (0.0, on_level)
        blocks = tuple(Block(u, t) for u, t in ((level, stays_s), (level_after, step_s - stays_s)) if t > 0)
        if stays_s < step_s:
            starts_s = self.starts_after(state, step_s, None if on else step_s - stays_s)
            return blocks, ActuationState(not on, step_s - stays_s, owed_s, starts_s=starts_s)
        starts_s = self.starts_after(state, step_s)
        return blocks, ActuationState(on, state.held_s + step_s, owed_s, starts_s=starts_s)

    def _wait_s(self, state: ActuationState) -> float:
        """Time for which a machine in `state` may not switch yet, s."""
        c = self.config
        if state.on:
            return max(c.min_on_s - state.held_s, 0.0)
        most = c.starts_per_hour
        next_s = HOUR_S - state.starts_s[most - 1] if most and len(state.starts_s) >= most else 0.0
        return max(c.min_off_s - state.held_s, next_s, 0.0)

    def _time_in_state(self, wanted_s: float, longest_s: float, step_s: float, state: ActuationState) -> float:
        """Time before the machine switches, s, for which the on-time of the step is nearest to `wanted_s`.

        It switches at most once per step, at a whole block, and not before the minimum time in its state has passed,
        nor starts once too often in an hour.
        A run that starts in this step may end the step shorter than its minimum: the next step continues it. Both are
        on for `longest_s` at most, unless the machine runs already and its minimum time is longer.
        """
        c = self.config
        left_s = self._wait_s(state)
        blocks = np.arange(0.0, step_s, c.block_s)
        candidates = [*blocks[blocks >= left_s].tolist(), step_s]
        if not state.on:
            # On ties the later start: a later plan may drop it.
            candidates.reverse()
            shortest_s = c.min_on_s - longest_s if longest_s < step_s else 0.0
            allowed = [s for s in candidates if shortest_s <= step_s - s <= longest_s or s == step_s]
        else:
            allowed = [s for s in candidates if s <= longest_s] or candidates[:1]
        return min(allowed, key=lambda stays_s: abs((stays_s if state.on else step_s - stays_s) - wanted_s))


def _last_run(flags: NDArray[np.bool_]) -> int:
    return int(flags.size if flags.all() else np.argmin(flags[::-1]))


@dataclass(frozen=True)
class ActuationChoice:
    """An actuation whose mode is decided, the reason in words, and the power that plans count with."""

    actuation: Actuation
    why: str
    power: PowerModel


def choose_actuation(
    config: ActuationConfig,
    power: PowerModel,
    heat_input: HeatInput,
    costs: Sequence[LevelCost],
    *,
    shared: bool = False,
) -> ActuationChoice:
    """Decide `mode: auto`; another mode stays.

    `power`: of the machine, as identified; `heat_input`: of the actuator; `costs`: what heat costs at levels below
    full; `shared`: the machine feeds other actuators too, whose levels say what it costs. By the laws it is then
    switched or any level held, as where there are no `costs`.

    Raises:
        ControllerConfigError: levels above blocks are to be held, and the machine feeds other actuators too.
    """
    if shared and config.mode == "modulating" and config.lowest_level > 0.0:
        raise ControllerConfigError(
            f"controller.options.actuation.lowest_level: {config.lowest_level:g} of an actuator that shares its "
            "machine, whose blocks lie together; use mode: duty, or lowest_level: 0"
        )
    planned = power
    if costs and not shared and (config.mode == "auto" or (config.mode == "modulating" and config.lowest_level > 0.0)):
        T_out_C = np.asarray(heat_input.reference_C)
        full = float(heat_input(np.asarray(1.0), T_out_C))
        heat = [float(heat_input(np.asarray(one.level), T_out_C)) / full for one in costs]
        planned = PowerShape.through(costs, heat).of(power)
    if config.mode != "auto":
        actuation = Actuation(config)
        return ActuationChoice(actuation, f"{actuation.in_words}, as configured", planned)
    # Blocks at full level are the choice here, not all that the actuator can do; a meter shows heat at a part level.
    blocks = Actuation(config.model_copy(update={"mode": "duty"}), part_levels=heat_input.law is not None)
    if found := fixed_part(power, heat_input.law, costs, shared=shared):
        return ActuationChoice(blocks, f"{blocks.in_words}: {found}", power)
    if shared or not costs:
        laws = part_load(power, heat_input.law)
        if laws is None:
            return ActuationChoice(blocks, f"{blocks.in_words}: the data hold off and full level only", power)
        blocks = Actuation(config.model_copy(update={"mode": "modulating", "lowest_level": 0.0}))
        return ActuationChoice(blocks, f"{blocks.in_words}: {laws}", power)
    best = cheapest(costs)
    # Heat as metered that is proportional to the level is known of blocks: whether its levels are held it does not say.
    of_blocks = heat_input.law is not None and not heat_input.law.levels_seen
    if best is None or of_blocks:
        told = min(costs, key=lambda one: one.cost)
        return ActuationChoice(blocks, f"{blocks.in_words}: {told}", power)
    actuation = Actuation(config.model_copy(update={"mode": "modulating", "lowest_level": best.level}))
    return ActuationChoice(actuation, f"{actuation.in_words}: {best}", planned)
