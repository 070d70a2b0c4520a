"""Probing in the loop: of a simulated plant, until a model of it knows enough, and what it still lacks at each look."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    SAMPLED,
    YEAR_S,
    Block,
    Layout,
    Period,
    PlantInfo,
    Record,
    steps_in,
)
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import PlantDriver, advanced
from thermoforce_mpc.loop.inputs import UnitDoubts
from thermoforce_mpc.loop.loop import Believed, Decided, Loop
from thermoforce_mpc.model.sun_on_sensor import LIKELY
from thermoforce_mpc.protocols import Plant

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import EndRule, ProbingConfig
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
        from thermoforce_mpc.model.machine.blocked_hours import (
            BlockedHours,
            ahead_s,
            called_for,
            each_direction,
            running,
        )

        # By the clock on the wall, since a model made in winter acts in summer.
        clock_s = ahead_s(float(self.record.time_s[-1]), self.record.origin)
        found: list[Directions] = []
        for a, (z, sign, u_min) in enumerate(zip(layout.home, layout.signs, layout.u_min, strict=True)):
            levels = np.array([math.nan if block.u[a] is None else block.u[a] for block in self.blocks])
            told = [block.command[a] for block in self.blocks]
            bands = [pair if isinstance(pair, tuple) else (math.nan, math.nan) for pair in told]
            heating_C, cooling_C = np.reshape(bands, (-1, 2)).T
            asked = called_for(levels, heating_C, cooling_C, self.record.T_zone_C[z])
            m = layout.machine_of[a]
            record = self.record.part(z, [a], [m])
            if len(layout.fed_by(m)) == 1 and u_min >= 0.0:
                record = running(record)
            each = each_direction(asked, record, sign, signed=u_min < 0.0)
            found.append(tuple(BlockedHours.found(*one).moved(clock_s) for one in each))
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


class ProbedBuilding(Protocol):
    """What is known of a building that is probed: a test case, or a real one."""

    @property
    def layout(self) -> Layout:
        """What acts where."""

    @property
    def currency(self) -> str:
        """What prices are in."""

    @property
    def step_s(self) -> float:
        """Default control step, s."""


class Identifying:
    """Identifies models from records of the probing of one test case; logs what they lack, says why probing ended."""

    def __init__(
        self,
        testcase: ProbedBuilding,
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


class Probing(PlantDriver):
    """A probing of a simulated plant that can be continued, as the driver of a loop.

    `record` is what was measured so far, without the warm-up; `blocks` what was asked for, one a step.
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
        from thermoforce_mpc.identification.probing.probe import ProbingConfig

        self.config = c = config or ProbingConfig()
        super().__init__(plant)
        self._layout, self._seed = layout or Layout.single(), seed
        now = plant.reset(start_s, min(c.warmup_days * DAY_S, start_s))
        self.record, self.blocks = Record.beginning(now), list[Block]()
        # The past bounds the effect of a level; rooms need none.
        self._past = self.record
        if any(u_min >= 0.0 for u_min in self._layout.u_min):
            past = plant.past(c.step_s)
            sampled: dict[str, Any] = {name: np.copy(getattr(past, name)) for name in SAMPLED}
            for name in SAMPLED:
                sampled[name][..., -1] = getattr(now, name)
            self._past = replace(past, **sampled)
        self._state: object = None
        self._on_step: Callable[[], None] = lambda: None

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
        first, n = self.record.n_steps, round(days * DAY_S / self.config.step_s)

        def until(record: Record, planned: int) -> tuple[int, str]:
            if record.n_steps >= first + n:
                return first + n, "its days are over"
            return first + n, "enough is known" if record.n_steps > first and enough and enough(record) else ""

        self.run(until, lambda: on_step((self.record.n_steps - first) / n) if on_step else None)
        return self.record

    def run(self, until: EndRule, on_step: Callable[[], None] = lambda: None) -> None:
        """Probe until the rule ends it; `on_step` is called after every step. Raises as `go_on`."""
        from thermoforce_mpc.identification.probing.probe import ProbingController

        self._on_step = on_step
        self._state = Loop(self, ProbingController(self._layout, self.config, self._seed, until)).run()

    def begin(self) -> object:
        """See `LoopDriver.begin`."""
        return self._state

    def next_step(self) -> bool:
        """See `LoopDriver.next_step`: a probing is ended by its rule."""
        return True

    def read(self) -> Believed:
        """See `LoopDriver.read`: readings are judged where a model is identified from them."""
        history = self.record if self.record.n_steps else self._past
        return Believed(history, history, (), math.inf, self._layout.u_min)

    def units(self) -> UnitDoubts | None:
        """See `LoopDriver.units`: `Identifying` looks for them."""
        return None

    def act(self, decided: Decided) -> object:
        """See `LoopDriver.act`."""
        for block in decided.blocks:
            self.blocks.append(block)
            self.record = self.record.extended(advanced(self.plant, block))
        self._on_step()
        return decided.after


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


