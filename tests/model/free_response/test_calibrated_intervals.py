"""Intervals that follow what issued forecasts turned out to be."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, history_of, weather_at

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse
from thermoforce_mpc.model.free_response.registry import build_free_response

AHEAD = 12


class Level:
    """Forecasts 20 °C with an interval of ±`half_K` (0.1 to 0.9 quantile)."""

    name = "level"

    def __init__(self, half_K: float) -> None:
        self.half_K = half_K

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        rows = 20.0 + (LEVELS - 0.5)[:, None] / 0.4 * self.half_K + np.zeros(boundary.n_steps)
        return FreeForecast(LEVELS, rows, "level")


def run(method: CalibratedFreeResponse, free: np.ndarray, first: int, last: int) -> list[FreeForecast]:
    """One forecast an hour, each from what is known by then."""
    forecasts, state = [], None
    for k in range(first, last):
        forecast, state = method.follow(free[: k + 1], history_of(free[: k + 1]), boundary_of(k, AHEAD), state)
        forecasts.append(forecast)
    return forecasts


@pytest.mark.slow
@pytest.mark.parametrize("half_K", [0.3, 0.64, 1.2])
def test_width_converges_to_that_of_the_errors_from_both_sides(half_K: float) -> None:
    """Errors of half a kelvin (standard deviation): 80 % lie within 1.28 times that."""
    free = 20.0 + 0.5 * np.random.default_rng(0).standard_normal(400)
    forecasts = run(CalibratedFreeResponse(Level(half_K)), free, 100, 340)
    widths = np.array([f.quantiles_C[-1] - f.quantiles_C[0] for f in forecasts[150:]])
    assert widths.mean() == pytest.approx(2 * 1.28 * 0.5, rel=0.12)
    np.testing.assert_allclose(forecasts[-1].median_C, 20.0)
    np.testing.assert_allclose(
        forecasts[0].quantiles_C[-1] - forecasts[0].quantiles_C[0], 2 * half_K
    )  # untouched at first


@pytest.mark.slow
def test_the_width_adapts_when_errors_grow() -> None:
    rng = np.random.default_rng(1)
    free = 20.0 + np.concatenate([0.2 * rng.standard_normal(400), 0.6 * rng.standard_normal(400)])
    forecasts = run(CalibratedFreeResponse(Level(0.3)), free, 100, 780)
    width = [float(np.mean(f.quantiles_C[-1] - f.quantiles_C[0])) for f in forecasts]
    # Every hour steers the width up or down: means over two days.
    assert np.mean(width[242:290]) == pytest.approx(2.56 * 0.2, rel=0.2)
    assert np.mean(width[-48:]) == pytest.approx(2.56 * 0.6, rel=0.2)


def test_a_start_far_too_narrow_is_made_up_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What came of the first forecasts widens the window's width; steering for them too would add half of it again."""
    monkeypatch.setattr(sys.modules[__name__], "AHEAD", 24)
    ratios = []
    for seed in range(4):
        free = 20.0 + 0.5 * np.random.default_rng(seed).standard_normal(300)
        forecasts = run(CalibratedFreeResponse(Level(0.2)), free, 100, 172)
        ratios.append([(f.quantiles_C[-1] - f.quantiles_C[0])[18:] / (2.56 * 0.5) for f in forecasts[24:]])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_silent_sensors_teach_nothing() -> None:
    free = np.full(300, np.nan)
    free[:90] = 20.0
    forecasts = run(CalibratedFreeResponse(Level(0.3)), free, 100, 150)
    for forecast in forecasts:
        np.testing.assert_allclose(forecast.quantiles_C[-1] - forecast.quantiles_C[0], 0.6)


def test_a_new_run_starts_without_memory() -> None:
    free = 20.0 + np.random.default_rng(2).standard_normal(400)
    method = CalibratedFreeResponse(Level(0.3))
    first = run(method, free, 200, 300)
    for one, again in zip(first, run(method, free, 200, 300), strict=True):
        np.testing.assert_array_equal(one.quantiles_C, again.quantiles_C)


def test_time_going_back_forgets() -> None:
    free = 20.0 + np.random.default_rng(2).standard_normal(400)
    method, state = CalibratedFreeResponse(Level(0.3)), None
    for k in [*range(200, 300), 100]:
        last, state = method.follow(free[: k + 1], history_of(free[: k + 1]), boundary_of(k, AHEAD), state)
    np.testing.assert_allclose(last.quantiles_C[-1] - last.quantiles_C[0], 0.6)


