"""The trial of part load: a few half levels that change nothing else of the probing."""

from __future__ import annotations

import pytest
from simple_house import SimpleHouse

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.identification.probing.excitation import LevelTrial
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe


def applied(trial: LevelTrial, drawn: list[float]) -> list[float]:
    out, before = [], 0.0
    for level in drawn:
        before = trial.applied(level, before, 1.0)
        out.append(before)
    return out


def test_half_of_the_steps_follow_off_and_half_follow_full_level():
    drawn = [0, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1]
    assert applied(LevelTrial((0.5,), 4), drawn) == [0, 0.5, 0.5, 1, 0.5, 0.5, 1, 0, 1, 1, 1]


def test_a_run_that_is_cut_short_does_not_turn_the_next_one_down():
    assert applied(LevelTrial((0.5,), 4), [1, 0, 1, 1, 1, 1]) == [0.5, 0, 1, 0.5, 0.5, 1]


@pytest.mark.slow
def test_probing_with_a_trial_holds_few_intermediate_levels():
    def levels(**options):
        config = ProbingConfig(design="random", warmup_days=0.0, margin_K=20.0, **options)
        return probe(SimpleHouse(), 20 * DAY_S, 2.0, seed=3, config=config).u[0]

    plain, tried = levels(), levels(trial_levels=(0.5,))
    assert set(plain) == {0.0, 1.0}
    assert 3 <= (tried == 0.5).sum() <= 4
    assert ((tried > 0) == (plain > 0)).mean() > 0.9
