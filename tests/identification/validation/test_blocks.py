"""The paired test holds its level, also where predictions overlap."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.identification.validation.errors_ahead import is_significant, quantile, standard_errors_saved


def _shares(overlap: int, *, n: int, smooth: int, tries: int = 2000, better: float = 1.0) -> float:
    """How often errors of one kind are called smaller than those of the other, which are `better` times as large."""
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(tries):
        # Block by block sums of squares: predictions that overlap by `smooth` blocks share their weather.
        logs = np.convolve(rng.normal(size=n + smooth), np.ones(smooth + 1) / np.sqrt(smooth + 1), "valid")
        model, other = np.exp(0.5 * logs), np.full(n, better)
        statistic, count = standard_errors_saved(model, other, np.arange(n), overlap)
        found += is_significant(statistic, count, 0.95, overlap)
    return found / tries


def test_independent_blocks_have_the_level_of_the_t_test():
    assert _shares(0, n=12, smooth=0) == pytest.approx(0.05, abs=0.015)
    assert quantile(10, 0.95) == pytest.approx(1.833, abs=1e-3)


def test_overlap_that_is_not_counted_finds_a_difference_far_too_often():
    """Predictions a day ahead in blocks of 4 h: 5 % are called, 24 without, 11 with it, since Bartlett weights fall."""
    assert _shares(0, n=30, smooth=5) > 0.20
    assert _shares(6, n=30, smooth=5) < 0.12
    assert _shares(6, n=10, smooth=5) < 0.2


def test_what_is_clearly_smaller_is_found_all_the_same():
    assert _shares(6, n=30, smooth=5, better=0.3) > 0.8


def test_quantiles_grow_with_probability_and_overlap():
    assert quantile(30, 0.99, 6) > quantile(30, 0.975, 6) > quantile(30, 0.95, 6) > quantile(30, 0.9, 6) > 1.28
    assert quantile(30, 0.99, 6) > quantile(30, 0.99, 1) > 2.33
    statistic, count = standard_errors_saved(np.ones(3), np.full(3, 0.1), np.arange(3), 2)
    assert np.isnan(statistic)
    assert not is_significant(statistic, count, 0.9, 2)
