"""Back-off: the chance level where forecasts are good, the expected violation where they are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from controllers.mpc.margin_rules import backoff_K
from thermoforce_mpc.data import FreeForecast

LEVELS = np.arange(1, 10) / 10
STEP_S = 900.0


def normal_forecast(sd_K: np.ndarray) -> FreeForecast:
    """A forecast whose quantiles are those of a normal distribution about 20 °C."""
    return FreeForecast(LEVELS, 20.0 + norm.ppf(LEVELS)[:, None] * sd_K)


def expected_violation(sd_K: np.ndarray, distance_K: np.ndarray) -> np.ndarray:
    """E[(bound − T)+] at `distance_K` from the median, by integration of the normal distribution."""
    z = np.linspace(-8, 8, 40001)
    short = np.maximum(-(sd_K[:, None] * z + distance_K[:, None]), 0.0)
    return np.trapezoid(short * norm.pdf(z), z, axis=1)


def test_good_forecasts_are_ruled_by_the_chance_level():
    sd = np.full(48, 0.03)
    found = backoff_K(normal_forecast(sd), STEP_S, 0.2, 0.01, below=True)
    np.testing.assert_allclose(found, norm.isf(0.2) * sd, rtol=1e-9)


def test_uncertain_forecasts_are_ruled_by_the_expected_violation_of_the_next_hours():
    sd = np.linspace(0.1, 0.9, 96)
    found = backoff_K(normal_forecast(sd), STEP_S, 0.25, 0.01, below=True)
    # One z for all lead times; with the mean spread of six hours it allows just the violation given.
    z = found / sd
    np.testing.assert_allclose(z, z[0])
    mean = sd[:24].mean()
    assert expected_violation(np.array([mean]), np.array([z[0] * mean]))[0] == pytest.approx(0.01, rel=2e-3)
    assert z[0] > norm.isf(0.25)


def test_violation_does_not_grow_with_the_spread_as_it_does_at_a_chance_level():
    small, large = np.full(48, 0.1), np.full(48, 0.4)
    chance = [
        expected_violation(sd, backoff_K(normal_forecast(sd), STEP_S, 0.25, None, below=True)) for sd in (small, large)
    ]
    both = [
        expected_violation(sd, backoff_K(normal_forecast(sd), STEP_S, 0.25, 0.0135, below=True))
        for sd in (small, large)
    ]
    assert chance[1][0] == pytest.approx(4 * chance[0][0], rel=1e-3)
    assert both[1][0] == pytest.approx(both[0][0], rel=0.02)


def test_the_upper_bound_is_backed_off_from_by_the_upper_quantiles():
    skewed = FreeForecast(
        LEVELS, 20.0 + np.where(LEVELS < 0.5, 0.1, 0.4)[:, None] * norm.ppf(LEVELS)[:, None] * np.ones(48)
    )
    below = backoff_K(skewed, STEP_S, 0.3, None, below=True)
    above = backoff_K(skewed, STEP_S, 0.3, None, below=False)
    np.testing.assert_allclose(above, 4 * below)


def test_a_certain_forecast_needs_none():
    flat = FreeForecast(LEVELS, np.full((9, 48), 20.0))
    np.testing.assert_array_equal(backoff_K(flat, STEP_S, 0.1, 0.01, below=True), 0.0)
