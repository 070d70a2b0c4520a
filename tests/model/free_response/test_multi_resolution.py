"""Several resolutions of a series: aligned to now, equal on a straight line, without invented values."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.model.free_response.backbones.base import Context
from thermoforce_mpc.model.free_response.multi_resolution import merged, resolutions_of


def line(n: int, step_s: float) -> np.ndarray:
    return 20.0 + 0.1 * np.arange(-n, 1) * step_s / 3600.0


def weather(n: int, step_s: float, first: int) -> np.ndarray:
    hours = np.arange(first, first + n) * step_s / 3600.0
    return np.stack([hours, 10.0 * hours], axis=1)


def straight_on(context: Context) -> np.ndarray:
    """A backbone that continues a straight line exactly, at the step of what it is shown; levels 0.1 K apart."""
    slope = context.free_C[-1] - context.free_C[-2]
    course = context.free_C[-1] + slope * np.arange(1, len(context.ahead_weather) + 1)
    return course + 0.1 * np.arange(-4, 5)[:, None]


@pytest.mark.parametrize("step_s", [420.0, 900.0, 1800.0, 3600.0, 7200.0])
@pytest.mark.parametrize("days", [2, 12])
def test_a_straight_line_goes_on_straight_at_any_step(step_s: float, days: int) -> None:
    n, ahead = round(days * 86400 / step_s), round(48 * 3600 / step_s)
    free = line(n, step_s)
    resolutions = resolutions_of(free, weather(n + 1, step_s, -n), weather(ahead, step_s, 1), step_s, 512)
    found = merged(resolutions, [straight_on(resolution.context) for resolution in resolutions])
    truth = 20.0 + 0.1 * np.arange(1, ahead + 1) * step_s / 3600.0
    np.testing.assert_allclose(found[4], truth, atol=1e-9)
    # Within the first coarse step a resolution starts from the measured value, so its levels open from there.
    assert np.all(np.diff(found, axis=0) > 0)


def test_two_days_at_15_minutes_need_no_unrolling() -> None:
    free = line(12 * 96, 900.0)
    resolutions = resolutions_of(free, weather(free.size, 900.0, -free.size + 1), weather(192, 900.0, 1), 900.0, 512)
    assert [resolution.stride for resolution in resolutions] == [1, 4]
    assert [len(resolution.context.ahead_weather) for resolution in resolutions] == [64, 48]
    assert [resolution.context.free_C.size for resolution in resolutions] == [512, 289]
    for resolution in resolutions:
        assert len(resolution.context.past_weather) == resolution.context.free_C.size
        assert resolution.context.free_C[-1] == free[-1]


def test_weather_of_an_hour_is_the_mean_of_its_quarters() -> None:
    free = line(3 * 96, 900.0)
    hourly = resolutions_of(free, weather(free.size, 900.0, -free.size + 1), weather(192, 900.0, 1), 900.0, 512)[
        1
    ].context
    np.testing.assert_allclose(hourly.ahead_weather[0, 0], np.mean([0.25, 0.5, 0.75, 1.0]))
    np.testing.assert_allclose(hourly.past_weather[-1, 0], np.mean([-0.75, -0.5, -0.25, 0.0]))


def test_gaps_stay_gaps_and_a_silent_now_starts_from_the_last_known_value() -> None:
    free = line(3 * 96, 900.0)
    free[100:140] = np.nan
    free[-3:] = np.nan
    resolutions = resolutions_of(free, weather(free.size, 900.0, -free.size + 1), weather(96, 900.0, 1), 900.0, 512)
    for resolution in resolutions:
        assert np.isnan(resolution.context.free_C).sum() >= 40 // resolution.stride
        assert resolution.now_C == free[-4]


def test_an_hourly_look_at_too_few_values_is_left_out() -> None:
    """Only the quarters past the hour were measured: the resolution at full hours would show nothing."""
    free = line(3 * 96, 900.0)
    free[::4] = np.nan
    resolutions = resolutions_of(free, weather(free.size, 900.0, -free.size + 1), weather(96, 900.0, 1), 900.0, 512)
    assert [resolution.stride for resolution in resolutions] == [1]
    assert len(resolutions[0].context.ahead_weather) == 96


def test_the_mean_counts_only_looks_that_reach() -> None:
    free = line(3 * 96, 900.0)
    resolutions = resolutions_of(free, weather(free.size, 900.0, -free.size + 1), weather(96, 900.0, 1), 900.0, 512)
    found = merged(resolutions, [np.full((9, 64), 1.0), np.full((9, 24), 3.0)])
    np.testing.assert_allclose(found[:, 4:64], 2.0)
    np.testing.assert_allclose(found[:, 64:], 3.0)
