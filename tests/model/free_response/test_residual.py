"""The weather model with a forecaster of its residual, on series whose cause is known."""

from __future__ import annotations

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, history_of, hours

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.execution.cooperative import Computation
from thermoforce_mpc.model.free_response.linear_weather import TIME_CONSTANTS_H, fit_linear_weather
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.free_response.residual import ResidualFreeResponse
from thermoforce_mpc.model.free_response.stacking import stacking_weights

N, AHEAD = 336, 24


class Fixed:
    """A forecaster that says what it is told: `offset_K` above the last finite value, quantiles `spread_K` apart."""

    name = "fixed"

    def __init__(self, offset_K: float, spread_K: float = 0.1) -> None:
        self.offset_K, self.spread_K = offset_K, spread_K

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        last = free_C[np.isfinite(free_C)][-1] + self.offset_K
        rows = last + (LEVELS - 0.5)[:, None] * self.spread_K / 0.4 + np.zeros(boundary.n_steps)
        return FreeForecast(LEVELS, rows, f"fixed {self.offset_K:g}")

    def forecasting(self, tasks: list[tuple[Array, Record, Boundary]]) -> Computation[list[FreeForecast]]:
        yield from ()
        self.asked = getattr(self, "asked", [])
        self.asked.append(len(tasks))
        return [self.forecast(*task) for task in tasks]


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
    fit = fit_linear_weather(free[: N + 1], history, boundary)
    q = TIME_CONSTANTS_H.size
    assert np.sqrt(np.mean((fit.past_C - free[: N + 1]) ** 2)) < 0.15
    assert np.abs(fit.ahead_C - free[N + 1 :]).max() < 0.4
    assert (fit.weights[: 2 * q] >= 0).all()
    assert fit.weights[:q].sum() == pytest.approx(1.0, abs=0.15)  # long-run gain of the outdoors
    assert fit.weights[q : 2 * q].sum() == pytest.approx(2.0, rel=0.3)  # 0.02 K per W/m², in units of 100 W/m²


def test_a_room_that_cools_when_the_sun_shines_is_not_believed() -> None:
    free, outdoor, solar = room_and_weather(1)
    history, boundary = past_and_ahead(outdoor, solar, free)
    fit = fit_linear_weather(free[: N + 1] - 0.01 * solar[: N + 1], history, boundary)
    assert (fit.weights[: 2 * TIME_CONSTANTS_H.size] >= 0).all()


def test_residual_adds_the_backbones_forecast_of_what_the_weather_leaves_over() -> None:
    """With four days there are no trials: the default weights, which the note says."""
    free, outdoor, solar = room_and_weather(2)
    short = 4 * 24
    free, outdoor, solar = (values[: short + AHEAD + 1] for values in (free, outdoor, solar))
    history = history_of(free[: short + 1], T_out_C=outdoor[: short + 1], solar_W_m2=solar[: short + 1])
    boundary = boundary_of(short, AHEAD, T_out_C=outdoor[short:], solar_W_m2=solar[short:])
    forecast = ResidualFreeResponse(Fixed(0.25)).forecast(free[: short + 1], history, boundary)
    expected = 0.1 * (free[short] + 0.25)
    for share, disturbance_h in ((0.5, None), (0.4, 24.0)):
        fit = fit_linear_weather(free[: short + 1], history, boundary, disturbance_h)
        expected = expected + share * (fit.ahead_C + free[short] - fit.past_C[-1] + 0.25)
    np.testing.assert_allclose(forecast.median_C, expected, atol=1e-12)
    assert "fixed 0.25" in forecast.note
    assert "too little history for trials" in forecast.note


def test_residual_learns_from_trials_what_weather_is_worth() -> None:
    """On a random walk the backbone alone keeps its share; on a room that follows the weather it loses it."""
    free, outdoor, solar = room_and_weather(10)
    history, boundary = past_and_ahead(outdoor, solar, free)
    walk = 15 + np.cumsum(0.3 * np.random.default_rng(11).standard_normal(N + 1))
    shares = []
    for series in (walk, free[: N + 1]):
        residual = ResidualFreeResponse(Fixed(0.0))
        forecast, weights = residual.follow(series, history, boundary, None)
        assert "weights by 2" in forecast.note  # twenty-odd trials
        np.testing.assert_allclose(weights.share.sum(axis=0), 1.0)
        shares.append(weights.share[0].mean())
    assert shares[0] > 0.1
    assert shares[1] < 0.03


def test_trials_of_yesterday_are_remembered_and_those_of_another_series_are_not() -> None:
    free, outdoor, solar = room_and_weather(12)
    backbone = Fixed(0.0)
    residual, weights = ResidualFreeResponse(backbone), None

    def trials_at(now: int, series: np.ndarray) -> int:
        nonlocal weights
        backbone.asked = []
        history = history_of(series[: now + 1], T_out_C=outdoor[: now + 1], solar_W_m2=solar[: now + 1])
        boundary = boundary_of(now, 12, T_out_C=outdoor[now : now + 13], solar_W_m2=solar[now : now + 13])
        _, weights = residual.follow(series[: now + 1], history, boundary, weights)
        return sum(backbone.asked) // 3 - 1

    assert trials_at(N - 30, free) >= 24
    assert trials_at(N - 24, free) == 0  # within the day the weights stay
    assert 1 <= trials_at(N - 4, free) <= 5
    assert trials_at(N - 28, free + 0.1) >= 24


