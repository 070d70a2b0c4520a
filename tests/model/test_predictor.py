"""Superposition: free and forced are taken apart and put together without loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from operators import HEAT_MAP, random_operator

from thermoforce_mpc.data import Boundary, FreeForecast, Observation, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.forced_state import forced_history
from thermoforce_mpc.model.free_response.rc import RcFreeResponse, RcParameters
from thermoforce_mpc.model.operator.building import forced_rollout, single
from thermoforce_mpc.model.operator.parameters import linear_operator, time_of_day
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel

STEP = 3600.0


class HoldLast:
    """A free response that stays where it is."""

    name = "hold"

    def forecast(self, free_C, history, boundary) -> FreeForecast:
        last = free_C[np.isfinite(free_C)][-1]
        return FreeForecast(levels=np.array([0.5]), quantiles_C=np.full((1, boundary.n_steps), last))


def make_history(n: int = 48, seed: int = 0, T_zone=None) -> Record:
    rng = np.random.default_rng(seed)
    hours = np.arange(n + 1)
    return Record(
        time_s=hours * STEP,
        T_zone_C=rng.normal(21, 0.5, n + 1) if T_zone is None else T_zone,
        T_out_C=5 + 3 * np.cos(2 * np.pi * (hours - 15) / 24),
        solar_W_m2=np.maximum(0, 300 * np.cos(2 * np.pi * (hours - 13) / 24)),
        u=rng.choice([0.0, 0.5, 1.0], n),
        power_W=np.full(n, np.nan),
        heat_W=np.full(n, np.nan),
    )


def make_boundary(history: Record, n: int = 24) -> Boundary:
    hours = history.time_s[-1] / STEP + np.arange(n + 1)
    return Boundary(
        time_s=hours * STEP,
        T_out_C=5 + 3 * np.cos(2 * np.pi * (hours - 15) / 24),
        solar_W_m2=np.maximum(0, 300 * np.cos(2 * np.pi * (hours - 13) / 24)),
        occupancy=np.zeros(n + 1),
        lower_C=np.full(n + 1, 21.0),
        upper_C=np.full(n + 1, 24.0),
        price_per_kWh=np.full(n + 1, 0.25),
        emission_kg_per_kWh=np.full(n + 1, 0.17),
    )


@pytest.fixture
def predictor() -> Predictor:
    return Predictor(single(random_operator(3, 3, heat_input=HEAT_MAP)), HoldLast())


def test_free_plus_forced_is_what_was_measured(predictor):
    history = make_history()
    total = predictor.free_history(history) + predictor.forced_history(history).sum(axis=(1, 3))
    np.testing.assert_allclose(total, history.T_zone_C, atol=1e-12)
    np.testing.assert_array_equal(predictor.forced_state(history), predictor.forced_history(history)[:, :, -1])


def test_zero_start_is_the_papers_and_steady_start_holds():
    operator = linear_operator([0.5, 0.98], [0.3, 0.05], step_s=STEP)
    history = replace(make_history(), u=np.full(48, 0.6))
    zero = forced_history(single(operator), history, initial_force="zero")[0, 0]
    assert np.all(zero[0] == 0)
    steady = forced_history(single(operator), history, initial_force="steady")[0, 0]
    np.testing.assert_allclose(steady, np.broadcast_to(0.6 * operator.steady_gains_K, (49, 2)), rtol=1e-12)


def test_exact_recovery_of_a_free_response_under_control():
    """A building that *is* the model: subtracting F must give its control-free temperature back."""
    operator = linear_operator([0.9], [0.2], step_s=STEP)
    base = make_history()
    free, forced = np.empty(49), np.empty(49)
    free[0], forced[0] = 19.0, 0.0
    for t in range(48):
        free[t + 1] = 0.9 * free[t] + 0.1 * base.T_out_C[t] + 1.2
        forced[t + 1] = 0.9 * forced[t] + 0.2 * base.u[0, t]
    history = replace(base, T_zone_C=free + forced)
    predictor = Predictor(single(operator), HoldLast(), initial_force="zero")
    np.testing.assert_allclose(predictor.free_history(history)[0], free, atol=1e-12)


def test_predict_effect_and_counterfactuals_agree(predictor):
    history = make_history()
    context = predictor.context(Observation(history, make_boundary(history)))
    rng = np.random.default_rng(1)
    u, alt = rng.uniform(0, 1, 24), rng.uniform(0, 1, 24)
    np.testing.assert_allclose(
        context.effect(alt, u), context.predict(alt).total_C - context.predict(u).total_C, atol=1e-12
    )
    levels = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    fan = context.counterfactuals(levels)
    assert fan.forced_K.shape == (5, 1, 24)
    assert np.all(np.diff(fan.total_C, axis=0) > 0), "more heating must be warmer at every step"
    np.testing.assert_allclose(fan.total_C[1], context.predict(np.full(24, 0.25)).total_C, atol=1e-12)
    np.testing.assert_allclose(context.predict(u).total_C, context.free.median_C + context.predict(u).forced_K)
    band = (context.predict(u).free_low_C, context.predict(u).free_high_C)
    np.testing.assert_allclose(band, [context.free.quantile_C(level) for level in (0.1, 0.9)])


def test_weather_that_does_not_begin_where_the_record_ends_is_refused(predictor):
    history, origin = make_history(), pd.Timestamp("2025-01-01", tz="UTC")
    weather = make_boundary(history)
    late = replace(weather, time_s=weather.time_s + STEP)
    with pytest.raises(DataError, match=r"begins at 176400\.0, 3600 s after now, .* history, 172800\.0"):
        predictor.context(Observation(history, late))
    with pytest.raises(DataError, match=r"begins at 2025-01-03 01:00:00\+00:00, 3600 s after now"):
        predictor.context(Observation(replace(history, origin=origin), late))
    # Plants round their clocks.
    predictor.context(Observation(history, replace(weather, time_s=weather.time_s + 0.5)))
    model = ThermalModel.single(predictor.operator.pairs[0][0])
    with pytest.raises(DataError, match="3600 s after now"):
        model.predict(history, late, 0.0, free_response=HoldLast())
    with pytest.raises(DataError, match="of one instant, which is no step to predict"):
        model.predict(history, weather.head(0), 0.0, free_response=HoldLast())


class Answering(HoldLast):
    """Forecasts whatever it is told to."""

    def __init__(self, answer) -> None:
        self.answer = answer

    def forecast(self, free_C, history, boundary):
        return self.answer(super().forecast(free_C, history, boundary))


def _spread(forecast: FreeForecast) -> FreeForecast:
    return FreeForecast(np.array([0.1, 0.5, 0.9]), forecast.median_C + np.array([[-1.0], [0.0], [1.0]]))


def _with_gap(forecast: FreeForecast) -> FreeForecast:
    quantiles = _spread(forecast).quantiles_C.copy()
    quantiles[2, 5] = np.nan
    return replace(_spread(forecast), quantiles_C=quantiles)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda f: None, "gave a NoneType, expected a FreeForecast"),
        (_with_gap, "its 0.9 quantile is not finite at step 5 of 24"),
        (lambda f: replace(_spread(f), quantiles_C=_spread(f).quantiles_C[::-1]), "its 0.5 quantile is below its 0.1"),
        (
            lambda f: replace(_spread(f), quantiles_C=_spread(f).quantiles_C[:, :3]),
            r"shape \(3, 3\), expected \(3, 24\)",
        ),
        (lambda f: replace(_spread(f), levels=np.array([0.9, 0.5, 0.1])), "expected values in \\(0, 1\\) that rise"),
    ],
    ids=["none", "a gap", "crossed", "too short", "levels"],
)
def test_a_forecast_that_is_not_fit_to_plan_with_is_refused(answer, message):
    history = make_history()
    predictor = Predictor(single(random_operator(3, 3)), Answering(answer))
    with pytest.raises(DataError, match=message):
        predictor.context(Observation(history, make_boundary(history)))


def test_plan_continues_the_history(predictor):
    """Splitting time into past and future must not change the forced response."""
    history = make_history(72)
    operator = linear_operator([0.3, 0.97], [0.2, 0.05], step_s=STEP, heat_input=HEAT_MAP)
    predictor = Predictor(single(operator), HoldLast())
    past = history.slice(0, 48)
    context = predictor.context(Observation(past, make_boundary(past)))
    whole = forced_history(single(operator), history).sum(axis=(1, 3))[:, 49:]
    np.testing.assert_allclose(context.predict(history.u[:, 48:]).forced_K, whole, atol=1e-9)


def test_silent_sensor_leaves_a_hole_and_nothing_else(predictor):
    history = make_history()
    T = np.array(history.T_zone_C)
    T[0, 10:14] = np.nan
    free = predictor.free_history(replace(history, T_zone_C=T))[0]
    assert np.isnan(free[10:14]).all()
    assert np.isfinite(np.delete(free, range(10, 14))).all()
    silent = Observation(replace(history, T_zone_C=np.full(49, np.nan)), make_boundary(history))
    with pytest.raises(DataError, match="never measured"):
        predictor.context(silent)


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [("u", np.nan, "u is not finite at step 5"), ("T_out_C", np.nan, "T_out_C is not"), ("u", 1.5, "u is 1.5")],
)
def test_a_rollout_refuses_broken_histories_with_the_place(predictor, name, value, word):
    with pytest.raises(DataError, match=word):
        forced_history(predictor.operator, with_value(make_history(), name, 5, value))


def with_value(history: Record, name: str, at: int, value: float) -> Record:
    values = np.array(getattr(history, name))
    values[..., at] = value
    return replace(history, **{name: values})


@pytest.mark.parametrize("name", ["u", "T_out_C", "solar_W_m2"])
def test_the_world_bridges_gaps_of_the_past_and_says_so(predictor, name):
    history = make_history()
    for at in (5, -1):
        broken = with_value(history, name, at, np.nan)
        context = predictor.context(Observation(broken, make_boundary(history)))
        assert context.bridged.startswith(f"bridged {name}: 1 value")
        whole = predictor.context(Observation(history, make_boundary(history)))
        assert whole.bridged == ""
        # One hour of full heat is worth 0.1 to 0.5 K here; what is bridged is off by some of that at most.
        np.testing.assert_allclose(context.forced_K.sum(), whole.forced_K.sum(), atol=0.3)
        assert np.isfinite(predictor.free_history(broken)).all()


@pytest.mark.parametrize("name", ["T_out_C", "solar_W_m2"])
@pytest.mark.parametrize("at", [0, 5, 24])
def test_a_weather_forecast_with_gaps_is_refused_and_named(predictor, name, at):
    history = make_history()
    boundary = make_boundary(history)
    values = np.array(getattr(boundary, name))
    values[at] = np.nan
    with pytest.raises(DataError, match=rf"boundary forecast: {name} is missing at 1 of 25 instants.*\({at} h ahead"):
        predictor.context(Observation(history, replace(boundary, **{name: values})))


def test_impossible_actions_are_refused(predictor):
    history = make_history()
    context = predictor.context(Observation(history, make_boundary(history)))
    with pytest.raises(DataError, match="expected"):
        context.predict(np.zeros(23))
    with pytest.raises(DataError, match=r"inside \[0, 1\]"):
        context.predict(np.full(24, np.nan))
    with pytest.raises(DataError, match="initial_force"):
        Predictor(single(random_operator(3, 3)), HoldLast(), initial_force="warm")  # type: ignore[arg-type]


RC = RcParameters(
    poles=np.array([0.6, 0.985]),
    weights=np.array([[0.05, 5e-4, 1.0, 1e-4, -1e-4, 0.02, 0.01, 1e-4], [0.006, 1e-4, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]]),
    step_s=STEP,
    process_K2=np.diag([4e-4, 1e-4]),
    start_K2=100.0 * np.eye(2),
)


def _simulate(params: RcParameters, T_out, solar, start, patterns: bool = True) -> np.ndarray:
    """The modes' recursion written out, with the mean weather of each step."""
    z, out = np.array(start, dtype=float), [float(np.sum(start))]
    for t in range(len(T_out) - 1):
        T, sun = 0.5 * (T_out[t] + T_out[t + 1]), 0.5 * (solar[t] + solar[t + 1])
        angle = 2 * np.pi * ((t + 0.5) * params.step_s / 86400 - 0.5)
        c, s = (np.cos(angle), np.sin(angle)) if patterns else (0.0, 0.0)
        z = params.poles * z + params.weights @ np.array([T, sun, 1.0, sun * c, sun * s, c, s, sun**2 / 300])
        out.append(float(z.sum()))
    return np.array(out)


