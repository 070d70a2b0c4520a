"""The mean of two forecasts, whose shares follow how both erred in a run."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, history_of

from thermoforce_mpc.data import HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse
from thermoforce_mpc.model.free_response.following import MeanFreeResponse, MeanState

AHEAD, FIRST = 12, 48


class Wrong:
    """What follows in `series`, wrong by `errors_K`; a quarter of a kelvin between levels."""

    def __init__(self, name: str, series: Array, errors_K: Array) -> None:
        self.name, self.told_C = name, series + errors_K

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        at = np.round(boundary.time_s[1:] / HOUR_S).astype(int)
        return FreeForecast(LEVELS, self.told_C[at] + (LEVELS[:, None] - 0.5), self.name)


def course(n: int = 400) -> Array:
    return 20.0 + np.sin(np.arange(n) / 9.0)


def run(
    method, seen_C: Array, last: int, state: object = None, first: int = FIRST
) -> tuple[list[FreeForecast], object]:
    """One forecast an hour, each from what is known by then."""
    forecasts = []
    for k in range(first, last):
        forecast, state = method.follow(seen_C[: k + 1], history_of(seen_C[: k + 1]), boundary_of(k, AHEAD), state)
        forecasts.append(forecast)
    return forecasts, state


def shares_of(forecast: FreeForecast) -> tuple[float, float]:
    """Least and largest of the first, over lead times."""
    least, largest = re.findall(r"(\d+) %", forecast.note)
    return int(least) / 100, int(largest) / 100


def error_K(forecasts: list[FreeForecast], series: Array, first: int = FIRST) -> Array:
    """Median less truth, (forecasts, AHEAD), K."""
    return np.array([f.median_C - series[first + i + 1 :][:AHEAD] for i, f in enumerate(forecasts)])


@pytest.mark.parametrize("first_errs", [0.1, 0.8])
def test_shares_begin_even_and_go_to_what_errs_less(first_errs: float) -> None:
    series, rng = course(), np.random.default_rng(3)
    first = Wrong("first", series, first_errs * rng.standard_normal(series.size))
    second = Wrong("second", series, (0.9 - first_errs) * rng.standard_normal(series.size))
    forecasts, _ = run(MeanFreeResponse(first, second), series, 240)
    np.testing.assert_allclose(
        forecasts[0].quantiles_C,
        0.5 * (first.told_C + second.told_C)[FIRST + 1 :][:AHEAD] + LEVELS[:, None] - 0.5,
    )
    assert forecasts[0].note == "mean of first (50 % to 50 %) and second"
    found = np.abs(error_K(forecasts, series)[-48:]).mean()
    assert found < 0.11, "as the better one, 0.08, where the mean by halves errs by 0.32"


def test_each_lead_time_has_shares_of_its_own() -> None:
    """One is right up to 4 h ahead, the other beyond."""
    series = course()

    class Until(Wrong):
        def __init__(self, name: str, right: slice) -> None:
            super().__init__(name, series, np.zeros(series.size))
            self._off_K = np.ones(AHEAD)
            self._off_K[right] = 0.0

        def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
            right = super().forecast(free_C, history, boundary)
            return replace(right, quantiles_C=right.quantiles_C + self._off_K)

    mean = MeanFreeResponse(Until("soon", slice(0, 4)), Until("late", slice(4, None)))
    forecasts, _ = run(mean, series, FIRST + 10 * 24)
    np.testing.assert_allclose(error_K(forecasts[:1], series), 0.5, atol=1e-9)
    assert np.abs(error_K(forecasts[-1:], series, FIRST + 10 * 24 - 1)).max() < 0.13


def test_errors_that_cancel_keep_even_shares() -> None:
    """Neither is better, and their mean is right."""
    series, errors = course(), 0.5 * np.random.default_rng(3).standard_normal(400)
    forecasts, _ = run(MeanFreeResponse(Wrong("a", series, errors), Wrong("b", series, -errors)), series, 200)
    np.testing.assert_allclose(error_K(forecasts, series), 0.0, atol=1e-9)


def test_two_that_say_the_same_and_silent_sensors_teach_nothing() -> None:
    series = course()
    alike = MeanFreeResponse(Wrong("a", series, np.full(400, 0.3)), Wrong("b", series, np.full(400, 0.3)))
    assert "(50 % to 50 %)" in run(alike, series, 150)[0][-1].note
    silent = series.copy()
    silent[FIRST:] = np.nan
    apart = MeanFreeResponse(Wrong("a", series, np.zeros(400)), Wrong("b", series, np.ones(400)))
    assert "(50 % to 50 %)" in run(apart, silent, 100)[0][-1].note
    assert "(50 % to 50 %)" not in run(apart, series, 100)[0][-1].note


def test_what_was_better_long_ago_counts_less_than_what_is_better_since() -> None:
    series = course(1200)
    changes = np.arange(1200) < 300
    first, second = (Wrong(str(when), series, np.where(changes == when, 0.8, 0.1)) for when in (True, False))
    mean = MeanFreeResponse(first, second)
    before, state = run(mean, series, 290)
    after, _ = run(mean, series, 1100, state, 290)
    shares = [shares_of(forecasts[-1]) for forecasts in (before, after)]
    assert max(shares[0]) < 0.15
    assert min(shares[1]) > 0.8


def test_a_run_that_is_gone_on_with_and_another_one() -> None:
    series = course()
    mean = MeanFreeResponse(Wrong("a", series, np.zeros(400)), Wrong("b", series, np.full(400, 0.5)))
    whole, _ = run(mean, series, 120)
    _, state = run(mean, series, 90)
    rest, state = run(mean, series, 120, state, 90)
    np.testing.assert_array_equal(rest[-1].quantiles_C, whole[-1].quantiles_C)
    assert isinstance(state, MeanState)
    assert state.time_s.size <= AHEAD
    earlier, _ = mean.follow(series[:61], history_of(series[:61]), boundary_of(60, AHEAD), state)
    longer, _ = mean.follow(series[:121], history_of(series[:121]), boundary_of(120, AHEAD + 1), state)
    assert "(50 % to 50 %)" in earlier.note, "a step back in time is another run"
    assert "(50 % to 50 %)" in longer.note, "so is another horizon"


def test_what_another_method_erred_in_its_place_does_not_count() -> None:
    """Persistence stands in for a forecaster with less than a day of history."""
    series = course()
    mean = MeanFreeResponse(Wrong("stands in", series, np.ones(400)), right := Wrong("b", series, np.zeros(400)))
    forecasts, state = run(mean, series, 120)
    assert "(50 % to 50 %)" not in forecasts[-1].note
    itself = MeanFreeResponse(Wrong("a", series, np.ones(400)), right)
    assert "(50 % to 50 %)" in run(itself, series, 121, state, 120)[0][-1].note


def test_a_horizon_of_less_than_an_hour() -> None:
    free = np.full(200, 20.0)
    mean, state = MeanFreeResponse(Wrong("a", free, np.zeros(200)), Wrong("b", free, np.ones(200))), None
    for k in range(1, 100):
        history, boundary = history_of(free[: k + 1]), boundary_of(k, 2)
        history = replace(history, time_s=history.time_s * 0.25)
        boundary = replace(boundary, time_s=boundary.time_s * 0.25)
        forecast, state = mean.follow(free[: k + 1], history, boundary, state)
    assert min(shares_of(forecast)) > 0.6


def test_steps_of_a_quarter_of_an_hour_are_compared_once_an_hour() -> None:
    """All four between count as one: shares grow with days, not with steps."""

    class Constant:
        def __init__(self, T_C: float) -> None:
            self.name, self._T_C = "constant", T_C

        def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
            return FreeForecast(LEVELS, np.full((LEVELS.size, boundary.n_steps), self._T_C), self.name)

    mean, states = MeanFreeResponse(Constant(20.0), Constant(21.0)), []
    for step_h in (0.25, 1.0):
        state: object = None
        for k in range(round(72 / step_h)):
            free = np.full(k + 2, 20.0)
            history, boundary = history_of(free), boundary_of(k + 1, round(AHEAD / step_h))
            history = replace(history, time_s=history.time_s * step_h)
            boundary = replace(boundary, time_s=boundary.time_s * step_h)
            _, state = mean.follow(free, history, boundary, state)
        states.append(state)
    quarters, hours = states
    np.testing.assert_allclose(quarters.known, hours.known, rtol=0.02)
    assert quarters.medians_C.shape[1:] == hours.medians_C.shape[1:]


def test_calibrated_intervals_are_of_the_mean_that_learns() -> None:
    series = course()
    mean = MeanFreeResponse(Wrong("a", series, np.zeros(400)), Wrong("b", series, np.ones(400)))
    forecasts, state = run(CalibratedFreeResponse(mean), series, 200)
    assert np.abs(error_K(forecasts, series)[-1]).max() < 0.2
    assert isinstance(state.inner, MeanState)
