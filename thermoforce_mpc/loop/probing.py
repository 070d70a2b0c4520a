"""Probing of a plant until a model of it knows enough, and what it still lacks at each look."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Block, Layout, Period, PlantInfo, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.unit_doubts import UnitDoubts
from thermoforce_mpc.model.sun_on_sensor import LIKELY
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.testcase import TestCase

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig
    from thermoforce_mpc.model.card import ModelCard
    from thermoforce_mpc.model.machine.blocked_hours import Directions
    from thermoforce_mpc.model.thermal_model import ThermalModel

_LOG = logging.getLogger(__name__)
# Probing does not end early before this many days: a held-out part of 9 h must show the effect.
_LEAST_DAYS = 1.5
# Probabilities of sun on a sensor above which, until it is likely, probing does not end early, and goes on after its
# days: plans would heat too little in the sun. After three days one ideal sensor in thirty has the second.
_PERHAPS, _RATHER = 0.2, 0.5


@dataclass(frozen=True)
class Probed:
    """A probing that has ended: its record (n steps), the `blocks` that were asked for, one a step, and `why`."""

    record: Record
    blocks: Sequence[Block]
    plant: PlantInfo
    why: str

    def blocked(self, layout: Layout) -> list[Directions]:
        """What it tells of the hours in which each actuator is kept off (A,)."""
        from thermoforce_mpc.model.machine.blocked_hours import BlockedHours, called_for, each_direction

        found: list[Directions] = []
        for a, (z, sign, lowest) in enumerate(zip(layout.home, layout.signs, layout.lowest, strict=True)):
            levels = np.array([math.nan if block.u[a] is None else block.u[a] for block in self.blocks])
            told = [block.command[a] for block in self.blocks]
            bands = [pair if isinstance(pair, tuple) else (math.nan, math.nan) for pair in told]
            heating_C, cooling_C = np.reshape(bands, (-1, 2)).T
            asked = called_for(levels, heating_C, cooling_C, self.record.T_zone_C[z])
            each = each_direction(asked, self.record.part(z, [a]), sign, signed=lowest < 0.0)
            found.append(tuple(BlockedHours.found(*one) for one in each))
        return found


@dataclass(frozen=True)
class Look:
    """What a record of probing gives: the model, or why there is none (`refused`); `days` of the record."""

    days: float
    model: ThermalModel | None
    refused: str = ""

    @cached_property
    def lacks(self) -> dict[str, str]:
        """By actuator what is still lacking, in words: those that are settled are left out; '' is the whole model."""
        from thermoforce_mpc.identification.validation.competence import lacking

        if self.model is None:
            return {"": self.refused}
        cards = zip(self.model.operator.actuators, self.model.cards, strict=True)
        return {name: words for name, card in cards if (words := lacking(card.competence) or _open_sun(card, _RATHER))}

    @property
    def is_well_known(self) -> bool:
        """Whether probing may end before the configured days are over."""
        from thermoforce_mpc.identification.validation.competence import is_well_known

        cards = () if self.model is None else self.model.cards
        return bool(cards) and all(is_well_known(card.competence) and not _open_sun(card, _PERHAPS) for card in cards)

    def in_words(self) -> str:
        """What is lacking, a line; with several actuators one more for each that lacks something."""
        after = f"after {self.days:.3g} days of probing"
        if self.model is None:
            return f"{after} nothing is known: {self.refused}"
        n = len(self.model.cards)
        if not self.lacks:
            return f"{after} the model may act" if n == 1 else f"{after} all {n} actuators may act"
        if n == 1:
            return f"{after} not enough is known: {self.lacks[self.model.operator.actuators[0]]}"
        lines = [f"{after} {n - len(self.lacks)} of {n} actuators may act"]
        return "\n".join([*lines, *(f"  {name}: {words}" for name, words in self.lacks.items())])


def _open_sun(card: ModelCard, above: float) -> str:
    """What is not known of sun on the zone sensor, in words; empty unless its probability is `above` and not likely."""
    probability = card.scores.get("sun_on_sensor", 0.0)
    if not above < probability <= LIKELY:
        return ""
    return f"the sun may shine on the zone sensor (probability {probability:.2g}, taken off from {LIKELY:g})"


class ProbingProgress(NamedTuple):
    """Where a probing stands: `days` probed of `planned_days`."""

    days: float
    planned_days: float


class Identifying:
    """Identifies models from records of the probing of one test case; logs what they lack, says why probing ended."""

    def __init__(
        self,
        testcase: TestCase,
        config: IdentificationConfig,
        step_s: float | None = None,
        say: Callable[[str], None] | None = None,
    ) -> None:
        """`step_s`: step of the models, s, by default the test case's."""
        self.testcase, self.config = testcase, config
        self._step_s, self._say = step_s or testcase.step_s, say
        self._units = UnitDoubts(testcase.layout, currency=testcase.currency)

    def look(self, record: Record, plant: PlantInfo, config: IdentificationConfig | None = None) -> Look:
        """Identify from the record of a probing of `plant`; data that cannot be fitted give the reason."""
        from thermoforce_mpc.identification.pipeline import identify

        self._units.now(record)
        first, days = float(record.time_s[0]) / DAY_S, record.n_steps * record.step_s / DAY_S
        where = f"days {first:g} to {first + days:g}) on {plant.kind} {plant.testcase}, {plant.weather}"
        try:
            model = identify(
                [record],
                config=config or self.config,
                layout=self.testcase.layout,
                step_s=self._step_s,
                source=f"{days:g} days of probing ({where}",
            )
            look = Look(days, model)
        except DataError as error:
            look = Look(days, None, str(error))
        _LOG.info("%s", look.in_words())
        return look

    def conclude(self, probed: Probed, look: Look | None = None) -> ThermalModel:
        """The model of a probing that has ended, with why it ended and what is still lacking on its cards.

        `look`: the last at its record, where there was one. Raises `DataError` where the record is not sufficient.
        """
        from thermoforce_mpc.model.machine.blocked_hours import said as hours_in_words

        look = look or self.look(probed.record, probed.plant)
        ended = f"probing ended after {look.days:.3g} days: {probed.why}"
        _LOG.info("%s", said := ended + (f"; lacking: {', '.join(look.lacks)}" if len(look.lacks) > 1 else ""))
        if self._say:
            self._say(said)
        if look.model is None:
            raise DataError(f"{look.refused} ({ended})")
        cards, blocked = [], probed.blocked(self.testcase.layout)
        for name, card, off in zip(look.model.operator.actuators, look.model.cards, blocked, strict=True):
            notes = (
                f"{ended}; {look.lacks[name]}" if name in look.lacks else ended,
                *[hours_in_words(off)] * any(way.hours for way in off),
            )
            hours = [tuple(sorted(way.hours)) for way in off]
            cards.append(
                replace(
                    card,
                    notes=(*card.notes, *notes),
                    blocked_hours=hours[0],
                    blocked_cooling_hours=hours[1] if len(hours) > 1 else (),
                )
            )
        return replace(look.model, cards=tuple(cards))


