"""Identify houses of several rooms from ordinary operation, and ask what six hours at full level do in each room, and
what other levels would have taken on past days (`energies`).

A drawn house lives by its own thermostats, schedules and night setback, with people who do not keep to them; nobody
probes it, and heat is not measured. The truth is the difference of two runs, room by room and valve by valve, while the
other valves are held at a third.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.effects.asking import Score
from benchmarks.effects.energies import (
    EnergyAnswer,
    energy_answers,
    energy_rows,
    energy_targets,
    lived_until,
)
from benchmarks.effects.windows import LONGEST, STEP_S, WINDOWS, band_K, block
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms

Row = dict[str, Any]

DAYS = 28.0
"""Days of operation that a model is identified from."""
# Rooms of the houses, one after another; days of the year on which records end; the question is asked a week later.
ROOMS, _ENDS, _LATER_DAYS = (3, 4, 5), (36, 60, 330, 48), 7
# Level of the other valves; effects below this, K, are too small to be told.
_OTHERS, _LEAST_K = 0.3, 0.05
_HALF = 0.5
_COVERED = (0.85, 0.95)


@dataclass(frozen=True)
class OperatedCase:
    """House `number` of a population, of so many `rooms`, `days` of whose operation are seen."""

    seed: int
    number: int
    rooms: int
    days: float = DAYS

    @property
    def building(self) -> str:
        """Name of the house."""
        return f"house:{self.rooms}rooms:{1000 * self.seed + self.number}"


@dataclass(frozen=True)
class PairAnswer:
    """What a model says that a valve does to a room, own or another; `competent`: whether it may act on the valve."""

    zone: str
    actuator: str
    own: bool
    competent: bool
    scores: tuple[Score, ...]


@dataclass(frozen=True)
class HouseAnswer:
    """What the model of a house says of all its pairs, and of energies; `refused`: why there is no model."""

    building: str
    words: str
    refused: str = ""
    pairs: tuple[PairAnswer, ...] = ()
    energies: tuple[EnergyAnswer, ...] = ()


def ask_operated(case: OperatedCase) -> HouseAnswer:
    """Live in a house, identify it, and compare what it says with the truth."""
    plant = house_of_rooms(case.building, people=1000 * case.seed + case.number)
    end = _ENDS[case.number % len(_ENDS)]
    begins = lived_until(plant, end * DAY_S, case.days * DAY_S)
    record = as_homes_measure(plant.past(STEP_S).last(round(case.days * DAY_S / STEP_S)))
    answer = HouseAnswer(case.building, plant.house.words)
    try:
        # No sun shines on the sensors of these houses, and to look for it takes two thirds of the time.
        config = IdentificationConfig(modulation="linear", sun_on_sensor=False)
        model = identify(record, layout=plant.layout, config=config)
    except DataError as error:
        return replace(answer, refused=str(error))
    energies = energy_answers(model, plant, record, begins)
    return replace(answer, pairs=tuple(_pairs(model, plant, end + _LATER_DAYS)), energies=energies)


def as_homes_measure(record: Record) -> Record:
    """The record without heat and return water, which few homes measure."""
    nothing = {name: np.full_like(getattr(record, name), np.nan) for name in ("heat_W", "T_return_C")}
    return replace(record, **nothing)


def _pairs(model: ThermalModel, plant: HouseOfRooms, day: int) -> list[PairAnswer]:
    """The answers of all pairs on a day of the year."""
    operator = model.operator.resampled(STEP_S)
    asked, found = block(), []
    for a, actuator in enumerate(operator.actuators):
        off = np.full((len(operator.actuators), asked.size), _OTHERS)
        off[a] = 0.0
        on = off.copy()
        on[a] = asked
        plant.reset(day * DAY_S, _LATER_DAYS * DAY_S)
        begin = plant.snapshot()
        without = _followed(plant, off)
        plant.restore(begin)
        true_K = _followed(plant, on).T_zone_C[:, 1:] - without.T_zone_C[:, 1:]
        x = feature_matrix(without.T_zone_C[:, :-1], without.T_out_C[:-1], without.solar_W_m2[:-1], without.time_s[:-1])
        only = np.zeros_like(off)
        only[a] = asked
        said_K = operator.rollout(np.zeros(operator.shape), only, x).sum(axis=(1, 3))
        verdict = model.cards[a].competence
        for z, zone in enumerate(operator.zones):
            scores = []
            for window in WINDOWS:
                effect_K = window.of(said_K[z])
                band = band_K(model, window, effect_K, z, a)
                scores.append(Score(window.name, window.of(true_K[z]), effect_K, *band))
            own = operator.home[a] == z
            found.append(PairAnswer(zone, actuator, own, verdict is not None and verdict.competent, tuple(scores)))
    return found


def _followed(plant: HouseOfRooms, levels: Array) -> Record:
    """The record under `levels` (A, n)."""
    for u in levels.T:
        plant.advance(tuple(u.tolist()), STEP_S)
    return plant.past(STEP_S).last(levels.shape[1])


def operated_rows(answers: Sequence[HouseAnswer]) -> list[Row]:
    """A row for each house, and one for own and for cross effects of all."""
    rows = []
    for answer in answers:
        cells: Row = {"building": answer.building, "in words": answer.words, "refused": answer.refused[:80]}
        for name, own in (("own", True), ("cross", False)):
            cells |= {f"{name} {key}": value for key, value in _summary([answer], own=own).items()}
        rows.append(cells | {"competent": sum(pair.own and pair.competent for pair in answer.pairs)})
    for name, own in (("own", True), ("cross", False)):
        rows.append({"building": f"all, {name} effects"} | _summary(answers, own=own))
    return [*rows, *energy_rows([one for answer in answers for one in answer.energies])]


def operated_targets(answers: Sequence[HouseAnswer]) -> list[Target]:
    """Bands hold what they promise, and no competent own effect is wrong by half."""
    found = energy_targets([one for answer in answers for one in answer.energies])
    for name, own in (("own", True), ("cross", False)):
        covered, (least, most) = _summary(answers, own=own)["in_90_band"] or float("nan"), _COVERED
        what = f"operation, {name} effects: share of 90 % bands that hold the truth"
        found += [Target(what, covered, least, "at least"), Target(what, covered, most)]
    trusted = [
        abs(score.bias)
        for answer in answers
        for pair in answer.pairs
        if pair.own and pair.competent
        for score in pair.scores
        if score.window == LONGEST.name
    ]
    wrong = sum(size > _HALF for size in trusted)
    return [*found, Target(f"operation: of {len(trusted)} competent own effects, wrong by half", wrong, 0)]


def _summary(answers: Sequence[HouseAnswer], *, own: bool) -> Row:
    """Over effects that are large enough to be told: share of bands that hold, median bias and size of the error."""
    pairs = [pair for answer in answers for pair in answer.pairs if pair.own is own]
    scores = [score for pair in pairs for score in pair.scores if abs(score.true_K) >= _LEAST_K]
    if not scores:
        return {"in_90_band": None, "median_bias": None, "median_size": None, "signs": None}
    bias = np.array([score.bias for score in scores])
    return {
        "in_90_band": round(float(np.mean([score.in_band for score in scores])), 3),
        "median_bias": round(float(np.median(bias)), 3),
        "median_size": round(float(np.median(np.abs(bias))), 3),
        "signs": round(float(np.mean([score.said_K * score.true_K > 0.0 for score in scores])), 3),
    }
