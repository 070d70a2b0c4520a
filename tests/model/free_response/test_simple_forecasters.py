"""Forecasters without a network: each on a series whose future is known."""

from __future__ import annotations

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, daily, first_order_room, history_of, hours

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.registry import build_free_response

PLAIN = ("persistence", "linear_weather")


@pytest.mark.parametrize("name", PLAIN)
def test_quantiles_have_the_shape_and_order_of_the_protocol(name: str) -> None:
    rng = np.random.default_rng(0)
    t = hours(240)
    free = daily(t) + 0.1 * rng.standard_normal(t.size)
    forecast = build_free_response(name).forecast(free, history_of(free), boundary_of(240, 30))
    assert forecast.quantiles_C.shape == (9, 30)
    np.testing.assert_allclose(forecast.levels, LEVELS)
    assert np.isfinite(forecast.quantiles_C).all()
    assert (np.diff(forecast.quantiles_C, axis=0) >= 0).all()
    assert forecast.note


def test_a_daily_course_is_learned_by_the_linear_model() -> None:
    free = daily(hours(240))
    forecast = build_free_response("linear_weather").forecast(free, history_of(free), boundary_of(240, 24))
    truth = daily(np.arange(241, 265))
    assert np.abs(forecast.median_C - truth).max() < 0.15


def test_persistence_repeats_the_last_finite_value_and_widens_with_lead_time() -> None:
    rng = np.random.default_rng(1)
    free = 18.0 + np.cumsum(0.2 * rng.standard_normal(400))
    free[-1] = np.nan
    forecast = build_free_response("persistence").forecast(free, history_of(free), boundary_of(399, 24))
    np.testing.assert_allclose(forecast.median_C, free[-2])
    width = forecast.quantiles_C[-1] - forecast.quantiles_C[0]
    # The 80 % interval of a random walk with steps of 0.2 K: 2.56 standard deviations.
    assert width[0] == pytest.approx(2.56 * 0.2, rel=0.25)
    assert width[15] == pytest.approx(4 * width[0], rel=0.35)


def test_weather_of_the_forecast_moves_the_linear_model_as_it_moves_the_room() -> None:
    free, outdoor = first_order_room()
    history = history_of(free, T_out_C=outdoor)
    mild, cold = (boundary_of(336, 24, T_out_C=np.full(25, outdoor[-1] + d)) for d in (5.0, -5.0))
    method = build_free_response("linear_weather")
    difference = method.forecast(free, history, mild).median_C - method.forecast(free, history, cold).median_C
    assert np.abs(difference - 10.0 * (1.0 - 0.9 ** np.arange(1, 25))).max() < 1.0
    assert (difference > 0).all()


@pytest.mark.parametrize("name", PLAIN)
def test_nothing_but_time_and_weather_of_the_history_is_used(name: str) -> None:
    """The control must not reach a free response: another u, power and zone temperature change no bit."""
    free = daily(hours(240)) + 0.1 * np.random.default_rng(4).standard_normal(241)
    plain = build_free_response(name).forecast(free, history_of(free), boundary_of(240, 24))
    other = history_of(free + 7.0, u=np.linspace(0, 1, 240), power_W=np.full(240, 3e3), heat_W=np.full(240, 9e3))
    np.testing.assert_array_equal(
        plain.quantiles_C, build_free_response(name).forecast(free, other, boundary_of(240, 24)).quantiles_C
    )


@pytest.mark.parametrize("name", PLAIN)
def test_a_silent_sensor_or_a_wrong_shape_is_refused(name: str) -> None:
    free = np.full(241, np.nan)
    with pytest.raises(DataError, match="no finite value"):
        build_free_response(name).forecast(free, history_of(free), boundary_of(240, 24))
    with pytest.raises(DataError, match="shape"):
        build_free_response(name).forecast(np.zeros(240), history_of(free), boundary_of(240, 24))


def test_too_little_history_is_refused_with_the_amount_needed() -> None:
    free = daily(hours(20))
    with pytest.raises(DataError, match="a day"):
        build_free_response("linear_weather").forecast(free, history_of(free), boundary_of(20, 24))


def test_gaps_are_bridged_by_the_linear_model() -> None:
    free = daily(hours(240))
    free[200:206] = np.nan
    free[-3:] = np.nan
    forecast = build_free_response("linear_weather").forecast(free, history_of(free), boundary_of(240, 24))
    assert np.abs(forecast.median_C - daily(np.arange(241, 265))).max() < 0.4


def test_linear_model_refuses_weather_that_is_not_finite() -> None:
    free = daily(hours(240))
    hole = np.full(25, 5.0)
    hole[7] = np.nan
    with pytest.raises(DataError, match="T_out_C is not finite at step 247"):
        build_free_response("linear_weather").forecast(free, history_of(free), boundary_of(240, 24, T_out_C=hole))