def test_rc_forecast_follows_a_building_that_is_the_model():
    history = make_history(96)
    boundary = make_boundary(history)
    T_out = np.concatenate([history.T_out_C, boundary.T_out_C[1:]])
    solar = np.concatenate([history.solar_W_m2, boundary.solar_W_m2[1:]])
    truth = _simulate(RC, T_out, solar, [3.0, 12.0])
    free = truth[:97].copy()
    free[30:40] = np.nan
    forecast = RcFreeResponse(RC).forecast(free, history, boundary)
    np.testing.assert_allclose(forecast.median_C, truth[97:], atol=0.05)
    assert np.all(np.diff(forecast.quantiles_C, axis=0) > 0)
    spread = forecast.quantiles_C[-1] - forecast.quantiles_C[0]
    assert spread[-1] > spread[0]


def test_rc_keeps_its_response_when_resampled():
    constant = np.full(200, 7.0), np.full(200, 100.0)
    hourly = _simulate(RC, *constant, start=[0.0, 0.0], patterns=False)
    fine = _simulate(RC.resampled(900.0), np.full(797, 7.0), np.full(797, 100.0), start=[0.0, 0.0], patterns=False)
    np.testing.assert_allclose(fine[::4], hourly, atol=1e-9)


def test_rc_refuses_what_it_cannot_use():
    history = make_history(24)
    free_response = RcFreeResponse(RC)
    with pytest.raises(DataError, match="shape"):
        free_response.forecast(np.zeros(3), history, make_boundary(history))
    with pytest.raises(DataError, match="never measured"):
        free_response.forecast(np.full(25, np.nan), history, make_boundary(history))
    with pytest.raises(DataError, match="poles"):
        replace(RC, poles=np.array([0.5, 1.0]))


