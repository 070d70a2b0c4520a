"""The grey-box free response on buildings that *are* the model: hidden modes found, true quantiles, cheap gaps."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, history_of

from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.model.free_response.rc import INPUTS, RcFreeResponse, RcParameters
from thermoforce_mpc.model.free_response.registry import build_free_response

PAST, AHEAD = 240, 24
WEIGHTS = np.array([[0.06, 1e-3, 0.7, 0, 0, 0, 0, 2e-4], [0.01, 5e-5, 0.08, 0, 0, 0.01, 0, 0]])


def two_modes(process_sd_K: float = 1e-6, sensor_sd_K: float = 1e-4) -> RcParameters:
    return RcParameters(
        poles=np.array([0.85, 0.98]),
        weights=WEIGHTS,
        step_s=3600.0,
        process_K2=process_sd_K**2 * np.eye(2),
        start_K2=100.0 * np.eye(2),
        sensor_sd_K=sensor_sd_K,
    )


def weather(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    n = PAST + AHEAD + 1
    t = np.arange(n)
    outdoor = 4 + 5 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.4 * rng.standard_normal(n))
    return outdoor, np.maximum(-np.cos(2 * np.pi * t / 24), 0) * rng.uniform(50, 500, n)


def simulated(params: RcParameters, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zone temperature without sensor noise, outdoor temperature, irradiance, each over past and future."""
    outdoor, solar = weather(rng)
    drive = params.drive(np.arange(outdoor.size) * 3600.0, outdoor, solar)
    z = np.empty((outdoor.size, 2))
    z[0] = 11.0, 3.0
    for t in range(outdoor.size - 1):
        z[t + 1] = params.poles * z[t] + drive[t] + np.sqrt(np.diag(params.process_K2)) * rng.standard_normal(2)
    return z.sum(axis=1), outdoor, solar


def test_hidden_modes_are_found_and_the_future_is_exact() -> None:
    params = two_modes()
    T, outdoor, solar = simulated(params, np.random.default_rng(0))
    history = history_of(T[: PAST + 1], T_out_C=outdoor[: PAST + 1], solar_W_m2=solar[: PAST + 1])
    boundary = boundary_of(PAST, AHEAD, T_out_C=outdoor[PAST:], solar_W_m2=solar[PAST:])
    forecast = RcFreeResponse(params).forecast(T[: PAST + 1], history, boundary)
    np.testing.assert_allclose(forecast.median_C, T[PAST + 1 :], atol=1e-3)
    assert np.ptp(T[PAST:]) > 0.5, "a flat truth would prove nothing"


def test_gaps_and_a_silent_end_are_bridged_by_the_weather() -> None:
    params = two_modes()
    T, outdoor, solar = simulated(params, np.random.default_rng(1))
    free = T[: PAST + 1].copy()
    free[[0, *range(50, 60), *range(PAST - 5, PAST + 1)]] = np.nan
    history = history_of(free, T_out_C=outdoor[: PAST + 1], solar_W_m2=solar[: PAST + 1])
    boundary = boundary_of(PAST, AHEAD, T_out_C=outdoor[PAST:], solar_W_m2=solar[PAST:])
    np.testing.assert_allclose(
        RcFreeResponse(params).forecast(free, history, boundary).median_C, T[PAST + 1 :], atol=5e-3
    )


@pytest.mark.slow
def test_quantiles_cover_what_they_say() -> None:
    params = two_modes(process_sd_K=0.1, sensor_sd_K=0.05)
    below = np.zeros((LEVELS.size, AHEAD))
    runs = 300
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        T, outdoor, solar = simulated(params, rng)
        free = (T + 0.05 * rng.standard_normal(T.size))[PAST - 71 : PAST + 1]
        past = slice(PAST - 71, PAST + 1)
        history = history_of(free, T_out_C=outdoor[past], solar_W_m2=solar[past])
        start = (PAST - 71) * 3600.0
        history = replace(history, time_s=history.time_s + start)
        boundary = boundary_of(PAST, AHEAD, T_out_C=outdoor[PAST:], solar_W_m2=solar[PAST:])
        below += T[PAST + 1 :] < RcFreeResponse(params).forecast(free, history, boundary).quantiles_C
    # Three standard errors of a share from 300 runs are 0.087 in the middle.
    np.testing.assert_allclose(below / runs, np.broadcast_to(LEVELS[:, None], below.shape), atol=0.09)


def test_another_step_gives_the_same_course_under_constant_weather() -> None:
    params = replace(two_modes(), weights=WEIGHTS * np.array([1, 1, 1, 0, 0, 0, 0, 1]))
    coarse, fine = np.array([9.0, 5.0]), np.array([9.0, 5.0])
    quarter = params.resampled(900.0)
    constant = {"T_out_C": np.full(2, 3.0), "solar_W_m2": np.full(2, 120.0)}
    for t in range(10):
        coarse = params.poles * coarse + params.drive(np.array([t, t + 1.0]) * 3600, **constant)[0]
        for _ in range(4):
            fine = quarter.poles * fine + quarter.drive(np.array([t, t + 0.25]) * 3600, **constant)[0]
    np.testing.assert_allclose(fine, coarse, rtol=1e-12)
    np.testing.assert_allclose(quarter.poles**4, params.poles)
    assert params.resampled(3600.0) is params


