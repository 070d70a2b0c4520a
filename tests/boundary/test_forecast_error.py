"""Weather forecasts with BOPTEST's errors are those of its service."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import DAY_S, HOUR_S

# Truth of `bestest_air` at the hours of 1 January, °C and W/m², and what its service forecasts at 0:00 for temperature
# errors `medium`, solar errors `low` and seed 1 (references of BOPTEST's own tests, rounded).
T_OUT_C = [0.0] * 7 + [
    3.3,
    2.2,
    3.3,
    7.2,
    7.8,
    8.9,
    9.4,
    10.6,
    10.0,
    9.4,
    6.7,
    5.6,
    2.8,
    2.2,
    1.7,
    0.6,
    0.0,
    -4.4,
    -5.6,
]
SOLAR_W_M2 = (
    [0.0] * 7 + [1.623, 43.202, 102.001, 229.658, 426.587, 474.606, 455.685, 369.149, 239.081, 90.938] + [0.0] * 9
)
T_SEEN_C = {0: -2.0992, 7: 3.2363, 12: 9.4171, 16: 10.1010, 24: -5.2977}
SOLAR_SEEN_W_M2 = {6: 0.0, 7: 3.2464, 8: 86.4045, 9: 179.6193, 11: 400.7335, 13: 466.3501, 16: 140.1607, 17: 0.0}


def seen(seed, first_s=0.0, hours=24, interval_s=HOUR_S, temperature="medium", solar="low"):
    time_s = first_s + np.arange(round(hours * HOUR_S / interval_s) + 1) * interval_s
    edges_s = first_s // DAY_S * DAY_S + np.arange(len(T_OUT_C)) * HOUR_S
    return ForecastError(temperature, solar, seed).apply(
        time_s, lambda at_s: np.interp(at_s, edges_s, T_OUT_C), lambda at_s: np.interp(at_s, edges_s, SOLAR_W_M2)
    )


def test_errors_of_a_seed_are_those_of_the_service():
    T_seen_C, solar_seen_W_m2 = seen(seed=1)
    assert {hour: T_seen_C[hour] for hour in T_SEEN_C} == pytest.approx(T_SEEN_C, abs=0.06)
    assert {hour: solar_seen_W_m2[hour] for hour in SOLAR_SEEN_W_M2} == pytest.approx(SOLAR_SEEN_W_M2, abs=0.01)


def test_each_hour_has_errors_of_its_own_by_seed_and_time():
    def errors_K(seed, first_s):
        time_s = first_s + np.arange(25) * HOUR_S
        return ForecastError("high", None, seed).apply(time_s, np.zeros_like, np.zeros_like)[0].tolist()

    assert errors_K(5, DAY_S) == errors_K(5, DAY_S) == errors_K(5 + 3600, DAY_S - HOUR_S)
    assert errors_K(5, DAY_S) != errors_K(5, DAY_S + HOUR_S)


def test_within_an_hour_forecasts_are_lines_between_its_values():
    hourly, by_quarters = seen(1), seen(1, interval_s=900.0)
    for whole, parts in zip(hourly, by_quarters, strict=True):
        np.testing.assert_allclose(np.interp(np.arange(97) / 4.0, np.arange(25), whole), parts, atol=1e-9)


def test_either_may_be_without_errors():
    T_seen_C, solar_seen_W_m2 = seen(1, temperature=None, solar=None)
    assert T_seen_C.tolist() == T_OUT_C[:25]
    assert solar_seen_W_m2.tolist() == SOLAR_W_M2[:25]
