"""The weather model with a forecaster of its residual, on series whose cause is known."""

from __future__ import annotations

import numpy as np
import pytest
from forecasting import boundary_of, history_of, hours

from thermoforce_mpc.data import Boundary, Record
from thermoforce_mpc.model.free_response.backbones.base import Context, clock
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.free_response.linear_weather import (
    DISTURBANCES_H,
    TIME_CONSTANTS_H,
    fits_linear_weather,
    mean_course,
)
from thermoforce_mpc.model.free_response.registry import build_free_response

N, AHEAD = 336, 24


def room_and_weather(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A room of 8 h under random weather and sun, N + AHEAD steps: control-free temperature, outdoors, irradiance."""
    rng = np.random.default_rng(seed)
    t = hours(N + AHEAD)
    outdoor = 4 + 3 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.4 * rng.standard_normal(t.size))
    clouds = rng.uniform(0.2, 1.0, t.size // 24 + 1)[(t // 24).astype(int)]
    solar = 400 * clouds * np.maximum(-np.cos(2 * np.pi * t / 24), 0)
    room = np.empty(t.size)
    room[0] = 6.0
    drive = outdoor + 0.02 * solar + 2.0
    for k in range(t.size - 1):
        room[k + 1] = np.exp(-1 / 8) * room[k] + (1 - np.exp(-1 / 8)) * 0.5 * (drive[k] + drive[k + 1])
    return room, outdoor, solar


def past_and_ahead(outdoor: np.ndarray, solar: np.ndarray, free: np.ndarray) -> tuple[Record, Boundary]:
    history = history_of(free[: N + 1], T_out_C=outdoor[: N + 1], solar_W_m2=solar[: N + 1])
    return history, boundary_of(N, AHEAD, T_out_C=outdoor[N:], solar_W_m2=solar[N:])


def test_the_fit_finds_the_physics_and_obeys_its_signs() -> None:
    free, outdoor, solar = room_and_weather(0)
    history, boundary = past_and_ahead(outdoor, solar, free)
    (fit,) = fits_linear_weather(free[: N + 1], history, boundary)
    q = TIME_CONSTANTS_H.size
    assert np.sqrt(np.mean((fit.past_C - free[: N + 1]) ** 2)) < 0.15
    assert np.abs(fit.ahead_C - free[N + 1 :]).max() < 0.4
    assert (fit.weights[: 2 * q] >= 0).all()
    assert fit.weights[:q].sum() == pytest.approx(1.0, abs=0.15)  # long-run gain of the outdoors
    assert fit.weights[q : 2 * q].sum() == pytest.approx(2.0, rel=0.3)  # 0.02 K per W/m², in units of 100 W/m²


def test_a_room_that_cools_when_the_sun_shines_is_not_believed() -> None:
    free, outdoor, solar = room_and_weather(1)
    history, boundary = past_and_ahead(outdoor, solar, free)
    (fit,) = fits_linear_weather(free[: N + 1] - 0.01 * solar[: N + 1], history, boundary)
    assert (fit.weights[: 2 * TIME_CONSTANTS_H.size] >= 0).all()


@pytest.mark.parametrize("backbone", ["shipped", "shipped_weather"])
def test_residual_adds_the_backbones_forecast_of_what_the_weather_leaves_over(backbone: str) -> None:
    """The mean of two fits, and what follows from the series less that; one trained for it reads that mean, too."""
    free, outdoor, solar = room_and_weather(2)
    history, boundary = past_and_ahead(outdoor, solar, free)
    past = free[: N + 1]
    course = mean_course(fits_linear_weather(past, history, boundary, DISTURBANCES_H))
    residual = ChronosFreeResponse(backbone, after_linear_weather=True)
    reads = backbone == "shipped_weather"
    weather = [
        np.stack([of.T_out_C, of.solar_W_m2, clock(of.time_s)] + [part] * reads, axis=1)
        for of, part in ((history, course[: N + 1]), (boundary, course[N:]))
    ]
    (answer,) = residual.model.quantiles_C([Context(past - course[: N + 1], weather[0], weather[1][1:])])
    found = residual.forecast(past, history, boundary)
    np.testing.assert_allclose(found.quantiles_C, np.sort(answer, axis=0) + course[N + 1 :], atol=1e-6)
    assert "linear weather model, corrected by" in found.note
    assert residual.name == "residual"


def test_a_backbone_trained_to_correct_does_so_by_whatever_name() -> None:
    free, outdoor, solar = room_and_weather(5)
    history, boundary = past_and_ahead(outdoor, solar, free)
    methods = (
        build_free_response("chronos", backbone="shipped_weather"),
        build_free_response("residual", calibrate=False),
    )
    ours, default = (method.forecast(free[: N + 1], history, boundary) for method in methods)
    np.testing.assert_array_equal(ours.quantiles_C, default.quantiles_C)


def test_residual_without_a_day_of_history_is_persistence_and_says_so() -> None:
    free, outdoor, solar = room_and_weather(6)
    history = history_of(free[:13], T_out_C=outdoor[:13], solar_W_m2=solar[:13])
    boundary = boundary_of(12, AHEAD, T_out_C=outdoor[12 : 13 + AHEAD], solar_W_m2=solar[12 : 13 + AHEAD])
    found = build_free_response("residual", calibrate=False).forecast(free[:13], history, boundary)
    assert "persistence: only 12 h of history measured" in found.note
    np.testing.assert_allclose(found.median_C, free[12], atol=0.2)


def test_a_slow_disturbance_bends_the_generalised_fit_less() -> None:
    """Three days two kelvins above the model's course, as with guests: the gains must stay those of the weather."""
    free, outdoor, solar = room_and_weather(13)
    free = free + np.where((np.arange(free.size) > 150) & (np.arange(free.size) < 222), 2.0, 0.0)
    history, boundary = past_and_ahead(outdoor, solar, free)
    truth = free[N + 1 :]
    plain, slow = fits_linear_weather(free[: N + 1], history, boundary, (None, 24.0))
    gap = [np.std(fit.ahead_C - truth) for fit in (plain, slow)]  # a constant offset is the backbone's part
    assert gap[1] < 0.7 * gap[0]
    holed = free[: N + 1].copy()
    holed[40:60] = np.nan
    holed[::9] = np.nan
    (again,) = fits_linear_weather(holed, history, boundary, (24.0,))
    assert np.std(again.ahead_C - truth) < 1.5 * gap[1]


def test_residual_of_the_shipped_backbone_keeps_to_the_weather_model_and_its_weights() -> None:
    """On a room that the weather explains, the frozen model must not spoil it; it alone is far worse."""
    free, outdoor, solar = room_and_weather(3)
    history, boundary = past_and_ahead(outdoor, solar, free)
    residual = build_free_response("residual", calibrate=False)
    before = residual.weight_hash()
    error = np.abs(residual.forecast(free[: N + 1], history, boundary).median_C - free[N + 1 :]).mean()
    alone = np.abs(build_free_response("chronos").forecast(free[: N + 1], history, boundary).median_C - free[N + 1 :])
    assert error < 0.2
    assert error < 0.5 * alone.mean()
    assert residual.weight_hash() == before
