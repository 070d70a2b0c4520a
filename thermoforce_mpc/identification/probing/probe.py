"""Probing: days of excitation within comfort limits, from which an operator can be identified.

Levels are drawn at random and held for random times, 15 min to 4 h, to excite fast and slow parts of the response. The
draws depend on the temperature, so that the zone stays near its comfort band (paper sec:identification: one to three
probe days). Every `block_h` hours the most informative of several seeded candidates is chosen
(`identification.probing.design`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.probing.design import Candidate, Designer
from thermoforce_mpc.identification.probing.excitation import Excitation, Law
from thermoforce_mpc.identification.probing.room import RoomExcitation
from thermoforce_mpc.protocols import Plant, RoomSetpointPlant
from thermoforce_mpc.scenario.settings import StrictModel

# Horizon over which the tightest comfort bound is taken, so that the zone can meet the occupied bounds.
_BAND_AHEAD_S = DAY_S


class ProbingConfig(StrictModel):
    """Options of the probing."""

    step_s: float = Field(900.0, ge=60, le=3600, description="step of the record, s")
    levels: tuple[float, ...] = Field((0.0, 1.0), min_length=2, description="levels to draw from, in [0, 1], off first")
    hold_steps: tuple[int, ...] = Field((1, 2, 4, 8, 16), min_length=1, description="holding times to draw from, steps")
    lean_per_K: float = Field(0.35, gt=0, description="change of the probability of on per K from the centre, 1/K")
    above_lower_K: float = Field(0.5, description="centre of the excursions inside the tightest bound ahead, K")
    below_K: float = Field(1.5, gt=0, description="distance below the centre at which the machine is on, K")
    above_K: float = Field(1.5, gt=0, description="distance above the centre at which it is off, K")
    design: Literal["informative", "random"] = Field(
        "informative", description="informative: choose the most informative draws; random: take the first"
    )
    candidates: int = Field(32, ge=2, le=1000, description="number of candidates")
    block_h: float = Field(12.0, gt=0, le=48, description="time between two choices, h")
    warmup_days: float = Field(5.0, ge=0, le=14, description="native control before the first probing day, days")

    @model_validator(mode="after")
    def _sensible(self) -> ProbingConfig:
        if not all(0.0 <= level <= 1.0 for level in self.levels):
            raise ValueError(f"levels must lie in [0, 1], got {self.levels}")
        if self.levels[0] != 0.0 or len(set(self.levels)) < 2:
            raise ValueError(f"levels must start with 0 and include another level, got {self.levels}")
        if min(self.hold_steps) < 1:
            raise ValueError(f"hold_steps must be positive, got {self.hold_steps}")
        return self


def probe(
    plant: Plant,
    start_s: float,
    days: float,
    *,
    seed: int,
    mode: str = "heating",
    config: ProbingConfig | None = None,
    identification: IdentificationConfig | None = None,
    on_step: Callable[[float], None] | None = None,
) -> Record:
    """Probe `plant` for `days` from `start_s`, after a reset with native warm-up.

    Args:
        seed: seed of the draws; the same seed on the same plant gives the same record.
        mode: 'heating' or 'cooling'.
        config: options of the probing.
        identification: options of the identification that will use the record; its priors define the information gain.
        on_step: called after every step with the completed fraction.

    Returns:
        The record at `config.step_s`, without the warm-up.

    Raises:
        PlantError: the plant or service failed.
    """
    c = config or ProbingConfig()
    measurement = plant.reset(start_s, min(c.warmup_days * DAY_S, start_s))
    history = Record.beginning(measurement)
    n = round(days * DAY_S / c.step_s)
    sign = 1.0 if mode == "heating" else -1.0
    law = _law(c, c.hold_steps)
    excitation = Excitation(law, np.random.default_rng(seed))
    designer = Designer(identification) if c.design == "informative" else None
    block = max(1, round(c.block_h * HOUR_S / c.step_s))
    for done in range(n):
        centre = _centre_C(plant.forecast(_BAND_AHEAD_S, HOUR_S), mode, c.above_lower_K)
        if designer and done % block == 0:
            ahead = plant.forecast(min(block, n - done) * c.step_s, c.step_s)
            candidates = _candidates(c, seed, done)
            chosen, _ = designer.choose(history, ahead, excitation, candidates, centre_C=centre, sign=sign)
            excitation = excitation.resumed(chosen.law, chosen.seed)
        # Positive if the zone is too cold (heating) or too warm (cooling).
        level = excitation.next(sign * (centre - measurement.T_zone_C))
        measurement = plant.advance(level, c.step_s)
        history = history.extended(measurement)
        if on_step:
            on_step((done + 1) / n)
    return history


def probe_room(
    plant: RoomSetpointPlant,
    start_s: float,
    days: float,
    *,
    seed: int,
    lowest: float,
    config: ProbingConfig | None = None,
    on_step: Callable[[float], None] | None = None,
) -> Record:
    """Probe `plant`, whose level of full cooling is `lowest`, by room set-points; otherwise as `probe`."""
    c = config or ProbingConfig()
    measurement = plant.reset(start_s, min(c.warmup_days * DAY_S, start_s))
    history = Record.beginning(measurement)
    excitation = RoomExcitation(np.random.default_rng(seed), c.hold_steps, lowest)
    n = round(days * DAY_S / c.step_s)
    for done in range(n):
        ahead = plant.forecast(c.step_s, c.step_s)
        block = excitation.next(measurement.T_zone_C, ahead.lower_C, ahead.upper_C, c.step_s)
        measurement = plant.advance(block.u, block.duration_s, block.band_C)
        history = history.extended(measurement)
        if on_step:
            on_step((done + 1) / n)
    return history


def _law(c: ProbingConfig, hold_steps: tuple[int, ...]) -> Law:
    return Law(c.levels, hold_steps, c.lean_per_K, c.below_K, c.above_K)


def _candidates(c: ProbingConfig, seed: int, done: int) -> list[Candidate]:
    """Return candidates with, in turn, all holding times, the shorter half and the longer half of them."""
    holds = sorted(c.hold_steps)
    middle = max(1, len(holds) // 2)
    kinds = (tuple(holds), tuple(holds[:middle]), tuple(holds[-middle:]))
    return [Candidate(_law(c, kinds[k % len(kinds)]), (seed, done, k)) for k in range(c.candidates)]


def _centre_C(ahead: Boundary, mode: str, offset_K: float) -> float:
    """Return the centre of the excursions, °C: `offset_K` inside the tightest bound of `ahead`, lower for heating."""
    if mode == "heating":
        return float(ahead.lower_C.max()) + offset_K
    return float(ahead.upper_C.min()) - offset_K
