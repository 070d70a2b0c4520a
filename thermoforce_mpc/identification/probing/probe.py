"""Probing as a controller: days of excitation within comfort limits, from which an operator can be identified.

Levels are drawn at random and held for random times, 15 min to 4 h, to excite fast and slow parts of the response. The
draws depend on the temperature, so that the zone stays near its comfort band (paper sec:identification: one to three
probe days). Every 12 h the most informative of several seeded candidates is chosen
(`identification.probing.design`). In a light zone, which a full step can bring more than `margin_K` outside the comfort
band, levels are changed so that the temperature keeps the limits until the step ends (`politeness`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import (
    CONDITIONS,
    DAY_S,
    HOUR_S,
    SAMPLED,
    Array,
    Block,
    Boundary,
    Layout,
    Observation,
    Plan,
    PlanStatus,
    Record,
    steps_in,
)
from thermoforce_mpc.data.boundary import SET_BACK_K
from thermoforce_mpc.data.clock import DAY_H, PLAN_STEP_S
from thermoforce_mpc.data.series import interpolated
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.design import choose
from thermoforce_mpc.identification.probing.excitation import (
    EXCURSION_K,
    Draws,
    Excitation,
    LevelTrial,
    RoomExcitation,
    RoomsState,
    drawing,
)
from thermoforce_mpc.identification.probing.politeness import Foresight
from thermoforce_mpc.model.forecast_gaps import completed
from thermoforce_mpc.scenario.settings import StrictModel

# Horizon over which the tightest comfort bound is taken, so that the zone can meet the occupied bounds.
_BAND_AHEAD_S = DAY_S
# Share of the steps between two choices of draws below which an actuator was hardly used. A bedroom that neighbours
# keep warm was heated in 0.05 of the steps, and its model was a guess (2026-11-22).
_IDLE_SHARE = 0.1
# Time between two choices of draws, h, and centre of the excursions inside the tightest bound ahead, K. By judgement:
# twice a day, as `bench probing` runs (2026-11-22).
_BLOCK_H, _INSIDE_K = 12.0, 0.5
# Mean level from which an hour counts as tried, on how many days; by judgement, against hours in which a machine is
# blocked every day (the fault of `bench detectors`, 2026-11-28).
_TRIED, _TRIES = 0.5, 2


class ProbingConfig(StrictModel):
    """Options of the probing."""

    step_s: float = Field(PLAN_STEP_S, ge=60, le=3600, description="step of the record, s")
    # Off and full tell most of an effect: its size grows with the difference.
    levels: tuple[float, ...] = Field((0.0, 1.0), min_length=2, description="levels to draw from, in [0, 1], off first")
    trial_levels: tuple[float, ...] = Field(
        (), description="levels in (0, 1) that take the place of the highest for a few steps, to see part load"
    )
    # As many as heat at part load is estimated from (`_LEAST_STEPS` of `effects.level_laws`).
    trial_steps: int = Field(
        4, ge=2, description="number of those steps at each, half after off and half after full level"
    )
    # From a step to four hours, twice as long each: fast and slow modes are moved alike.
    hold_steps: tuple[int, ...] = Field((1, 2, 4, 8, 16), min_length=1, description="holding times to draw from, steps")
    excursion_K: float = Field(
        EXCURSION_K, gt=0, description="distance from the centre at which the machine is on, or off, K"
    )
    margin_K: float = Field(
        1.0,
        gt=0,
        description="largest distance from the tightest comfort band ahead that a step may be predicted to reach, K;"
        " counts in light zones, which a full step can bring there",
    )
    design: Literal["informative", "random"] = Field(
        "informative", description="informative: choose the most informative draws; random: take the first"
    )
    # By judgement, when `tf-mpc bench probing` was set up (2026-11-21): the best of 32 is among the best 3 % in the
    # mean.
    candidates: int = Field(32, ge=2, le=1000, description="number of candidates")
    # Structures forget how they started: time constants are 50 h and more (`_TAU_H` of `probing.design`), BOPTEST's own
    # warm-up is seven.
    warmup_days: float = Field(5.0, ge=0, le=14, description="native control before the first probing day, days")

    @model_validator(mode="after")
    def _sensible(self) -> ProbingConfig:
        if not all(0.0 <= level <= 1.0 for level in self.levels):
            raise ValueError(f"levels must lie in [0, 1], got {self.levels}")
        if self.levels[0] != 0.0 or len(set(self.levels)) < 2:
            raise ValueError(f"levels must start with 0 and include another level, got {self.levels}")
        if not all(0.0 < level < 1.0 for level in self.trial_levels):
            raise ValueError(f"trial_levels must lie between 0 and 1, got {self.trial_levels}")
        if min(self.hold_steps) < 1:
            raise ValueError(f"hold_steps must be positive, got {self.hold_steps}")
        return self

    @property
    def block_steps(self) -> int:
        """Steps between two choices of the draws."""
        return steps_in(_BLOCK_H * HOUR_S, self.step_s)


@dataclass(frozen=True, eq=False)
class LevelsState:
    """Where the excitation of an actuator by levels stands: its random numbers, the level that is held and for how many
    steps more, the trial of part load, the level `applied` last, and what `Foresight` has learned.
    """

    draws: Mapping[str, Any]
    hold_steps: tuple[int, ...]
    level: float
    left: int
    trial_left: int
    trial_done: int
    applied: float
    stays_C: float
    weights: Array
    covariance: Array
    mean_C: float


@dataclass(frozen=True, eq=False)
class ProbingState:
    """Where a probing stands: begun at `begin_s`, `steps` of the record at the last plan (−1: none yet), steps after
    which it ends as far as is known, the levels `asked` (A, n) for in each step (NaN: own control), and `of` each
    actuator.
    """

    begin_s: float
    steps: int
    planned_steps: int
    asked: Array
    of: tuple[LevelsState | RoomsState, ...]


EndRule = Callable[[Record, int], tuple[int, str]]
"""When a probing ends: from its record so far and the steps that are planned (0 at the begin), the steps that it is to
have and why it ends now ('' where it goes on). Asked where a block of draws ends, and where all steps are over."""


class ProbingController:
    """`Controller` that excites a building within its comfort limits, until a rule says that it ends.

    Each actuator has draws of its own, so that their effects can be told apart, and follows the comfort band of the
    zone that it serves. One whose levels are signed is probed by room set-points instead of levels. All that it knows
    is in the state of its plans: a probing that was killed goes on with the draws, holds and trials it was in.
    """

    name = "probing"

    def __init__(self, layout: Layout, config: ProbingConfig, seed: int, until: EndRule) -> None:
        """`seed` of the draws: the same seed on the same plant gives the same record."""
        self.layout, self.config, self._seed, self._until = layout, config, seed, until
        self.horizon_s = max(_BAND_AHEAD_S, config.block_steps * config.step_s)

    @property
    def step_s(self) -> float:
        """Step of the record, s."""
        return self.config.step_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`; raises `DataError` where a zone's temperature was not measured since the begin."""
        c, history = self.config, observation.history
        names, before = history.names, state if isinstance(state, ProbingState) else None
        begin_s = float(history.time_s[-1]) if before is None else before.begin_s
        measured = _since(history, begin_s)
        record = _whole(measured)
        excites = self._excites(_whole(history) if before is None else None)
        done = round((float(history.time_s[-1]) - begin_s) / c.step_s)
        last, planned = (-1, 0) if before is None else (before.steps, before.planned_steps)
        block_ends = last < 0 or done // c.block_steps > last // c.block_steps
        if before is not None:
            for one, of in zip(excites, before.of, strict=True):
                one.restore(of)
        for i in range(max(record.n_steps - (done - max(last, 0)), 0), record.n_steps):
            for a, (zone, one) in enumerate(zip(self.layout.home, excites, strict=True)):
                one.learn(record.slice(i, i + 1).part(zone, [a]))
        why = ""
        if block_ends or done >= planned:
            planned, why = self._until(measured, planned)
        asked = np.full((len(names.actuators), done + 1), np.nan)
        if before is not None:
            asked[:, : before.asked.shape[1]] = before.asked[:, : done + 1]
        if why:
            # As it stood: one that is continued begins with this very step.
            ended = before or ProbingState(begin_s, -1, planned, asked[:, :done], tuple(one.state() for one in excites))
            return Plan((), PlanStatus.RULE, f"probing ended: {why}", names=names, ends=why, state=ended)
        block = self._next(record, excites, observation.boundary, block_ends, done, planned)
        asked[:, done] = block.as_array()
        new = ProbingState(begin_s, done, planned, asked, tuple(one.state() for one in excites))
        days = f"{done * c.step_s / DAY_S:.2f} of {planned * c.step_s / DAY_S:.3g} days"
        return Plan((block,), PlanStatus.RULE, f"probing, {days}", names=names, state=new)

    def _excites(self, past: Record | None) -> list[_Levels | RoomExcitation]:
        """What excites each actuator; `past` at the begin, it bounds the effect of a level."""
        c, excites = self.config, list[_Levels | RoomExcitation]()
        for a, (zone, u_min) in enumerate(zip(self.layout.home, self.layout.u_min, strict=True)):
            draws = (self._seed,) if a == 0 else (self._seed, a)
            if u_min < 0.0:
                excites.append(RoomExcitation(np.random.default_rng(_seed(draws)), c.hold_steps, u_min, c.step_s))
            else:
                own = None if past is None else past.part(zone, [a])
                excites.append(_Levels(c, draws, self.layout.signs[a], own))
        return excites

    def _next(
        self,
        record: Record,
        excites: list[_Levels | RoomExcitation],
        boundary: Boundary,
        block_ends: bool,
        done: int,
        planned: int,
    ) -> Block:
        """The next step of all actuators; `planned`: steps after which probing ends."""
        c = self.config
        if any(not np.isfinite(np.asarray(getattr(boundary, name))).all() for name in CONDITIONS[1:]):
            boundary = completed(boundary, record, None)[0]
        # What holds during the step decides set-points of rooms, the tightest band of a day the levels.
        soon, day = boundary.head(1), _hourly(boundary.head(round(_BAND_AHEAD_S / c.step_s)))
        ahead = None
        if c.design == "informative" and block_ends:
            ahead = boundary.head(min(c.block_steps, planned - done))
        blocks = []
        for a, (zone, one) in enumerate(zip(self.layout.home, excites, strict=True)):
            band = soon if isinstance(one, RoomExcitation) else day
            coming = None if ahead is None else ahead.part(zone)
            blocks.append(one.next(record.part(zone, [a]), band.part(zone), coming))
        acted = record.u[:, -1] > 0.0 if record.n_steps else np.zeros(len(blocks), dtype=bool)
        # Of equal levels of actuators that exclude one another, the one that acts goes on.
        for a in self.layout.excluded(
            [(block.u[0] or 0.0) * (1 + on) for block, on in zip(blocks, acted, strict=True)]
        ):
            blocks[a] = Block(0.0, c.step_s)
            excites[a].withheld()
        levels = tuple(block.u[0] for block in blocks)
        return Block(levels, c.step_s, tuple(block.command[0] for block in blocks))


