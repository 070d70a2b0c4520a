"""What a house would have taken under other levels on a past day: what `counterfactual` says, beside the house itself.

The house stands at the begin of a day of its record, and lives it again with valves held at other levels. An answer is
an energy with its 90 % band; a figure is told where the band is no wider than `TOLD` of it, as `tf-mpc counterfactual`
does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.effects.windows import STEP_S
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record, energy_kWh
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.rooms import HouseOfRooms
from thermoforce_mpc.whatif.counterfactual import TOLD, counterfactual

ENERGY_DAYS = 2
"""Last days of a record that are asked about."""
_OF_DAY = round(DAY_S / STEP_S)
_HOUR = np.arange(_OF_DAY) * STEP_S / HOUR_S
_NIGHT = (_HOUR < 6.0) | (_HOUR >= 22.0)
_HOLDS = 0.85
# Other levels (A, n) in the place of those of a day: as people ask for.
QUESTIONS: dict[str, Callable[[Array], Array]] = {
    "all at 0.3": lambda u: np.full_like(u, 0.3),
    "all at half of theirs": lambda u: 0.5 * u,
    "off from 22 to 6 h": lambda u: np.where(_NIGHT, 0.0, u),
    "three hours later": lambda u: np.roll(u, round(3.0 * HOUR_S / STEP_S), axis=1),
    "open every other hour": lambda u: np.broadcast_to(np.where(_HOUR % 2.0 < 1.0, 1.0, 0.0), u.shape).copy(),
}


@dataclass(frozen=True)
class EnergyAnswer:
    """Energy of a day under the levels of `question`, kWh: true, said, and its band; `was_kWh`: as it was."""

    question: str
    was_kWh: float
    true_kWh: float
    said_kWh: float
    low_kWh: float
    high_kWh: float

    @property
    def in_band(self) -> bool:
        """Whether the band holds the truth."""
        return self.low_kWh <= self.true_kWh <= self.high_kWh

    @property
    def told(self) -> bool:
        """Whether a figure is told, not the band alone."""
        return self.high_kWh - self.low_kWh <= TOLD * max(self.said_kWh, 1e-9)


def lived_until(plant: HouseOfRooms, end_s: float, warmup_s: float) -> list[Any]:
    """Let a house live to `end_s` after `warmup_s`, and keep where it stands at the begins of its last days."""
    plant.reset(end_s - ENERGY_DAYS * DAY_S, warmup_s - ENERGY_DAYS * DAY_S)
    begins = []
    for _ in range(ENERGY_DAYS):
        begins.append(plant.snapshot())
        plant.advance(None, DAY_S)
    return begins


def energy_answers(
    model: ThermalModel, plant: HouseOfRooms, record: Record, begins: Sequence[Any]
) -> tuple[EnergyAnswer, ...]:
    """All questions of the last days of `record`, at whose begins the house stood at `begins`."""
    found = []
    for k, begin in enumerate(begins):
        first = record.n_steps - (len(begins) - k) * _OF_DAY
        day = record.slice(first, first + _OF_DAY)
        for question, of in QUESTIONS.items():
            levels = np.clip(of(day.u), 0.0, 1.0)
            said = counterfactual(model, record, levels, start=float(record.time_s[first]))
            plant.restore(begin)
            for u in levels.T:
                plant.advance(tuple(u.tolist()), STEP_S)
            true_kWh, was_kWh = (_kWh(one) for one in (plant.past(STEP_S).last(_OF_DAY), day))
            energies = (said.energy_other_kWh, said.energy_low_kWh, said.energy_high_kWh)
            found.append(EnergyAnswer(question, was_kWh, true_kWh, *(float(one.sum()) for one in energies)))
    return tuple(found)


def _kWh(record: Record) -> float:
    return energy_kWh(float(record.power_W.sum()), STEP_S)


def energy_rows(answers: Sequence[EnergyAnswer]) -> list[dict[str, Any]]:
    """A row for each question, and one for all: how often bands hold and figures are told, and how far they are off."""
    rows = []
    for question in (*QUESTIONS, "all"):
        of = [one for one in answers if question in (one.question, "all")]
        if not of:
            continue
        told = [one for one in of if one.told]
        error = np.array([one.said_kWh - one.true_kWh for one in of]) / np.array([one.true_kWh for one in of])
        width = np.array([one.high_kWh - one.low_kWh for one in of]) / np.array([one.true_kWh for one in of])
        rows.append(
            {
                "energy of": question,
                "days": len(of),
                "in_90_band": round(float(np.mean([one.in_band for one in of])), 3),
                "median_error": round(float(np.median(error)), 3),
                "median_width": round(float(np.median(width)), 3),
                "told": len(told),
                "told_in_band": round(float(np.mean([one.in_band for one in told])), 3) if told else None,
            }
        )
    return rows


def energy_targets(answers: Sequence[EnergyAnswer]) -> list[Target]:
    """Bands hold, also those of figures that are told."""
    found = []
    for what, of in (("", list(answers)), (" that are told", [one for one in answers if one.told])):
        held = float(np.mean([one.in_band for one in of])) if of else float("nan")
        found.append(
            Target(f"operation: share of {len(of)} energies{what} in their 90 % bands", held, _HOLDS, "at least")
        )
    return found
