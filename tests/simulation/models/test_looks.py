"""What a look at a probing says is still lacking, actuator by actuator."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from thermoforce_mpc.identification.validation.competence import SETTLED_SD, lacking
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.simulation.models.probing import Look

KNOWN = Competence(True, effect_K=2.0, effect_sd_K=0.2)
POOR = Competence(True, effect_K=2.0, effect_sd_K=0.7)
UNFIT = Competence(False, ("6 h ahead it errs by 1.3 K, need 1 K",), effect_K=2.0, effect_sd_K=0.1)


def look(**verdicts: Competence | None) -> Look:
    """A look at a model of which only names and verdicts count."""
    cards = tuple(SimpleNamespace(competence=verdict) for verdict in verdicts.values())
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