def _since(history: Record, begin_s: float) -> Record:
    """`history` from `begin_s` on, as far back as it goes."""
    first = int(np.searchsorted(history.time_s, begin_s - 1.0))
    return history.slice(min(first, history.n_steps), history.n_steps)


def _whole(record: Record) -> Record:
    """`record` without gaps in what is sampled, on which draws cannot be made: straight lines.

    What was not measured at all stays so. Raises `DataError` where that is the temperature of a zone now.
    """
    filled: dict[str, Any] = {}
    for name in SAMPLED[1:]:
        rows = getattr(record, name)
        if not np.isfinite(rows).all():
            whole = np.array([interpolated(row) if np.isfinite(row).any() else row for row in np.atleast_2d(rows)])
            filled[name] = whole.reshape(rows.shape)
    record = replace(record, **filled) if filled else record
    if record.n_steps and not np.isfinite(record.T_zone_C[:, -1]).all():
        silent = record.names.zones[int(np.argmin(np.isfinite(record.T_zone_C[:, -1])))]
        raise DataError(f"{silent}: its temperature is not measured, and probing keeps no comfort without")
    return record


def _hourly(boundary: Boundary) -> Boundary:
    """`boundary` at every full hour from its begin on."""
    stride = steps_in(HOUR_S, boundary.step_s)
    columns = {name: getattr(boundary, name)[..., ::stride] for name in CONDITIONS}
    return Boundary(**columns, names=boundary.names)


