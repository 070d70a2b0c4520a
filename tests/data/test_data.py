"""Quantiles between and beyond the levels that were forecast."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import FreeForecast


@pytest.mark.parametrize(
    ("level", "expected"), [(0.1, 18.0), (0.3, 19.0), (0.5, 20.0), (0.6, 21.0), (0.9, 24.0), (0.01, 18.0), (0.99, 24.0)]
)
def test_a_quantile_lies_on_the_line_between_its_neighbours(level, expected):
    forecast = FreeForecast(np.array([0.1, 0.5, 0.9]), np.array([[18.0, 8.0], [20.0, 10.0], [24.0, 14.0]]))
    np.testing.assert_allclose(forecast.quantile_C(level), [expected, expected - 10.0])


def test_a_single_level_answers_for_all():
    forecast = FreeForecast(np.array([0.5]), np.array([[20.0, 21.0]]))
    np.testing.assert_allclose(forecast.quantile_C(0.1), [20.0, 21.0])
