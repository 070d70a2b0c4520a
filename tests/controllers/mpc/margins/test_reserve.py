"""Reserve inside the comfort bound: none in a slow zone, more with blocks and errors, and bounded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controllers.actuation.actuator import Actuation, ActuationConfig
from controllers.mpc.margins import is_fast, reserve_K
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.operator.parameters import linear_operator

MODULATING = Actuation(ActuationConfig(mode="modulating", lowest_level=0.0))
BLOCKS = Actuation(ActuationConfig(mode="duty"))
LOW_BLOCKS = Actuation(ActuationConfig(mode="modulating", lowest_level=0.4))


def operator(K_per_h: float, step_s: float = 900.0):
    return linear_operator(np.array([0.99]), np.array([K_per_h * step_s / 3600.0]), step_s=step_s)


def card(error_K: float = 0.0) -> ModelCard:
    score = HorizonScore(1.0, error_K, 1.0, 1.0, 5.0, 5)
    return ModelCard(competence=Competence(True, horizons=(score,)))


def test_a_slow_zone_keeps_none():
    slow = operator(0.5)
    assert not is_fast(slow)
    assert reserve_K(slow, BLOCKS, card(0.4)) == 0.0


def test_a_delay_at_the_start_does_not_make_a_fast_zone_slow():
    taus = np.array([0.39, 1.93])
    gains = np.array([-1.4, 7.4]) * (1.0 - np.exp(-0.25 / taus))
    radiator = linear_operator(np.exp(-0.25 / taus), gains, step_s=900.0)
    assert abs(radiator.impulse(1)[0]) < 0.25
    assert is_fast(radiator)


def test_a_fast_zone_keeps_more_for_each_thing_that_a_plan_cannot_see():
    fast = operator(2.0)
    plain = reserve_K(fast, MODULATING, card())
    assert plain == 0.0
    assert reserve_K(fast, MODULATING, card(0.2)) == pytest.approx(0.1)
    assert 0.05 < reserve_K(fast, BLOCKS, card()) < 0.2
    assert reserve_K(fast, LOW_BLOCKS, card()) == pytest.approx(0.4 * reserve_K(fast, BLOCKS, card()))
    assert reserve_K(operator(3.0), BLOCKS, card()) > reserve_K(fast, BLOCKS, card())
    cooling = replace(fast, gains=-fast.gains, sign=-1)
    assert reserve_K(cooling, BLOCKS, card()) == reserve_K(fast, BLOCKS, card())


def test_the_swing_is_that_of_the_longest_cycle_that_minimum_times_ask_for():
    """It is on for 0.35 of a cycle: 35 of 100 min, off for 65."""

    def of(**times) -> float:
        return reserve_K(operator(0.7), Actuation(ActuationConfig(mode="duty", block_s=60.0, **times)), card())

    least = of(min_on_s=2100.0, min_off_s=0.0)
    assert 0.0 < least < 0.15
    assert of(min_on_s=4200.0, min_off_s=0.0) == pytest.approx(2.0 * least)
    assert of(min_on_s=0.0, min_off_s=3900.0) == pytest.approx(least)
    assert of(min_on_s=0.0, min_off_s=0.0) == pytest.approx(least * 120.0 / 6000.0), "two blocks"


def test_it_is_bounded_whatever_the_model_says():
    assert reserve_K(operator(40.0), BLOCKS, card(5.0)) == 0.3
    assert reserve_K(operator(40.0), BLOCKS, card(float("nan"))) == 0.3
    assert reserve_K(operator(2.0), MODULATING, ModelCard()) == 0.0
