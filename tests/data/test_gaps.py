"""Lags of series, and what stands in the gaps of a history, whatever their place and length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.data import HOUR_S, Boundary, Record
from thermoforce_mpc.data.series import bridged, first_order, short_gaps_bridged
from thermoforce_mpc.errors import DataError

NAN = np.nan
DAYS = 4
N = 24 * DAYS


def daily(hours: np.ndarray) -> np.ndarray:
    return 5.0 + 4.0 * np.cos(2 * np.pi * (hours - 15) / 24)


def history(step_h: float = 1.0, **holes: tuple[int, int]) -> Record:
    """Four days with a wave outdoors; `holes` are the places (start, stop) where a signal is unknown."""
    hours = np.arange(0.0, N + step_h / 2, step_h)
    n = hours.size - 1
    whole = Record(HOUR_S * hours, 20 + 0 * hours, daily(hours), 100 + 0 * hours, np.full(n, 0.4), *np.ones((2, n)))
    for name, (start, stop) in holes.items():
        values = np.array(getattr(whole, name))
        values[start:stop] = NAN
        whole = replace(whole, **{name: values})
    return whole


def forecast() -> Boundary:
    hours = np.arange(float(N), N + 25)
    zero = np.zeros(25)
    return Boundary(HOUR_S * hours, 1.0 + daily(hours), zero, zero, zero, zero, zero, zero)


def test_a_whole_history_stays_the_same_object():
    whole = history()
    assert bridged(whole) == (whole, "")
    assert bridged(whole)[0] is whole


@pytest.mark.parametrize("step_h", [0.25, 1.0])
@pytest.mark.parametrize("hours", [1, 5])
def test_a_short_gap_is_a_straight_line(step_h, hours):
    first = round(30 / step_h)
    holed = history(step_h, T_out_C=(first, first + round((hours - 1) / step_h) + 1))
    found, note = bridged(holed)
    at = np.isnan(holed.T_out_C)
    known = np.flatnonzero(~at)
    np.testing.assert_allclose(found.T_out_C, np.interp(holed.time_s, holed.time_s[known], holed.T_out_C[known]))
    np.testing.assert_array_equal(found.T_out_C[~at], holed.T_out_C[~at])
    assert note == f"bridged T_out_C: {at.sum()} {'value' if at.sum() == 1 else 'values'} by linear interpolation"


@pytest.mark.parametrize("hole", [(30, 40), (30, 80), (0, 12), (60, 97)], ids=["within", "days", "first", "till now"])
def test_a_long_gap_is_the_same_hour_of_another_day(hole):
    holed = history(T_out_C=hole)
    found, note = bridged(holed)
    np.testing.assert_allclose(found.T_out_C, daily(np.arange(N + 1.0)), atol=1e-9)
    assert f"{hole[1] - hole[0]} of them from the same hour of the nearest day" in note


def test_the_nearest_day_counts_and_the_past_before_the_future():
    rising = replace(history(), T_out_C=np.arange(N + 1.0))
    values = np.array(rising.T_out_C)
    values[30:50] = NAN
    found, _ = bridged(replace(rising, T_out_C=values))
    np.testing.assert_array_equal(found.T_out_C[30:50], [*np.arange(6.0, 25.0), 25.0])


def test_a_gap_till_now_leads_to_the_forecast():
    found, _ = bridged(history(T_out_C=(N - 1, N + 1)), forecast())
    before, now = daily(np.array([N - 2.0, N]))
    np.testing.assert_allclose(found.T_out_C[-2:], [(before + 1.0 + now) / 2, 1.0 + now])
    held, _ = bridged(history(T_out_C=(N - 1, N + 1)))
    np.testing.assert_allclose(held.T_out_C[-2:], before)


def test_weather_that_was_never_measured_is_that_of_the_forecast_or_refused():
    silent = history(T_out_C=(0, N + 1))
    found, _ = bridged(silent, forecast())
    np.testing.assert_allclose(found.T_out_C, 1.0 + daily(np.arange(N + 1.0)), atol=1e-9)
    with pytest.raises(DataError, match="T_out_C was never measured and no forecast"):
        bridged(silent)


def test_unknown_levels_are_the_mean_around_them_or_of_all_or_off():
    levels = np.where(np.arange(N) < 48, 1.0, 0.0)
    part = replace(history(), u=levels)
    values = np.array(levels)
    values[40:44] = NAN
    found, note = bridged(replace(part, u=values))
    # Of the twelve hours on either side of step 40, those before it and four after it were on, five off.
    np.testing.assert_allclose(found.u[0, 40], (12 + 4) / (12 + 9))
    assert (np.diff(found.u[0, 40:44]) < 0).all()
    assert note == "bridged u: 4 values (4.2 %) filled with the mean level around"
    values[:] = NAN
    values[0] = 0.7
    np.testing.assert_allclose(bridged(replace(part, u=values))[0].u, 0.7)
    np.testing.assert_array_equal(bridged(replace(part, u=np.full(N, NAN)))[0].u, 0.0)


def test_a_short_gap_in_the_level_is_bridged_from_end_to_end():
    levels = np.where(np.arange(N) < 48, 1.0, 0.0)
    values = np.array(levels)
    values[[0, 10, 11, 48, 95]] = NAN
    found, note = bridged(replace(history(), u=values))
    np.testing.assert_allclose(found.u[0, [0, 10, 11, 48, 95]], [1.0, 1.0, 1.0, 0.5, 0.0])
    assert note == "bridged u: 5 values (5.2 %) between the levels around"


def test_other_gaps_stay():
    holed = history(T_zone_C=(3, 5), heat_W=(7, 9), power_W=(10, 12), T_out_C=(20, 21))
    found, _ = bridged(holed)
    for name in ("T_zone_C", "heat_W", "power_W", "T_return_C"):
        np.testing.assert_array_equal(getattr(found, name), getattr(holed, name))


def test_lines_between_values_that_are_near_and_nowhere_else():
    values = np.array([NAN, 1.0, NAN, 3.0, NAN, NAN, 6.0, NAN, NAN, NAN, 10.0, NAN])
    line = [NAN, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, NAN, NAN, NAN, 10.0, NAN]
    np.testing.assert_allclose(short_gaps_bridged(values, 3), line)
    np.testing.assert_allclose(short_gaps_bridged(values, 1), values)
    np.testing.assert_allclose(short_gaps_bridged(values, 4), [NAN, *range(1, 11), NAN])
    np.testing.assert_allclose(short_gaps_bridged(np.full(3, NAN), 4), np.full(3, NAN))


@pytest.mark.parametrize("n", [0, 1, 31, 32, 33, 1000, 1100])
def test_lags_are_what_step_by_step_they_are(n: int):
    rng = np.random.default_rng(n)
    poles, drive, start = np.array([0.0, 0.7, 0.9999, 1.0]), rng.normal(size=(3, n, 4)), rng.normal(size=(3, 4))
    expected, state = np.empty_like(drive), start
    for t in range(n):
        state = expected[:, t] = poles * state + drive[:, t]
    np.testing.assert_allclose(first_order(poles, drive, start), expected, rtol=0.0, atol=1e-11)
    one_for_all = first_order(poles, drive, start[0])
    np.testing.assert_allclose(one_for_all[0], expected[0], rtol=0.0, atol=1e-11)
