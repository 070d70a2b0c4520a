"""Probe a building, identify it, and ask what six hours at full level do; the truth is the difference of two runs.

A sensor that reads in steps of 0.5 K would hide half of an effect of 1 K: the truth of a generated house is read by the
same sensor without steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.effects.windows import STEP_S, WINDOWS, band_K, block
from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, generated_house
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.scenario.testcase import TestCase

# Probing and question begin on these days of the year, each after native control; probing is over by then.
MOST_DAYS, _PROBING_DAY, _ASKED_DAY, _NATIVE_DAYS = 10.0, 25, 35, 5
_SEED = 1
# What names of generated houses begin with: their population and number follow.
GENERATED = "generated:"


@dataclass(frozen=True)
class Case:
    """One building by its test case, of one zone; `draw`: what it is one of; `days` of probing, the fewest first."""

    building: str
    draw: str
    days: tuple[float, ...]


@dataclass(frozen=True)
class Score:
    """One window, K: the true effect, the model's, and its 90 % band; NaN where it has none."""

    window: str
    true_K: float
    said_K: float
    low_K: float
    high_K: float

    @property
    def bias(self) -> float:
        """How much too much of the effect the model says, as a share of it."""
        return (self.said_K - self.true_K) / self.true_K

    @property
    def in_band(self) -> bool:
        """Whether the band holds the truth."""
        return self.low_K <= self.true_K <= self.high_K


@dataclass(frozen=True)
class Answer:
    """What the model of a building, described in `words`, from `days` of probing says.

    `refused`: why there is no model; `missed`: what it misses, empty where it is competent.
    """

    building: str
    draw: str
    words: str
    days: float
    refused: str = ""
    missed: str = ""
    scores: tuple[Score, ...] = ()

    @property
    def verdict(self) -> str:
        """Whether a controller would act on it."""
        return "refused" if self.refused else "not competent" if self.missed else "competent"

    def score(self, window: str) -> Score:
        """The score of a window by its name; NaN throughout where there is no model."""
        nothing = Score(window, *(4 * (math.nan,)))
        return next((score for score in self.scores if score.window == window), nothing)


def probed_days(houses: int, days: Sequence[float], *, quick: bool) -> tuple[float, ...]:
    """The numbers of days in rising order, the fewest alone if `quick`.

    Raises:
        InputError: no houses, or a number of days out of range.
    """
    if houses < 1:
        raise InputError(f"{houses} houses: expected at least one")
    if not days or not all(1.0 <= one <= MOST_DAYS for one in days):
        raise InputError(f"days of probing {list(days)}: expected one number or more from 1 to {MOST_DAYS:g}")
    return tuple(sorted(set(days)))[: 1 if quick else None]


def ask(case: Case) -> list[Answer]:
    """The answers of one building, one for each number of days of the same probing.

    Raises:
        PlantError: the plant failed.
    """
    testcase = load_testcase(case.building)
    with closing(build_plant(PlantSpec(), testcase, _SEED)) as plant:
        off, true_K = paired(without_steps(case.building) or plant)
        probing = validate(ProbingConfig, testcase.defaults.probing, case.building)
        run = Probing(plant, _PROBING_DAY * DAY_S, seed=_SEED, layout=testcase.layout, config=probing)
        answers = []
        for days in case.days:
            record = run.go_on(days - run.days)
            told = (case.building, case.draw, _words(case.building), days)
            try:
                model = identified(record, testcase)
            except DataError as error:
                answers.append(Answer(*told, refused=str(error)))
            else:
                answers.append(Answer(*told, missed=_missed(model), scores=scored(model, off, true_K)))
    return answers


def without_steps(building: str) -> Plant | None:
    """A generated house whose sensor reads in no steps; None for other buildings."""
    if not building.startswith(GENERATED):
        return None
    return GeneratedHousePlant(replace(generated_house(building), resolution_K=0.0))


def identified(record: Record, testcase: TestCase) -> ThermalModel:
    """The model of a record with the settings of its test case, without a network; raises `DataError`."""
    options = {"modulation": "linear", **testcase.defaults.identification}
    config = validate(IdentificationConfig, options, testcase.name)
    return identify(record, layout=testcase.layout, floor_area_m2=testcase.area_m2, config=config)


def paired(plant: Plant) -> tuple[Record, Array]:
    """The run without the block, and what the block adds to the readings at the ends of its steps (n,), K."""
    levels = block()
    off, on = _followed(plant, np.zeros_like(levels)), _followed(plant, levels)
    return off, on.T_zone_C[0, 1:] - off.T_zone_C[0, 1:]


def scored(model: ThermalModel, off: Record, true_K: Array) -> tuple[Score, ...]:
    """The model's answer beside the truth (n,), K, in every window; `off`: the run without the block."""
    said_K = said(model, off)
    scores = []
    for window in WINDOWS:
        effect_K = window.of(said_K)
        scores.append(Score(window.name, window.of(true_K), effect_K, *band_K(model, window, effect_K)))
    return tuple(scores)


def said(model: ThermalModel, off: Record) -> Array:
    """The effect of the block that the model predicts in the weather of the run without it (n,), K."""
    operator = model.operator.resampled(STEP_S)
    x = feature_matrix(off.T_zone_C[:, :-1], off.T_out_C[:-1], off.solar_W_m2[:-1], off.time_s[:-1])
    return np.asarray(operator.rollout(np.zeros(operator.shape), block()[None], x).sum(axis=(1, 3))[0])


def _followed(plant: Plant, levels: Array) -> Record:
    """The record under `levels` (n,)."""
    plant.reset(_ASKED_DAY * DAY_S, _NATIVE_DAYS * DAY_S)
    for u in levels:
        plant.advance(float(u), STEP_S)
    return plant.past(STEP_S).last(levels.size)


def _words(building: str) -> str:
    """Mass, emitter and machine of a generated house; nothing of other buildings."""
    if not building.startswith(GENERATED):
        return ""
    house = generated_house(building)
    return f"{house.mass}, {house.emitter}, {house.machine}"


def _missed(model: ThermalModel) -> str:
    verdict = model.cards[0].competence
    return "" if verdict is None or verdict.competent else "; ".join(verdict.reasons)