def test_calibration_uses_what_history_says_at_the_time_forecast() -> None:
    """A shift of one step between forecast and truth would show: errors here depend on the hour."""
    k = np.arange(400)
    free = 20.0 + np.where(k % AHEAD == 0, 1.2, 0.05)  # hours 0 and 12 are far off

    class Knowing(Level):
        def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
            hour = np.round(boundary.time_s[1:] / 3600)
            half = np.where(hour % AHEAD == 0, 1.2, 0.05)
            return FreeForecast(LEVELS, 20.0 + (LEVELS - 0.5)[:, None] / 0.4 * half, "knowing")

    last = run(CalibratedFreeResponse(Knowing(0.0)), free, 100, 200)[-1]
    half = np.where(np.arange(200, 200 + AHEAD) % AHEAD == 0, 1.2, 0.05)
    # Where every value is exactly at the edge, the widths are steered up and down by half a day's worth of hours; an
    # offset would be off by a factor of 24.
    served = (last.quantiles_C[-1] - last.quantiles_C[0]) / 2
    np.testing.assert_allclose(np.log(served / half), 0.0, atol=1.2)


@pytest.mark.slow
def test_errors_that_hang_together_for_a_day_are_covered_over_two_weeks() -> None:
    """Steering makes up for what a week of such errors cannot say: near 80 % after two days, whatever the start."""
    keep, shares = np.exp(-1 / 12), []
    for seed, half_K in ((3, 0.6), (4, 2.0), (5, 0.6), (6, 2.0)):
        rng = np.random.default_rng(seed)
        free = np.zeros(460)
        for k in range(459):
            free[k + 1] = keep * free[k] + np.sqrt(1 - keep**2) * rng.standard_normal()
        free += 20.0
        forecasts = run(CalibratedFreeResponse(Level(half_K)), free, 100, 100 + 14 * 24)
        ends = np.arange(148, 100 + 14 * 24)[:, None] + np.arange(1, AHEAD + 1)
        shares.append(share_inside(forecasts[48:], free[ends]))
    assert np.mean(shares) == pytest.approx(0.8, abs=0.02)
    assert min(shares) > 0.75


def share_inside(forecasts: list[FreeForecast], truth_C: np.ndarray, which: np.ndarray | None = None) -> float:
    """Share of `truth_C` (forecasts, AHEAD), of those of `which`, that lie in the 80 % band."""
    low, high = (np.array([f.quantiles_C[row] for f in forecasts]) for row in (0, -1))
    inside = (low <= truth_C) & (truth_C <= high)
    return float(inside[slice(None) if which is None else which].mean())


def test_bands_hold_alike_in_the_night_and_while_the_sun_rises() -> None:
    """By day errors are three times as large: one width for all hours holds all of the night, and half of the day."""
    time_s = 3600.0 * np.arange(500)
    sun = weather_at(time_s)[1]
    day, rising = sun > 5.0, sun > np.roll(sun, 1)
    free = 20.0 + np.where(day, 0.6, 0.2) * np.random.default_rng(4).standard_normal(time_s.size)
    forecasts = run(CalibratedFreeResponse(Level(0.3)), free, 100, 460)[72:]
    ends = np.arange(172, 460)[:, None] + np.arange(1, AHEAD + 1)
    hours = {"night": ~day, "rising sun": day & rising, "falling sun": day & ~rising}
    shares = {name: share_inside(forecasts, free[ends], which[ends]) for name, which in hours.items()}
    assert shares == pytest.approx(dict.fromkeys(hours, 0.8), abs=0.07)


def test_a_kind_of_sun_that_was_not_seen_yet_has_the_width_of_its_lead_times() -> None:
    """After a night alone nothing is known of the sun: its hours are as wide as what was seen, not as it began."""
    free = 20.0 + 0.5 * np.random.default_rng(5).standard_normal(400)
    dark = np.zeros(AHEAD + 1)
    method, state = CalibratedFreeResponse(Level(0.1)), None
    for k in range(100, 160):
        boundary = boundary_of(k, AHEAD, solar_W_m2=dark)
        _, state = method.follow(free[: k + 1], history_of(free[: k + 1]), boundary, state)
    sunny = boundary_of(160, AHEAD, solar_W_m2=np.linspace(10.0, 500.0, AHEAD + 1))
    first, _ = method.follow(free[:161], history_of(free[:161]), sunny, state)
    assert np.mean(first.quantiles_C[-1] - first.quantiles_C[0]) > 4 * 0.2


@pytest.mark.slow
def test_the_weights_hashed_are_those_of_the_method_inside() -> None:
    calibrated = build_free_response("residual")
    assert calibrated.weight_hash() == build_free_response("chronos", backbone="shipped_weather").weight_hash()
    assert not hasattr(CalibratedFreeResponse(Level(1.0)), "weight_hash")