class UntilKnown:
    """The end rule of a probing: after `days` as soon as a model of it may act, or before them, or later, by the day.

    `why`, `look` and `record` are those of the end.
    """

    def __init__(
        self,
        identifying: Identifying,
        plant: PlantInfo,
        step_s: float,
        *,
        days: float,
        most_days: float,
        room_days: float = math.inf,
        before: str = "",
        end_early: bool,
    ) -> None:
        """`room_days`: days until what comes next, which is named by `before`; see `identify_on` for the others."""
        self._identifying, self._plant, self._step_s, self._end_early = identifying, plant, step_s, end_early
        self._first, self._day = round(days * DAY_S / step_s), round(DAY_S / step_s)
        self._most_days, self._latest, self._before = most_days, min(most_days, room_days), before
        self.planned_days = days
        self.why = ""
        self.look: Look | None = None
        self.record: Record | None = None

    def __call__(self, record: Record, planned: int) -> tuple[int, str]:
        """See `EndRule`."""
        done = record.n_steps
        planned = planned or self._first
        if done < planned and not (planned == self._first and self._end_early and self._is_enough(record)):
            return self._as_planned(planned), ""
        self.look, self.record = self._identifying.look(record, self._plant), record
        look = self.look
        if look.lacks and done * self._step_s / DAY_S + 1.0 <= self._latest + 1e-9:
            return self._as_planned(done + self._day), ""
        self.why = "enough is known"
        if look.lacks:
            self.why = "the most days are over" if self._latest == self._most_days else f"{self._before} begins"
        return self._as_planned(planned), self.why

    def _is_enough(self, record: Record) -> bool:
        if record.n_steps * self._step_s / DAY_S < _LEAST_DAYS:
            return False
        quick = self._identifying.config.model_copy(update={"modulation": "linear"})
        return self._identifying.look(record, self._plant, quick).is_well_known

    def _as_planned(self, planned: int) -> int:
        self.planned_days = planned * self._step_s / DAY_S
        return planned


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
    start_s, end_s, ahead = before.start_s - before.warmup_s - days * DAY_S, before.start_s, "the scored window"
    if start_s < 0:
        start_s, end_s, ahead = YEAR_S - days * DAY_S, YEAR_S, "the new year"
    run = Probing(plant, start_s, seed=seed, layout=identifying.testcase.layout, config=probing)
    until = UntilKnown(
        identifying,
        plant.info,
        run.config.step_s,
        days=days,
        most_days=most_days,
        room_days=(end_s - start_s) / DAY_S,
        before=ahead,
        end_early=end_early,
    )
    hourly = steps_in(HOUR_S, run.config.step_s)

    def progress() -> None:
        if on_progress and run.record.n_steps % hourly == 0:
            on_progress(ProbingProgress(run.days, until.planned_days))

    run.run(until, progress)
    assert until.look is not None
    return Probed(run.record, tuple(run.blocks), plant.info, until.why), until.look