def test_quantiles_of_one_hour_do_not_depend_on_the_step_it_is_forecast_in() -> None:
    params = two_modes(process_sd_K=0.1)
    params = replace(params, weights=np.zeros((2, len(INPUTS))))
    free = np.full(73, 0.0)
    hourly = RcFreeResponse(params).forecast(free, history_of(free), boundary_of(72, 12)).quantiles_C
    quarterly = RcFreeResponse(params).forecast(free, history_of(free), boundary_of(288, 48, step_s=900.0)).quantiles_C
    np.testing.assert_allclose(quarterly[:, 3::4], hourly, atol=1e-9)


def test_a_single_instant_is_enough() -> None:
    free = np.array([17.0])
    forecast = RcFreeResponse(two_modes()).forecast(free, history_of(free), boundary_of(0, 6))
    assert forecast.quantiles_C.shape == (9, 6)
    assert (forecast.quantiles_C[-1] - forecast.quantiles_C[0])[0] < 5
    assert abs(forecast.median_C[0] - 17.0) < 3


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("poles", np.array([0.5, 1.0]), "no time constant"),
        ("weights", np.zeros((2, 3)), "weights"),
        ("process_K2", np.array([[1.0, 2.0], [2.0, 1.0]]), "no covariance"),
        ("start_K2", np.ones(2), "start_K2"),
        ("sensor_sd_K", 0.0, "positive"),
        ("poles", np.array([0.5, np.nan]), "poles"),
    ],
)
def test_impossible_parameters_are_refused(name: str, value: object, words: str) -> None:
    with pytest.raises(DataError, match=words):
        replace(two_modes(), **{name: value})  # type: ignore[arg-type]


def test_what_does_not_belong_together_is_refused() -> None:
    free = np.full(49, 18.0)
    method = RcFreeResponse(two_modes())
    with pytest.raises(DataError, match="shape"):
        method.forecast(free[1:], history_of(free), boundary_of(48, 6))
    with pytest.raises(DataError, match="no finite value"):
        method.forecast(free * np.nan, history_of(free), boundary_of(48, 6))
    hole = np.array([1.0, np.nan, 1.0, 1.0, 1.0, 1.0, 1.0])
    with pytest.raises(DataError, match="weather forecast"):
        method.forecast(free, history_of(free), boundary_of(48, 6, T_out_C=hole))


def test_registry_builds_it_from_the_model_alone() -> None:
    built = build_free_response("rc", rc=two_modes())
    free = np.full(49, 18.0)
    np.testing.assert_array_equal(
        built.forecast(free, history_of(free), boundary_of(48, 6)).quantiles_C,
        RcFreeResponse(two_modes()).forecast(free, history_of(free), boundary_of(48, 6)).quantiles_C,
    )
    with pytest.raises(ConfigError, match="no linear free part"):
        build_free_response("rc", rc=None)
    with pytest.raises(ConfigError, match="unknown option 'lags'; known: none"):
        build_free_response("rc", rc=two_modes(), lags=3)


def test_noise_that_modes_share_in_an_hour_can_be_had_in_a_quarter() -> None:
    """Scaled element by element it is no covariance: the fast mode forgets within the hour, the slow one does not."""
    slow = replace(two_modes(), poles=np.array([0.2, 0.99]), process_K2=np.array([[1.0, -0.99], [-0.99, 1.0]]))
    quarter = slow.resampled(900.0)
    assert np.linalg.eigvalsh(quarter.process_K2)[0] >= -1e-12
    np.testing.assert_allclose(np.diag(quarter.process_K2), [0.58, 0.25], atol=0.1)
    still = np.full(5, 20.0)
    forecast = RcFreeResponse(quarter).forecast(still, history_of(still, step_s=900.0), boundary_of(4, 3, step_s=900.0))
    assert np.isfinite(forecast.quantiles_C).all()


def test_a_record_that_grows_is_forecast_as_if_anew_at_no_more_cost() -> None:
    """A filter of each length of a record was built in each step of a run: after two weeks 30 ms of 40 a forecast."""
    params, rng = two_modes(process_sd_K=0.1, sensor_sd_K=0.05), np.random.default_rng(3)
    n = 1500
    outdoor, T = np.cumsum(0.3 * rng.standard_normal(n + AHEAD)), 20.0 + np.cumsum(0.1 * rng.standard_normal(n))
    T[rng.uniform(size=n) < 0.1] = np.nan
    method, spent = RcFreeResponse(params), []

    def forecast(by: RcFreeResponse, k: int, free: np.ndarray) -> np.ndarray:
        history = history_of(free[:k], T_out_C=outdoor[:k], solar_W_m2=np.zeros(k))
        boundary = boundary_of(k - 1, AHEAD, T_out_C=outdoor[k - 1 : k + AHEAD], solar_W_m2=np.zeros(AHEAD + 1))
        began = time.process_time()
        quantiles = by.forecast(free[:k], history, boundary).quantiles_C
        spent.append(time.process_time() - began)
        return quantiles

    # Lengths about the ends of blocks, one shorter than before, and one whose past was corrected.
    corrected = np.where(np.arange(n) == 100, 25.0, T)
    for k, free in [(k, T) for k in (2, 64, 65, 66, 128, 129, 300, 200)] + [(201, corrected), (202, T)]:
        np.testing.assert_array_equal(forecast(method, k, free), forecast(RcFreeResponse(params), k, free), str(k))
    spent.clear()
    for k in range(n - 40, n):
        forecast(method, k, T)
    for _ in range(40):
        forecast(method, n - 1, T)
    assert np.median(spent[:40]) < 4.0 * np.median(spent[40:])