def test_a_level_that_averaging_rounded_beyond_one_is_one():
    steps = 24
    time_s = np.arange(steps + 1) * 3600.0
    still = np.zeros(steps + 1)
    operator = linear_operator(np.array([0.9]), np.array([0.5]), step_s=3600.0)

    def history(level: float) -> Record:
        u = np.full(steps, level)
        return Record(time_s, 21.0 + still, still, still, u, u, np.full(steps, np.nan))

    exact, rounded = (forced_history(single(operator), history(level)) for level in (1.0, np.nextafter(1.0, 2.0)))
    np.testing.assert_array_equal(exact, rounded)
    with pytest.raises(DataError, match=r"expected values in \[0, 1\]"):
        forced_history(single(operator), history(1.001))


def test_measured_heat_drives_an_operator_on_heat_whatever_its_sign():
    for sign in (1, -1):
        operator = random_operator(3, 1, heat_input=HEAT_MAP, sign=sign)
        base = make_history()
        heat = sign * HEAT_MAP.reference_W * HEAT_MAP(base.u[0], base.T_out_C[:-1])
        by_map = forced_history(single(operator), base)
        np.testing.assert_allclose(forced_history(single(operator), replace(base, heat_W=heat)), by_map, rtol=1e-9)
        more = forced_history(single(operator), replace(base, heat_W=1.5 * heat), initial_force="zero")
        assert sign * (more - forced_history(single(operator), base, initial_force="zero"))[0, 0, -1, 0] > 0


