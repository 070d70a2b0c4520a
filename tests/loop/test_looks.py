"""What a look at a probing says is still lacking, actuator by actuator."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simple_house import simple_model

from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Layout, PlantInfo, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.validation.competence import SETTLED_SD, lacking
from thermoforce_mpc.loop.probing import Identifying, Look, Probed
from thermoforce_mpc.model.card import Competence

KNOWN = Competence(True, effect_K=2.0, effect_sd_K=0.2)
POOR = Competence(True, effect_K=2.0, effect_sd_K=0.7)
UNFIT = Competence(False, ("6 h ahead it errs by 1.3 K, need 1 K",), effect_K=2.0, effect_sd_K=0.1)


def look(sun: float = 0.0, **verdicts: Competence | None) -> Look:
    """A look at a model of which only names, verdicts and the probability of `sun` on the sensors count."""
    cards = tuple(SimpleNamespace(competence=verdict, scores={"sun_on_sensor": sun}) for verdict in verdicts.values())
    model = SimpleNamespace(operator=SimpleNamespace(actuators=tuple(verdicts)), cards=cards)
    return Look(4.0, model)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (None, ""),
        (KNOWN, ""),
        (POOR, "the effect is known to ± 35 % only, need 30 %"),
        (UNFIT, "not competent: 6 h ahead it errs by 1.3 K, need 1 K"),
    ],
)
def test_what_is_lacking_is_said_with_what_is_needed(verdict, words):
    assert lacking(verdict) == words
    assert SETTLED_SD == 0.3


def test_each_actuator_that_is_not_settled_has_a_line():
    several = look(bath=KNOWN, hall=POOR, kitchen=UNFIT, living=None)
    assert list(several.lacks) == ["hall", "kitchen"]
    assert several.in_words().splitlines() == [
        "after 4 days of probing 2 of 4 actuators may act",
        "  hall: the effect is known to ± 35 % only, need 30 %",
        "  kitchen: not competent: 6 h ahead it errs by 1.3 K, need 1 K",
    ]


def test_one_actuator_needs_no_name():
    assert look(actuator=KNOWN).in_words() == "after 4 days of probing the model may act"
    assert look(actuator=POOR).in_words() == (
        "after 4 days of probing not enough is known: the effect is known to ± 35 % only, need 30 %"
    )
    assert Look(1.5, None, "u is constant").in_words() == "after 1.5 days of probing nothing is known: u is constant"


def test_probing_ends_early_only_where_every_actuator_is_known_well():
    well = Competence(True, effect_K=2.0, effect_sd_K=0.1)
    assert look(bath=well, hall=well).is_well_known
    assert not look(bath=well, hall=KNOWN).is_well_known


@pytest.mark.parametrize(
    ("sun", "ends_early", "goes_on"), [(0.1, True, False), (0.3, False, False), (0.8, False, True), (0.95, True, False)]
)
def test_sun_on_a_sensor_is_decided_before_probing_ends(sun, ends_early, goes_on):
    known = look(sun, actuator=Competence(True, effect_K=2.0, effect_sd_K=0.1))
    assert known.is_well_known is ends_early
    said = "the sun may shine on the zone sensor (probability 0.8, taken off from 0.9)"
    assert known.lacks == ({"actuator": said} if goes_on else {})


PLANT = PlantInfo("kind", "case", "words", "weather", "version")


def card_after(layout: Layout, blocks: list[Block], got: np.ndarray, T_C: np.ndarray):
    """The card of a probing by `blocks` of an hour from midnight on, with the levels and readings that came."""
    time_s = 30 * DAY_S + HOUR_S * np.arange(len(blocks) + 1)
    zeros = np.zeros(time_s.size)
    record = Record(time_s, T_C, zeros, zeros, got, zeros[1:], zeros[1:])
    testcase = SimpleNamespace(layout=layout, step_s=HOUR_S, currency="EUR")
    identifying = Identifying(testcase, IdentificationConfig())  # type: ignore[arg-type]
    return identifying.conclude(Probed(record, blocks, PLANT, "enough is known"), Look(2.0, simple_model())).only.card


def test_hours_in_which_nothing_came_while_probing_stand_on_the_card():
    """Two days from midnight on, in which the machine works from 5:00 on only."""
    got = (np.arange(48) % 24 >= 5).astype(float)
    for level, hours in ((1.0, (0, 1, 2, 3, 4)), (None, ())):
        card = card_after(Layout.single(), [Block(level, HOUR_S)] * 48, got, np.full(49, 20.0))
        assert card.blocked_hours == hours
        assert ("nothing comes from 0:00 to 5:00" in " ".join(card.notes)) is bool(hours)


@pytest.mark.parametrize(
    ("night", "night_C", "heating", "cooling"),
    [
        (Block(-0.6, HOUR_S, (15.0, 21.5)), 20.0, (), ()),  # nothing calls for cold below its set-point
        (Block(-0.6, HOUR_S, (15.0, 19.7)), 20.0, (), ()),  # nor surely where the room is at it
        (Block(1.0, HOUR_S, (18.0, 24.0)), 20.0, (), ()),  # nor for heat above its set-point
        (Block(0.0, HOUR_S, (15.0, 30.0)), 20.0, (), ()),
        (Block(1.0, HOUR_S, (22.0, 24.0)), 20.0, (0, 1, 2, 3, 4), ()),
        (Block(-0.6, HOUR_S, (15.0, 18.0)), 20.0, (), (0, 1, 2, 3, 4)),
    ],
)
def test_loops_refuse_only_what_their_set_points_call_for(night, night_C, heating, cooling):
    """A unit that heats and cools by set-points stands from 0:00 to 5:00, heats until 14:00 and cools then."""
    hour = np.arange(48) % 24
    asleep = hour < 5
    day = {True: Block(1.0, HOUR_S, (23.0, 26.0)), False: Block(-0.6, HOUR_S, (15.0, 18.0))}
    blocks = [night if off else day[bool(h < 14)] for off, h in zip(asleep, hour, strict=True)]
    got = np.where(asleep, 0.0, np.where(hour < 14, 0.5, -0.5))
    T_C = np.append(np.where(asleep, night_C, 20.0), 20.0)
    card = card_after(Layout.single("both", -0.6), blocks, got, T_C)
    assert card.blocked_hours == heating
    assert card.blocked_cooling_hours == cooling
    assert any("no cold comes from 0:00 to 5:00" in note for note in card.notes) is bool(cooling)
