"""Probing: days of comfortable actuation from which an operator can be identified.

Levels are drawn at random and held for random times, from a quarter of an hour to four hours, so that fast and slow
parts of the response are both excited; what is drawn leans against the temperature, so that the zone stays near its
comfort band whatever the weather (paper sec:identification: one to three probe days). Every few hours the draws are
chosen among seeded candidates for what can be learned from them (`identification.design`).
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
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.settings import StrictModel

# How far ahead the band is looked at: the zone must be able to meet the occupied bounds again.
_BAND_AHEAD_S = DAY_S


class ProbingConfig(StrictModel):
    """How a building is probed."""

    step_s: float = Field(900.0, ge=60, le=3600, description="step of the record, s")
    levels: tuple[float, ...] = Field((0.0, 1.0), min_length=2, description="levels drawn from, in [0, 1], off first")
    hold_steps: tuple[int, ...] = Field((1, 2, 4, 8, 16), min_length=1, description="steps a level is held, drawn from")
    lean_per_K: float = Field(0.35, gt=0, description="how strongly the draw leans against the temperature, 1/K")
    above_lower_K: float = Field(0.5, description="centre of the excursions above the tightest lower bound ahead, K")
    below_K: float = Field(1.5, gt=0, description="how far below that centre the machine is switched on, K")
    above_K: float = Field(1.5, gt=0, description="how far above it the machine is switched off, K")
    design: Literal["informative", "random"] = Field(
        "informative", description="choose the draws that tell most, or take the first that come"
    )
    candidates: int = Field(32, ge=2, le=1000, description="candidates to choose from")
    block_h: float = Field(12.0, gt=0, le=48, description="how long a choice is followed, h")
    warmup_days: float = Field(5.0, ge=0, le=14, description="native control before the first probing day, days")

    @model_validator(mode="after")
    def _sensible(self) -> ProbingConfig:
        if not all(0.0 <= level <= 1.0 for level in self.levels):
            raise ValueError(f"levels must lie in [0, 1], got {self.levels}")
        if self.levels[0] != 0.0 or len(set(self.levels)) < 2:
            raise ValueError(f"levels must start with 0 and hold another level, got {self.levels}")
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
    """Probe `plant` for `days` from `start_s`, after native warm-up; the plant is reset for it.

    Args:
        seed: of the draws; the same seed on the same plant gives the same record.
        mode: 'heating' or 'cooling': which way the machine moves the zone.
        config: how hard to probe.
        identification: what will be done with the record; its priors say what is worth knowing.
        on_step: called with the share done after every step.

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
        # Positive when the zone is on the side that needs the machine.
        level = excitation.next(sign * (centre - measurement.T_zone_C))
        measurement = plant.advance(level, c.step_s)
        history = history.extended(measurement)
        if on_step:
            on_step((done + 1) / n)
    return history


def _law(c: ProbingConfig, hold_steps: tuple[int, ...]) -> Law:
    return Law(c.levels, hold_steps, c.lean_per_K, c.below_K, c.above_K)


def _candidates(c: ProbingConfig, seed: int, done: int) -> list[Candidate]:
    """Draws with all holding times, with the shorter and with the longer half of them, in turn."""
    holds = sorted(c.hold_steps)
    middle = max(1, len(holds) // 2)
    kinds = (tuple(holds), tuple(holds[:middle]), tuple(holds[-middle:]))
    return [Candidate(_law(c, kinds[k % len(kinds)]), (seed, done, k)) for k in range(c.candidates)]


def _centre_C(ahead: Boundary, mode: str, offset_K: float) -> float:
    """Where excursions are centred: inside the tightest bound of the next day, on the side the machine works on."""
    if mode == "heating":
        return float(ahead.lower_C.max()) + offset_K
    return float(ahead.upper_C.min()) - offset_K