@pytest.mark.parametrize("what", ["free", "solar_W_m2", "T_out_C"])
def test_a_trial_is_remembered_only_as_long_as_all_it_was_made_from_is_the_same(what: str) -> None:
    """As after an adaptation of the operator or a correction of the record: the past changed, days before a trial."""
    free, outdoor, solar = room_and_weather(15)
    free, outdoor, solar = free[:289], outdoor[:289], solar[:289]
    series = {"free": free.copy(), "T_out_C": outdoor.copy(), "solar_W_m2": solar.copy()}

    def forecast(residual: ResidualFreeResponse, ahead: int = 24) -> np.ndarray:
        weather = {name: series[name] for name in ("T_out_C", "solar_W_m2")}
        history = history_of(series["free"], **weather)
        return residual.forecast(series["free"], history, boundary_of(288, ahead)).median_C

    used = ResidualFreeResponse(Fixed(0.0))
    before = forecast(used, ahead=30)[:24]  # another horizon, so that the weights are renewed by the same trials
    series[what][:72] += 3.0 * np.sin(np.arange(72) / 5.0)  # the first trial is made a day later than that
    after = forecast(used)
    np.testing.assert_array_equal(after, forecast(ResidualFreeResponse(Fixed(0.0))))
    assert np.abs(after - before).max() > 0.0


def test_a_slow_disturbance_bends_the_generalised_fit_less() -> None:
    """Three days two kelvins above the model's course, as with guests: the gains must stay those of the weather."""
    free, outdoor, solar = room_and_weather(13)
    free = free + np.where((np.arange(free.size) > 150) & (np.arange(free.size) < 222), 2.0, 0.0)
    history, boundary = past_and_ahead(outdoor, solar, free)
    truth = free[N + 1 :]
    plain, slow = (fit_linear_weather(free[: N + 1], history, boundary, tau) for tau in (None, 24.0))
    gap = [np.std(fit.ahead_C - truth) for fit in (plain, slow)]  # a constant offset is the backbone's part
    assert gap[1] < 0.7 * gap[0]
    holed = free[: N + 1].copy()
    holed[40:60] = np.nan
    holed[::9] = np.nan
    again = fit_linear_weather(holed, history, boundary, 24.0)
    assert np.std(again.ahead_C - truth) < 1.5 * gap[1]


def test_stacking_finds_the_better_forecast_and_keeps_to_the_prior_where_nothing_speaks_against_it() -> None:
    rng = np.random.default_rng(14)
    prior = np.array([0.5, 0.5])
    groups = np.repeat([0, 1], 6)
    errors = rng.standard_normal((30, 2, 12)) * np.where(groups == 0, 1.0, 0.1)[None, None]
    errors[:, 0, :6] *= 0.1  # the first is right soon, the second later
    errors[:, 1, 6:] *= 0.1
    errors[3, :, 2] = np.nan
    free = stacking_weights(errors, prior, 0.0, groups)
    assert (free[0, :6] > 0.95).all()
    assert (free[1, 6:] > 0.95).all()
    np.testing.assert_allclose(free.sum(axis=0), 1.0)
    drawn = stacking_weights(errors, prior, 1e6, groups)
    np.testing.assert_allclose(drawn, 0.5, atol=1e-3)
    turned = np.concatenate([errors, errors[:, ::-1]])  # later trials say the opposite, and count for more
    late = stacking_weights(turned, prior, 0.0, groups, np.repeat([0.01, 1.0], 30))
    assert (late[1, :6] > 0.9).all()
    np.testing.assert_array_equal(stacking_weights(errors[:, :, :1] * np.nan, prior, 1.0, groups[:1]), [[0.5], [0.5]])
    np.testing.assert_array_equal(stacking_weights(np.zeros((9, 2, 3)), prior, 1.0, np.zeros(3, int)), 0.5)


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


def test_trials_see_nothing_of_what_they_forecast() -> None:
    """Each ends where its history does, and of what came then it is given the weather alone."""
    free, outdoor, solar = room_and_weather(4)
    history, boundary = past_and_ahead(outdoor, solar, free)
    seen: list[tuple[Array, Record, Boundary]] = []

    class Watching(Fixed):
        def forecasting(self, tasks: list[tuple[Array, Record, Boundary]]) -> Computation[list[FreeForecast]]:
            seen.extend(tasks)
            return super().forecasting(tasks)

    ResidualFreeResponse(Watching(0.0)).forecast(free[: N + 1], history, boundary)
    trials = seen[3:]  # the forecast itself comes first, three candidates of it
    assert len(trials) >= 3 * 20
    for past_C, past, ahead in trials:
        now = past_C.size - 1
        assert past.n_steps == now <= N - AHEAD
        assert past.time_s[-1] == ahead.time_s[0]
        assert ahead.n_steps == AHEAD
        np.testing.assert_array_equal(ahead.T_out_C, outdoor[now : now + AHEAD + 1])
        assert not np.isfinite(ahead.lower_C).any()
    for past_C, _, _ in trials[::3]:
        np.testing.assert_array_equal(past_C, free[: past_C.size])
