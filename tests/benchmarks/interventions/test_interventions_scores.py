"""Scores against numbers worked out by hand, and the test over cells."""

from dataclasses import replace

import numpy as np
import pytest
from paired_windows import N, run, window

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.scores import LEVELS, one_sided_wilcoxon, score_cell
from thermoforce_mpc.errors import DataError


class Affine:
    """Answers `level + gain · u`, the same at every step."""

    note = "by hand"

    def __init__(self, level, gain):
        self.level, self.gain = level, gain

    def respond(self, window, u):
        return self.level + self.gain * u


def flat(factual_C, perturbed_C, u_factual, u_perturbed, shift_K):
    """A window whose temperatures and controls are constant."""
    base = run(10, np.full(N, u_factual))
    factual = replace(base, T_zone_C=np.full(N + 1, factual_C))
    perturbed = replace(base, T_zone_C=np.full(N + 1, perturbed_C), u=np.full(N, u_perturbed))
    return Window("heating_chicago", "morning", "test", 10, shift_K, run(5, np.full(96, 0.3)), factual, perturbed)


def test_scores_by_hand():
    windows = [flat(20.0, 21.0, 0.2, 0.4, 1.0), flat(20.0, 19.0, 0.4, 0.3, -1.0)]
    score = score_cell("method", Affine(18.0, 4.0), windows, 3, 1)
    # Effects 0.8 of 1.0 and -0.4 of -1.0; factual answers 18.8 and 19.6 of 20.
    assert score.up_rmse_K == pytest.approx(0.2)
    assert score.down_rmse_K == pytest.approx(0.6)
    assert score.effect_rmse_K == pytest.approx(np.sqrt((0.04 + 0.36) / 2))
    assert score.factual_rmse_K == pytest.approx(np.sqrt((1.44 + 0.16) / 2))
    assert score.sign_accuracy == 1.0
    assert (score.violations, score.comparisons) == (0, 2 * (LEVELS.size - 1) * N)
    assert (score.pairs, score.days, score.cell) == (2, 3, ("heating_chicago", "morning"))


def test_a_gain_of_the_wrong_sign_is_counted_as_such():
    windows = [flat(20.0, 21.0, 0.2, 0.4, 1.0)]
    score = score_cell("method", Affine(18.0, -4.0), windows, 1, 1)
    assert score.sign_accuracy == 0.0
    assert score.violations == score.comparisons
    cooled = score_cell("method", Affine(18.0, -4.0), windows, 1, -1)
    assert cooled.violations == 0, "less is more where the machine cools"


def test_effects_too_small_to_have_a_sign_are_not_scored_for_it():
    windows = [flat(20.0, 20.04, 0.2, 0.1, 1.0), flat(20.0, 21.0, 0.2, 0.4, 1.0)]
    assert score_cell("method", Affine(18.0, 4.0), windows, 1, 1).sign_accuracy == 1.0


def test_a_forecast_that_cannot_be_asked_has_no_effect_and_no_sign():
    score = score_cell("method", Affine(20.0, 0.0), [flat(20.0, 21.0, 0.2, 0.4, 1.0)], 1, 1)
    assert score.effect_rmse_K == pytest.approx(1.0)
    assert score.factual_rmse_K == 0.0
    assert score.sign_accuracy == 0.0


def test_windows_of_two_cells_are_refused():
    with pytest.raises(DataError, match="one cell"):
        score_cell("m", Affine(0, 1), [window(40, "morning", 1.0), window(40, "evening", 1.0)], 1, 1)


def cells(values):
    one = score_cell("m", Affine(18.0, 4.0), [flat(20.0, 21.0, 0.2, 0.4, 1.0)], 1, 1)
    return [replace(one, window=str(i), effect_rmse_K=value) for i, value in enumerate(values)]


def test_six_cells_all_won_give_the_least_p_there_is():
    ours, theirs = cells([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), cells([0.2, 0.31, 0.42, 0.53, 0.64, 0.75])
    assert one_sided_wilcoxon(ours, theirs) == (pytest.approx(1 / 64), 6)
    assert one_sided_wilcoxon(theirs, ours) == (pytest.approx(1.0), 0)
    assert one_sided_wilcoxon(ours, ours) == (1.0, 0)


def test_the_order_of_the_cells_does_not_matter_and_missing_ones_are_refused():
    ours, theirs = cells([0.1, 0.2, 0.3]), cells([0.2, 0.1, 0.6])
    assert one_sided_wilcoxon(ours, theirs[::-1]) == one_sided_wilcoxon(ours, theirs)
    with pytest.raises(DataError, match="same cells"):
        one_sided_wilcoxon(ours, theirs[:2])
