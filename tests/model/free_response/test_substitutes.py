"""A forecaster that fails or is absurd is replaced, with the reason; one that is only surprising is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.data import HOUR_S, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather, Persistence
from thermoforce_mpc.model.free_response.substitute import WithSubstitutes, absurdity

N = 24
SIGNALS = (
    "time_s", "T_out_C", "solar_W_m2", "occupancy", "lower_C", "upper_C", "price_per_kWh", "emission_kg_per_kWh",
)  # fmt: skip


def weather(time_s):
    return 3.0 + 4.0 * np.cos(2 * np.pi * (time_s / HOUR_S - 15) / 24) - 2.0 * np.sin(2 * np.pi * time_s / HOUR_S / 90)


def house(hours: int = 96) -> tuple[np.ndarray, Record, Boundary]:
    """Control-free temperature of a house that follows the weather slowly, its record, and the weather ahead."""
    time_s = HOUR_S * np.arange(hours + N + 1)
    T_out, T = weather(time_s), [12.0]
    for value in T_out[:-1]:
        T.append(0.97 * T[-1] + 0.03 * value + 0.2)
    past, ahead, same = slice(0, hours + 1), slice(hours, None), np.ones(N + 1)
    nothing = {name: np.zeros(hours) for name in ("u", "power_W", "heat_W")}
    seen = {"T_out_C": T_out[past], "solar_W_m2": 0 * T_out[past], "T_zone_C": np.array(T[past])}
    record = Record(time_s=time_s[past], **seen, **nothing)
    boundary = Boundary(time_s[ahead], T_out[ahead], 0 * same, same, 20 * same, 24 * same, 0.2 * same, same)
    return np.array(T[past]), record, boundary


class Method:
    name = "method"

    def __init__(self, changed=lambda found: found) -> None:
        self.changed = changed

    def forecast(self, free_C, history, boundary):
        return self.changed(LinearWeather().forecast(free_C, history, boundary))


def raising(error):
    raise error


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (lambda f: raising(ZeroDivisionError("no")), "ZeroDivisionError: no"),
        (lambda f: raising(DataError("no weather")), "no weather"),
        (lambda f: "a forecast", "gave a str"),
        (lambda f: replace(f, quantiles_C=f.quantiles_C[:, :3]), "shape"),
        (lambda f: replace(f, quantiles_C=f.quantiles_C * np.inf), "not finite"),
        (lambda f: replace(f, quantiles_C=0 * f.quantiles_C - 50.0), "to -50.0 °C in 1 h"),
        (lambda f: replace(f, quantiles_C=0 * f.quantiles_C + 1e300), "where the record changed by less than"),
        (lambda f: replace(f, quantiles_C=f.quantiles_C + np.linspace(0, 40, N)), "the record changed by less than"),
        (lambda f: replace(f, quantiles_C=f.quantiles_C + 300 * (f.levels - 0.5)[:, None]), "an interval of"),
    ],
    ids=["raises", "refuses", "type", "short", "inf", "-50", "1e300", "drifts", "wide"],
)
def test_what_is_no_forecast_is_replaced_by_the_weather_model_with_the_reason(changed, says):
    free, record, boundary = house()
    answer = WithSubstitutes(Method(changed)).forecast(free, record, boundary)
    np.testing.assert_allclose(answer.median_C, LinearWeather().forecast(free, record, boundary).median_C)
    assert answer.doubt.startswith("free forecast by linear_weather instead (")
    assert says in answer.doubt


@pytest.mark.parametrize(("silent", "absurd"), [(0, True), (6, False)])
def test_after_hours_of_silence_a_zone_may_have_moved_as_far_as_the_record_did_in_so_long(silent, absurd):
    """It fell by 2 K an hour: 21 K within the next hour are too much, within seven hours they are not."""
    _, record, boundary = house(20)
    free = 60.0 - 2.0 * np.arange(21.0)
    free[free.size - silent :] = np.nan
    last_C = 60.0 - 2.0 * (20 - silent)
    forecast = FreeForecast(np.array([0.1, 0.5, 0.9]), np.full((3, N), last_C - 21.0), "falls")
    assert bool(absurdity(forecast, free, record, boundary)) is absurd


@pytest.mark.parametrize("hours", [N, 6])
def test_a_fall_as_long_as_the_record_shows_is_no_absurdity_at_the_end_of_any_horizon(hours):
    """It fell by 2 K an hour for days: as much more in 24 h is ordinary, in 6 h it is not."""
    _, record, boundary = house(60)
    free = 60.0 - 2.0 * np.arange(61.0)
    ahead = Boundary(*(getattr(boundary, name)[..., : hours + 1] for name in SIGNALS))
    falls = np.linspace(free[-1], free[-1] - 2.0 * N, hours + 1)[1:]
    said = absurdity(FreeForecast(np.array([0.1, 0.5, 0.9]), np.stack([falls] * 3)), free, record, ahead)
    assert (said == "") is (hours == N), said


def test_a_healthy_forecast_passes_unchanged():
    free, record, boundary = house()
    answer = WithSubstitutes(Method()).forecast(free, record, boundary)
    np.testing.assert_array_equal(answer.quantiles_C, LinearWeather().forecast(free, record, boundary).quantiles_C)
    assert answer.doubt == ""


def test_a_cold_front_that_the_record_never_showed_is_no_absurdity():
    free, record, boundary = house()
    front = replace(boundary, T_out_C=boundary.T_out_C - 25.0)
    answer = WithSubstitutes(Method()).forecast(free, record, front)
    assert free[-1] - answer.median_C[-1] > 5.0
    assert answer.doubt == ""


def test_without_enough_record_for_the_weather_model_it_is_persistence():
    free, record, boundary = house(3)
    answer = WithSubstitutes(Method(lambda f: raising(KeyError("x")))).forecast(free, record, boundary)
    assert np.isfinite(answer.quantiles_C).all()
    np.testing.assert_allclose(answer.median_C, Persistence().forecast(free, record, boundary).median_C)
    assert "free forecast by persistence instead" in answer.doubt
    absurd = FreeForecast(np.array([0.1, 0.5, 0.9]), np.full((3, N), -50.0))
    assert "from the last one" in absurdity(absurd, free, record, boundary)


def test_where_nothing_was_measured_there_is_no_substitute():
    free, record, boundary = house()
    with pytest.raises(DataError, match="never measured"):
        WithSubstitutes(Method()).forecast(free * np.nan, record, boundary)


def test_a_method_that_learns_begins_anew_after_failures_on_end():
    free, record, boundary = house()
    kept = []

    class Learning(Method):
        def follow(self, free_C, history, boundary, state):
            kept.append(state)
            if 1 <= len(kept) <= 4:
                raise RuntimeError("not yet")
            return self.forecast(free_C, history, boundary), "learned"

    method, state = WithSubstitutes(Learning()), None
    method.follow(free, record, boundary, state)
    for _ in range(6):
        answer, state = method.follow(free, record, boundary, state)
    assert kept[-1] == "learned"
    assert answer.doubt == ""
    assert method.name == "method"