def probe_until_known(
    plant: Plant,
    identifying: Identifying,
    *,
    before: Period,
    days: float,
    most_days: float,
    end_early: bool,
    seed: int,
    probing: ProbingConfig | None,
    on_progress: Callable[[ProbingProgress], None] | None = None,
) -> tuple[Probed, Look]:
    """Probe `plant` as `identify_on` says; also the last look at the record. Raises `PlantError`."""
    from thermoforce_mpc.identification.probing.probe import Probing

    start_s, end_s, ahead = before.start_s - before.warmup_s - days * DAY_S, before.start_s, "the scored window"
    if start_s < 0:
        start_s, end_s, ahead = YEAR_S - days * DAY_S, YEAR_S, "the new year"
    run = Probing(plant, start_s, seed=seed, layout=identifying.testcase.layout, config=probing)
    planned_days = days

    def progress(share: float) -> None:
        hourly = max(1, round(HOUR_S / run.config.step_s))
        if on_progress and run.record.n_steps % hourly == 0:
            on_progress(ProbingProgress(run.days, planned_days))

    def enough(record: Record) -> bool:
        if run.days < _LEAST_DAYS:
            return False
        quick = identifying.config.model_copy(update={"modulation": "linear"})
        return identifying.look(record, plant.info, quick).is_well_known

    look = identifying.look(run.go_on(days, enough=enough if end_early else None, on_step=progress), plant.info)
    latest = min(most_days, (end_s - start_s) / DAY_S)
    while look.lacks and run.days + 1.0 <= latest + 1e-9:
        planned_days = run.days + 1.0
        look = identifying.look(run.go_on(1.0, on_step=progress), plant.info)
    why = "enough is known"
    if look.lacks:
        why = "the most days are over" if latest == most_days else f"{ahead} begins"
    return Probed(run.record, tuple(run.blocks), plant.info, why), look
