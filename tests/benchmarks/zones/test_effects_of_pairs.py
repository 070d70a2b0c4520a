"""Effects of single valves of a house of rooms against an operator that is right, late or wrong."""

from __future__ import annotations

import math

import pytest

from benchmarks.zones.effects import PairScore, within_limits, worst
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.plants.rooms import house_of_rooms


def score(own: bool, rms: float, rmse: float) -> PairScore:
    return PairScore("bath", "valve", own, rms, rmse, 1.0)


def test_the_worst_pair_counts_and_pairs_without_effect_do_not():
    scores = [score(True, 1.0, 0.1), score(True, 2.0, 0.5), score(False, 0.01, 0.4), score(False, 0.5, 0.2)]
    assert worst(scores, own=True) == pytest.approx(0.25)
    assert worst(scores, own=False) == pytest.approx(0.4)
    assert math.isnan(worst(scores[:2], own=False))


@pytest.mark.slow
def test_effects_are_those_of_valves_that_do_not_take_heat_from_each_other():
    """As drawn its machine feeds two thirds of its valves: one that opens cools the other rooms."""
    drawn = house_of_rooms("house:5rooms:71")
    from_others_K = []
    for plant in (drawn, within_limits(drawn)):
        T_C = []
        for first in (0.0, 1.0):
            plant.reset(plant.period("cold_week").start_s, 0.0)
            T_C.append(plant.advance((first, 1.0, 1.0, 1.0, 1.0), 6 * HOUR_S).T_zone_C)
        from_others_K.append((T_C[1] - T_C[0])[1:])
    assert from_others_K[0].min() < -0.1
    assert from_others_K[1].min() >= 0.0