def test_total_features_see_the_measured_temperature_in_the_past():
    operator = replace(random_operator(3, 2, scale=0.2, heat_input=HEAT_MAP), feedback=True)
    history = make_history()
    forced = forced_history(single(operator), history, initial_force="zero")[0, 0]
    for t in range(history.n_steps):
        x = np.array(
            [history.T_zone_C[0, t], history.T_out_C[t], history.solar_W_m2[t], time_of_day(history.time_s[t])]
        )
        drive = operator.modulation(x) * HEAT_MAP(history.u[0, t], history.T_out_C[t])
        np.testing.assert_allclose(forced[t + 1], operator.poles * forced[t] + operator.gains * drive, atol=1e-12)
    context = Predictor(single(operator), HoldLast()).context(Observation(history, make_boundary(history)))
    fan = context.counterfactuals(np.array([0.0, 0.5, 1.0]))
    one = forced_rollout(operator, context.forced_K[0, 0], np.full(24, 0.5), context.features[0]).sum(-1)
    np.testing.assert_allclose(fan.forced_K[1, 0], one, atol=1e-12)


def test_any_arrangement_of_candidates_at_once(predictor):
    history = make_history()
    context = predictor.context(Observation(history, make_boundary(history)))
    u = np.random.default_rng(5).uniform(0, 1, (3, 4, 24))
    together = context.predict(u)
    assert together.total_C.shape == (3, 4, 1, 24)
    effects = context.effect(u, u[0, 0])
    for i in range(3):
        for j in range(4):
            alone = context.predict(u[i, j]).forced_K
            np.testing.assert_allclose(together.forced_K[i, j], alone, atol=1e-12)
            np.testing.assert_allclose(effects[i, j], alone - together.forced_K[0, 0], atol=1e-12)