class _Levels:
    """Excites a zone by the levels of an actuator; `past`: its record before the probing, None where it is restored."""

    def __init__(self, c: ProbingConfig, seed: tuple[int, ...], sign: int, past: Record | None) -> None:
        self._config, self._seed = c, seed
        self._sign = float(sign)
        self._foresight = Foresight(past, self._sign, c.step_s)
        self._excitation = Excitation(c.levels, c.hold_steps, np.random.default_rng(_seed(seed)), c.excursion_K)
        self._trial = LevelTrial(c.trial_levels, c.trial_steps)
        self._applied = 0.0
        self._stays_C = float("nan")

    def state(self) -> LevelsState:
        """All that the next steps depend on."""
        e, trial, foresight = self._excitation, self._trial, self._foresight
        return LevelsState(
            draws=e.rng.bit_generator.state,
            hold_steps=tuple(e.hold_steps),
            level=e.level,
            left=e.left,
            trial_left=trial.left,
            trial_done=trial.done,
            applied=self._applied,
            stays_C=self._stays_C,
            weights=foresight.weights,
            covariance=foresight.covariance,
            mean_C=foresight.mean_C,
        )

    def restore(self, state: LevelsState | RoomsState) -> None:
        """Go on from `state`."""
        assert isinstance(state, LevelsState)
        self._excitation = replace(
            self._excitation,
            hold_steps=tuple(state.hold_steps),
            rng=drawing(state.draws),
            level=state.level,
            left=state.left,
        )
        self._trial.left, self._trial.done = state.trial_left, state.trial_done
        self._applied, self._stays_C = state.applied, state.stays_C
        self._foresight.restore(state.weights, state.covariance, state.mean_C)

    def next(self, record: Record, band: Boundary, ahead: Boundary | None) -> Block:
        """The level of the next step.

        Args:
            record: the zone and its actuator so far.
            band: boundary conditions of the next day, for its tightest comfort band.
            ahead: those until the next choice of draws; None where draws are not chosen now.
        """
        c = self._config
        if ahead is not None and self._idle(record):
            # Neighbours or sun hold the zone beyond the excursions: they then begin where it stays by itself.
            self._stays_C = float(self._sign * np.min(self._sign * record.T_zone_C[0, -c.block_steps :]))
        centre = self._centre_C(band)
        if ahead is not None:
            candidates = _candidates(c, self._seed, record.n_steps)
            known = replace(record, u=np.nan_to_num(record.u))  # where the building's own control acted
            chosen, _ = choose(known, ahead, self._excitation, candidates, centre_C=centre, sign=self._sign)
            self._excitation = self._excitation.resumed(chosen)
        # Positive if the zone is too cold (heating) or too warm (cooling).
        level = self._excitation.next(self._sign * (centre - float(record.T_zone_C[0, -1])))
        if self._must_try(record, band) and self._sign * (float(record.T_zone_C[0, -1]) - centre) < c.excursion_K:
            level = max(c.levels)
        elif c.trial_levels:
            level = self._trial.applied(level, self._applied, max(c.levels))
        self._applied = self._polite(level, centre, band, record)
        return Block(self._applied, c.step_s)

    def _must_try(self, record: Record, band: Boundary) -> bool:
        """Whether this hour of the day has to be tried at full level.

        Where a bound begins plans count on the hour before and the one after: what a schedule of the plant does there
        shows on two days only (`machine.blocked_hours.HourEffects`). The first day is left to the draws.
        """
        tight_C = band.lower_C[0] if self._sign > 0 else -band.upper_C[0]
        begins = np.diff(tight_C) > SET_BACK_K
        if begins.size < DAY_H or not (begins[0] or begins[DAY_H - 1]) or not record.n_steps:
            return False
        day, hour = np.divmod(record.time_s[:-1] + 1.0, DAY_S)
        today, now = divmod(float(record.time_s[-1]) + 1.0, DAY_S)
        same = (hour // HOUR_S == now // HOUR_S) & (day < today)
        tried = sum(float(np.mean(record.u[0, same & (day == one)])) >= _TRIED for one in np.unique(day[same]))
        return tried < min(int((record.time_s[-1] - record.time_s[0]) // DAY_S), _TRIES)

    def _idle(self, record: Record) -> bool:
        """Whether the actuator was hardly used since the last choice of draws."""
        u = record.u[0, -self._config.block_steps :]
        return u.size == self._config.block_steps and float(np.mean(u > 0.0)) < _IDLE_SHARE

    def _centre_C(self, band: Boundary) -> float:
        """Centre of the excursions, °C: just inside the tightest bound of `band`, or where the zone stays by itself.

        The excursions then still end inside the other bound.
        """
        lower, upper, excursion = float(band.lower_C.max()), float(band.upper_C.min()), self._config.excursion_K
        tight, most = lower + _INSIDE_K, upper - excursion
        if self._sign < 0:
            tight, most = upper - _INSIDE_K, lower + excursion
        if not np.isfinite(self._stays_C):
            return tight
        low, high = sorted((tight, most))
        return float(np.clip(self._stays_C, low, high)) if self._sign * (most - tight) > 0 else tight

    def withheld(self) -> None:
        """The level was not applied: another actuator acts, which excludes this one."""
        self._applied = 0.0

    def learn(self, step: Record) -> None:
        """Learn from the step that was just made."""
        self._foresight.learn(step)

    def _polite(self, level: float, centre: float, band: Boundary, record: Record) -> float:
        """The level to apply, where `level` was drawn: another one only in a light zone."""
        c = self._config
        highest = max(c.levels)
        low, high = float(band.lower_C.max()) - c.margin_K, float(band.upper_C.min()) + c.margin_K
        # Levels are drawn up to the limit of the excursions: from there a full step must stay in the band.
        room_K = high - (centre + c.excursion_K) if self._sign > 0 else (centre - c.excursion_K) - low
        if not highest * self._foresight.effect_K > max(room_K, c.margin_K):
            return level
        # Inside the limits of the excursions, so that levels can be held, and never beyond the margin.
        low, high = max(centre - c.excursion_K, low), min(centre + c.excursion_K, high)
        T_zone, T_out, solar = (float(s[-1]) for s in (record.T_zone_C[0], record.T_out_C, record.solar_W_m2))
        return self._foresight.polite(level, highest, T_zone, T_out, solar, low, high)


def _seed(seed: tuple[int, ...]) -> int | tuple[int, ...]:
    return seed[0] if len(seed) == 1 else seed


def _candidates(c: ProbingConfig, seed: tuple[int, ...], done: int) -> list[Draws]:
    """Return candidates with, in turn, all holding times, the shorter half and the longer half of them."""
    holds = sorted(c.hold_steps)
    middle = max(1, len(holds) // 2)
    kinds = (tuple(holds), tuple(holds[:middle]), tuple(holds[-middle:]))
    return [Draws(kinds[k % len(kinds)], (*seed, done, k)) for k in range(c.candidates)]
