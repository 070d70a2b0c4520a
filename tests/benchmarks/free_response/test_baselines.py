"""The benches' baselines: each on a series whose future is known."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, daily, first_order_room, history_of, hours

from benchmarks.free_response.baselines.autoregressive import Autoregressive
from benchmarks.free_response.baselines.exponential_smoothing import ExponentialSmoothing
from benchmarks.free_response.baselines.seasonal_naive import SeasonalNaive
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.protocols import FreeResponse

BASELINES: dict[str, FreeResponse] = {
    method.name: method
    for method in (SeasonalNaive(), Autoregressive(26), Autoregressive(26, weather=True), ExponentialSmoothing())
}
each = pytest.mark.parametrize("name", ["seasonal_naive", "ar26", "arx26", "ets"])


@each
def test_quantiles_have_the_shape_and_order_of_the_protocol(name: str) -> None:
    free = daily(hours(240)) + 0.1 * np.random.default_rng(0).standard_normal(241)
    forecast = BASELINES[name].forecast(free, history_of(free), boundary_of(240, 30))
    assert forecast.quantiles_C.shape == (9, 30)
    np.testing.assert_allclose(forecast.levels, LEVELS)
    assert np.isfinite(forecast.quantiles_C).all()
    assert (np.diff(forecast.quantiles_C, axis=0) >= 0).all()
    assert forecast.note


@each
def test_a_daily_course_is_learned(name: str) -> None:
    free = daily(hours(240))
    forecast = BASELINES[name].forecast(free, history_of(free), boundary_of(240, 24))
    assert np.abs(forecast.median_C - daily(np.arange(241, 265))).max() < 0.15


@each
def test_nothing_but_time_and_weather_of_the_history_is_used(name: str) -> None:
    free = daily(hours(240)) + 0.1 * np.random.default_rng(4).standard_normal(241)
    other = history_of(free + 7.0, u=np.linspace(0, 1, 240), power_W=np.full(240, 3e3), heat_W=np.full(240, 9e3))
    found = [BASELINES[name].forecast(free, past, boundary_of(240, 24)) for past in (history_of(free), other)]
    np.testing.assert_array_equal(found[0].quantiles_C, found[1].quantiles_C)


@each
def test_a_silent_sensor_or_a_wrong_shape_is_refused(name: str) -> None:
    free = np.full(241, np.nan)
    with pytest.raises(DataError, match="no finite value"):
        BASELINES[name].forecast(free, history_of(free), boundary_of(240, 24))
    with pytest.raises(DataError, match="shape"):
        BASELINES[name].forecast(np.zeros(240), history_of(free), boundary_of(240, 24))


@pytest.mark.parametrize(
    ("name", "hours_known", "words"),
    [
        ("seasonal_naive", 20, "a day"),
        ("ar26", 30, "5 usable steps of history, need 52"),
        ("ar26", 20, "only 21 values"),
        ("arx26", 60, "need 56"),
        ("ets", 40, "two days of history without a gap, got 41 of 48"),
    ],
)
def test_too_little_history_is_refused_with_the_amount_needed(name: str, hours_known: int, words: str) -> None:
    free = daily(hours(hours_known))
    with pytest.raises(DataError, match=words):
        BASELINES[name].forecast(free, history_of(free), boundary_of(hours_known, 24))


def test_seasonal_naive_repeats_yesterday_at_half_hour_steps() -> None:
    free = np.random.default_rng(2).normal(20, 1, 5 * 48 + 1)
    forecast = SeasonalNaive().forecast(free, history_of(free, step_s=1800.0), boundary_of(5 * 48, 60, step_s=1800.0))
    np.testing.assert_allclose(forecast.median_C, np.tile(free[-48:], 2)[:60])


def test_weather_of_the_forecast_moves_the_autoregression_that_sees_it_and_no_other() -> None:
    free, outdoor = first_order_room()
    history = history_of(free, T_out_C=outdoor)
    mild, cold = (boundary_of(336, 24, T_out_C=np.full(25, outdoor[-1] + d)) for d in (5.0, -5.0))
    seeing = Autoregressive(26, weather=True)
    difference = seeing.forecast(free, history, mild).median_C - seeing.forecast(free, history, cold).median_C
    np.testing.assert_allclose(difference, 10.0 * (1.0 - 0.9 ** np.arange(1, 25)), atol=2.5)
    assert (difference > 0).all()
    for blind in (Autoregressive(26), ExponentialSmoothing(), SeasonalNaive()):
        np.testing.assert_array_equal(
            blind.forecast(free, history, mild).quantiles_C, blind.forecast(free, history, cold).quantiles_C
        )


def test_gaps_are_bridged_by_smoothing_and_refused_in_the_lags() -> None:
    free = daily(hours(240))
    free[200:206] = np.nan
    free[-3:] = np.nan
    forecast = ExponentialSmoothing().forecast(free, history_of(free), boundary_of(240, 24))
    assert np.abs(forecast.median_C - daily(np.arange(241, 265))).max() < 0.4
    free[::40] = np.nan
    with pytest.raises(DataError, match="without a gap, got 39 of 48"):
        ExponentialSmoothing().forecast(free, history_of(free), boundary_of(240, 24))
    with pytest.raises(DataError, match="gaps"):
        Autoregressive(26).forecast(free, history_of(free), boundary_of(240, 24))


def test_without_the_extra_its_command_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install -e '\.\[bench\]'"):
        ExponentialSmoothing()
