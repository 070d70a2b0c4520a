"""Bands of effects that are known to a factor."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import NORMAL_95
from thermoforce_mpc.identification.estimation.regression import Effect


def band(log_sd: float) -> float:
    """Half of the band about an effect of which the logarithm has this standard deviation, as a share of it."""
    effect = Effect(np.log([10.0]), np.array([0.4]), np.zeros(7))
    found = effect.uncertainty(log_sd, of_logarithm=True)
    assert found["step_response_48h_K"] == pytest.approx(effect.step_K[-1])
    return NORMAL_95 * found["step_response_48h_sd_K"] / found["step_response_48h_K"]


@pytest.mark.parametrize("log_sd", [0.1, 0.3, 0.6, 1.2])
def test_a_band_of_a_logarithm_holds_nine_of_ten(log_sd):
    away = np.abs(np.exp(log_sd * np.random.default_rng(0).normal(size=100_000)) - 1.0)
    assert np.mean(away <= band(log_sd)) == pytest.approx(0.9, abs=0.005)


def test_a_band_of_a_logarithm_is_as_wide_as_any_where_it_is_narrow_and_ends():
    assert band(0.01) == pytest.approx(NORMAL_95 * 0.01, rel=1e-3)
    assert band(0.0) == 0.0
    assert band(1.5) == band(4.0)
