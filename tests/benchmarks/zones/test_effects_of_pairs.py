"""Effects of single valves of a house of rooms against an operator that is right, late or wrong."""

from __future__ import annotations

import math

import pytest

from benchmarks.zones.effects import PairScore, worst


def score(own: bool, rms: float, rmse: float) -> PairScore:
    return PairScore("bath", "valve", own, rms, rmse, 1.0)


def test_the_worst_pair_counts_and_pairs_without_effect_do_not():
    scores = [score(True, 1.0, 0.1), score(True, 2.0, 0.5), score(False, 0.01, 0.4), score(False, 0.5, 0.2)]
    assert worst(scores, own=True) == pytest.approx(0.25)
    assert worst(scores, own=False) == pytest.approx(0.4)
    assert math.isnan(worst(scores[:2], own=False))
