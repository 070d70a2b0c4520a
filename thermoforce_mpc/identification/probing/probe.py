"""Probing: days of excitation within comfort limits, from which an operator can be identified.

Levels are drawn at random and held for random times, 15 min to 4 h, to excite fast and slow parts of the response. The
draws depend on the temperature, so that the zone stays near its comfort band (paper sec:identification: one to three
probe days). Every 12 h the most informative of several seeded candidates is chosen
(`identification.probing.design`). In a light zone, which a full step can bring more than `margin_K` outside the comfort
band, levels are changed so that the temperature keeps the limits until the step ends (`politeness`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, cast

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Boundary, Layout, Record
from thermoforce_mpc.identification.probing.design import choose
from thermoforce_mpc.identification.probing.excitation import EXCURSION_K, Draws, Excitation, LevelTrial, RoomExcitation
from thermoforce_mpc.identification.probing.politeness import Foresight
from thermoforce_mpc.protocols import Plant, RoomSetpointPlant
from thermoforce_mpc.scenario.settings import StrictModel

# Horizon over which the tightest comfort bound is taken, so that the zone can meet the occupied bounds.
_BAND_AHEAD_S = DAY_S
# Share of the steps between two choices of draws below which an actuator was hardly used.
_IDLE_SHARE = 0.1
# Time between two choices of draws, h, and centre of the excursions inside the tightest bound ahead, K.
_BLOCK_H, _INSIDE_K = 12.0, 0.5


class ProbingConfig(StrictModel):
    """Options of the probing."""

    step_s: float = Field(900.0, ge=60, le=3600, description="step of the record, s")
    levels: tuple[float, ...] = Field((0.0, 1.0), min_length=2, description="levels to draw from, in [0, 1], off first")
    trial_levels: tuple[float, ...] = Field(
        (), description="levels in (0, 1) that take the place of the highest for a few steps, to see part load"
    )
    trial_steps: int = Field(
        4, ge=2, description="number of those steps at each, half after off and half after full level"
    )
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
    candidates: int = Field(32, ge=2, le=1000, description="number of candidates")
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
        return max(1, round(_BLOCK_H * HOUR_S / self.step_s))


def probe(
    plant: Plant,
    start_s: float,
    days: float,
    *,
    seed: int,
    layout: Layout | None = None,
    config: ProbingConfig | None = None,
) -> Record:
    """Probe `plant` for `days` from `start_s`, after a reset with native warm-up.

    Args:
        seed: seed of the draws; the same seed on the same plant gives the same record.
        layout: what acts where, by default one heating actuator; one whose levels are signed is probed by room
            set-points instead of levels.
        config: options of the probing.

    Returns:
        The record at `config.step_s`, without the warm-up.

    Raises:
        PlantError: the plant or service failed.
    """
    return Probing(plant, start_s, seed=seed, layout=layout, config=config).go_on(days)


class Probing:
    """A probing that can be continued; `record` is what was measured so far, `blocks` what was asked for, one a step.

    Each actuator has draws of its own, so that their effects can be told apart, and follows the comfort band of the
    zone that it serves.
    """

    def __init__(
        self,
        plant: Plant,
        start_s: float,
        *,
        seed: int,
        layout: Layout | None = None,
        config: ProbingConfig | None = None,
    ) -> None:
        """Reset `plant` with native warm-up to `start_s`; arguments as for `probe`.

        Raises:
            PlantError: the plant or service failed.
        """
        self.config = c = config or ProbingConfig()
        self._plant, self._layout = plant, layout or Layout.single()
        now = plant.reset(start_s, min(c.warmup_days * DAY_S, start_s))
        self.record, self.blocks = Record.beginning(now), list[Block]()
        # The past bounds the effect of a level; rooms need none.
        past = plant.past(c.step_s) if any(lowest >= 0.0 for lowest in self._layout.lowest) else self.record
        self._excites: list[_Levels | RoomExcitation] = []
        for a, (zone, lowest) in enumerate(zip(self._layout.home, self._layout.lowest, strict=True)):
            draws = (seed,) if a == 0 else (seed, a)
            if lowest < 0.0:
                rng = np.random.default_rng(_seed(draws))
                self._excites.append(RoomExcitation(rng, c.hold_steps, lowest, c.step_s))
            else:
                own = past.part(zone, [a])
                self._excites.append(_Levels(c, draws, self._layout.signs[a], own))

    @property
    def days(self) -> float:
        """Days probed so far."""
        return self.record.n_steps * self.config.step_s / DAY_S

    def go_on(
        self,
        days: float,
        *,
        enough: Callable[[Record], bool] | None = None,
        on_step: Callable[[float], None] | None = None,
    ) -> Record:
        """Probe for `days` more; returns the record from the start of the probing.

        Args:
            days: days to probe, from where the last call stopped.
            enough: called at the end of every block; True ends the probing.
            on_step: called after every step with the completed fraction of `days`.

        Raises:
            PlantError: the plant or service failed.
        """
        first = self.record.n_steps
        n = round(days * DAY_S / self.config.step_s)
        for done in range(first, first + n):
            if done > first and done % self.config.block_steps == 0 and enough and enough(self.record):
                break
            self._step(first + n)
            if on_step:
                on_step((done + 1 - first) / n)
        return self.record

    def _step(self, end: int) -> None:
        """Apply the next step to all actuators; `end`: steps after which probing ends."""
        c, plant, done = self.config, self._plant, self.record.n_steps
        by_rooms = [isinstance(excites, RoomExcitation) for excites in self._excites]
        # What holds during the step decides set-points of rooms, the tightest band of a day the levels.
        soon = plant.forecast(c.step_s, c.step_s) if any(by_rooms) else None
        day = plant.forecast(_BAND_AHEAD_S, HOUR_S) if not all(by_rooms) else None
        chooses = c.design == "informative" and done % c.block_steps == 0 and day is not None
        ahead = plant.forecast(min(c.block_steps, end - done) * c.step_s, c.step_s) if chooses else None
        blocks = []
        for a, (zone, excites) in enumerate(zip(self._layout.home, self._excites, strict=True)):
            own = self.record.part(zone, [a])
            coming = ahead.part(zone) if ahead is not None else None
            band = soon if by_rooms[a] else day
            assert band is not None
            blocks.append(excites.next(own, band.part(zone), coming))
        acted = self.record.u[:, -1] > 0.0 if done else np.zeros(len(blocks), dtype=bool)
        # Of equal levels of actuators that exclude one another, the one that acts goes on.
        for a in self._layout.excluded(
            [(block.u[0] or 0.0) * (1 + on) for block, on in zip(blocks, acted, strict=True)]
        ):
            blocks[a] = Block(0.0, c.step_s)
            self._excites[a].withheld()
        levels = tuple(block.u[0] for block in blocks)
        commands = tuple(block.command[0] for block in blocks)
        self.blocks.append(Block(levels, c.step_s, commands))
        if any(command is not None for command in commands):
            now = cast(RoomSetpointPlant, plant).advance(levels, c.step_s, commands)
        else:
            now = plant.advance(levels, c.step_s)
        self.record = self.record.extended(now)
        for a, (zone, excites) in enumerate(zip(self._layout.home, self._excites, strict=True)):
            excites.learn(self.record.last(1).part(zone, [a]))


class _Levels:
    """Excites a zone by the levels of an actuator; `past`: its record before the probing."""

    def __init__(self, c: ProbingConfig, seed: tuple[int, ...], sign: int, past: Record) -> None:
        self._config, self._seed = c, seed
        self._sign = float(sign)
        self._foresight = Foresight(past, self._sign, c.step_s)
        self._excitation = Excitation(c.levels, c.hold_steps, np.random.default_rng(_seed(seed)), c.excursion_K)
        self._trial = LevelTrial(c.trial_levels, c.trial_steps)
        self._applied = 0.0
        self._stays_C = float("nan")

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
            chosen, _ = choose(record, ahead, self._excitation, candidates, centre_C=centre, sign=self._sign)
            self._excitation = self._excitation.resumed(chosen)
        # Positive if the zone is too cold (heating) or too warm (cooling).
        level = self._excitation.next(self._sign * (centre - float(record.T_zone_C[0, -1])))
        if c.trial_levels:
            level = self._trial.applied(level, self._applied, max(c.levels))
        self._applied = self._polite(level, centre, band, record)
        return Block(self._applied, c.step_s)

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
