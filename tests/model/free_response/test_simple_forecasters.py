"""Forecasters without a network: each on a series whose future is known."""

from __future__ import annotations

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, history_of, hours

from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.model.free_response.registry import build_free_response

PLAIN = ("persistence", "seasonal_naive", "ar", "arx", "ets", "linear_weather")


def daily(t: np.ndarray) -> np.ndarray:
    return 15.0 + 2.0 * np.sin(2 * np.pi * t / 24) + 0.3 * np.cos(4 * np.pi * t / 24)


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


@pytest.mark.parametrize("name", ["seasonal_naive", "ar", "arx", "ets", "linear_weather"])
def test_a_daily_course_is_learned(name: str) -> None:
    t = hours(240)
    free = daily(t)
    forecast = build_free_response(name).forecast(free, history_of(free), boundary_of(240, 24))
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


def test_seasonal_naive_repeats_yesterday_at_half_hour_steps() -> None:
    free = np.random.default_rng(2).normal(20, 1, 5 * 48 + 1)
    forecast = build_free_response("seasonal_naive").forecast(
        free, history_of(free, step_s=1800.0), boundary_of(5 * 48, 60, step_s=1800.0)
    )
    np.testing.assert_allclose(forecast.median_C, np.tile(free[-48:], 2)[:60])


@pytest.mark.parametrize(("name", "largest_error"), [("arx", 2.5), ("linear_weather", 1.0)])
def test_weather_of_the_forecast_moves_weather_aware_methods_only(name: str, largest_error: float) -> None:
    rng = np.random.default_rng(3)
    t = hours(336)
    outdoor = 5 + 3 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.3 * rng.standard_normal(t.size))
    free = np.empty(t.size)
    free[0] = 10.0
    for k in range(t.size - 1):
        free[k + 1] = 0.9 * free[k] + 0.1 * 0.5 * (outdoor[k] + outdoor[k + 1])
    history = history_of(free, T_out_C=outdoor)
    mild, cold = (boundary_of(336, 24, T_out_C=np.full(25, outdoor[-1] + d)) for d in (5.0, -5.0))
    method = build_free_response(name)
    difference = method.forecast(free, history, mild).median_C - method.forecast(free, history, cold).median_C
    # Between both forecasts lie 10 K outdoors from the second boundary on: a first-order answer of 0.9 per hour.
    step = np.full(24, 10.0)
    truth = np.zeros(24)
    for k in range(24):
        truth[k] = 0.9 * (truth[k - 1] if k else 0.0) + 0.1 * step[k]
    assert np.abs(difference - truth).max() < largest_error
    assert (difference > 0).all()
    blind = build_free_response("ar")
    np.testing.assert_array_equal(
        blind.forecast(free, history, mild).quantiles_C, blind.forecast(free, history, cold).quantiles_C
    )


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


@pytest.mark.parametrize(
    ("name", "hours_known", "words"),
    [("seasonal_naive", 20, "a day"), ("ar", 30, "need 52"), ("ets", 40, "two days"), ("linear_weather", 20, "a day")],
)
def test_too_little_history_is_refused_with_the_amount_needed(name: str, hours_known: int, words: str) -> None:
    free = daily(hours(hours_known))
    with pytest.raises(DataError, match=words):
        build_free_response(name).forecast(free, history_of(free), boundary_of(hours_known, 24))


def test_gaps_are_bridged_by_the_linear_model_and_by_smoothing_but_refused_by_autoregression() -> None:
    free = daily(hours(240))
    free[200:206] = np.nan
    free[-3:] = np.nan
    truth = daily(np.arange(241, 265))
    for name in ("linear_weather", "ets"):
        forecast = build_free_response(name).forecast(free, history_of(free), boundary_of(240, 24))
        assert np.abs(forecast.median_C - truth).max() < 0.4, name
    with pytest.raises(DataError, match="gaps"):
        build_free_response("ar").forecast(free, history_of(free), boundary_of(240, 24))


def test_linear_model_refuses_weather_that_is_not_finite() -> None:
    free = daily(hours(240))
    hole = np.full(25, 5.0)
    hole[7] = np.nan
    with pytest.raises(DataError, match="T_out_C is not finite at step 247"):
        build_free_response("linear_weather").forecast(free, history_of(free), boundary_of(240, 24, T_out_C=hole))


def test_unknown_names_and_options_are_refused_with_what_is_known() -> None:
    with pytest.raises(ConfigError, match=r"chronoss.*chronos.*known: .*persistence"):
        build_free_response("chronoss")
    with pytest.raises(ConfigError, match=r"unknown option 'lag'.*lags"):
        build_free_response("ar", lag=3)
