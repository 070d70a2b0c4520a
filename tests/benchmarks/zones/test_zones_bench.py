"""Targets of the bench of several zones."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.closed_loop.boptest import verdict_in_words
from benchmarks.zones.bench import APARTMENT, HOUSE, Case, Outcome, speed_targets, targets
from benchmarks.zones.scaling import BesideDoMpc
from thermoforce_mpc.model.card import Competence


def outcome(testcase: str, ours, native, thermostat) -> Outcome:
    kpis = zip(("thermoforce_mpc", "native", "thermostat"), (ours, native, thermostat), strict=True)
    return Outcome(Case(testcase, "w", 7.0), {name: {"cost_tot": c, "tdis_tot": d} for name, (c, d) in kpis})


def test_a_house_is_judged_by_the_cheaper_and_the_more_comfortable_baseline():
    cost, discomfort = targets([outcome(HOUSE, (0.9, 0.4), (1.0, 2.0), (1.2, 0.1))])
    assert cost.value == 0.9
    assert cost.holds
    assert discomfort.goal == 0.5
    assert discomfort.holds
    cost, discomfort = targets([outcome(HOUSE, (1.1, 1.1), (1.0, 2.0), (1.2, 1.0))])
    assert not cost.holds
    assert discomfort.goal == 1.0
    assert not discomfort.holds


def test_the_apartment_is_judged_by_a_tenth_of_natives_discomfort():
    cost, discomfort = targets([outcome(APARTMENT, (1.0, 3.0), (1.0, 37.0), (2.0, 0.0))])
    assert cost.holds
    assert discomfort.goal == 0.1 * 37.0
    assert discomfort.holds


def test_a_failed_case_meets_nothing():
    found = targets([Outcome(Case(HOUSE, "w", 7.0), failed="PlantError: no")])
    assert len(found) == 2
    assert not any(target.holds for target in found)
    assert all(math.isnan(target.value) for target in found)


def test_growth_is_the_slope_in_logarithms():
    beside = BesideDoMpc(ours_s=0.02, do_mpc_s=0.7, helped_s=0.5, worst_difference=2e-5)
    exponent, five, faster, helped, same = speed_targets({1: 2.0, 5: 10.0, 10: 20.0}, beside)
    assert (faster.value, helped.value) == pytest.approx((35.0, 25.0))
    assert (faster.holds, helped.holds, same.holds) == (True, False, True)
    assert abs(exponent.value - 1.0) < 1e-9
    assert five.value == 10.0


def test_without_do_mpc_its_targets_are_printed_as_not_met():
    assert [target.holds for target in speed_targets({1: 2.0, 5: 10.0}, None)] == [
        True, True, False, False, False,
    ]  # fmt: skip


def test_the_verdict_on_many_actuators_names_those_that_are_not_competent():
    good = [Competence(True, effect_K=4.0, effect_sd_K=sd_K) for sd_K in (0.4, 0.8)]
    cards = [SimpleNamespace(competence=one) for one in (*good, Competence(False, reasons=("it does not act",)), None)]
    model: Any = SimpleNamespace(cards=cards, operator=SimpleNamespace(actuators=("hall", "bath", "kitchen", "attic")))
    assert verdict_in_words(model) == (
        "2 of 4 actuators competent, the effect of 8 h at full level known to ± 10 to 20 %; "
        "kitchen: not competent: it does not act; attic: not judged"
    )
