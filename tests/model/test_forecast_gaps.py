"""Forecasts that are missing, short or with holes: what stands in for them, in which order, and what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Names, Record
from thermoforce_mpc.model.forecast_gaps import BY_DAYS, completed, lengthened, weather_spread, whole

N, NOW_S = 48, 30 * DAY_S


def outdoor(time_s):
    """Another temperature at every hour, a whole day apart the same but for the day's number."""
    hour, day = np.asarray(time_s) / HOUR_S % 24, np.floor(np.asarray(time_s) / DAY_S)
    return 5.0 + 0.2 * hour + 0.5 * (day - 30)


def boundary(now_s: float = NOW_S, n: int = N) -> Boundary:
    time_s = now_s + HOUR_S * np.arange(n + 1)
    hour = time_s / HOUR_S % 24
    same = np.ones(n + 1)
    return Boundary(time_s, outdoor(time_s), 10.0 * hour, 0 * same, 15 + hour / 10, 24 * same, 0.1 + hour / 100, same)


def record(days: float = 3.0, now_s: float = NOW_S) -> Record:
    time_s = now_s - days * DAY_S + HOUR_S * np.arange(round(24 * days) + 1)
    n = time_s.size
    nothing = {name: np.zeros(n - 1) for name in ("u", "power_W", "heat_W")}
    sun = 10.0 * (time_s / HOUR_S % 24)
    return Record(time_s=time_s, T_out_C=outdoor(time_s), solar_W_m2=sun, T_zone_C=np.full(n, 20.0), **nothing)


def without(given: Boundary, name: str, at=slice(None)) -> Boundary:
    values = getattr(given, name).copy()
    values[..., at] = np.nan
    return replace(given, **{name: values})


def test_a_whole_forecast_is_left_alone():
    given = boundary()
    assert completed(given, record(), boundary(NOW_S - HOUR_S)) == (given, "")
    assert whole(given)
    assert not whole(without(given, "price_per_kWh", 3))


def test_a_short_hole_in_the_weather_is_a_straight_line():
    filled, how = completed(without(boundary(), "T_out_C", [5, 6]), record(), None)
    np.testing.assert_allclose(filled.T_out_C, boundary().T_out_C)
    assert how == "forecast: T_out_C at 2 of 49 instants by interpolation (4 % of the plan)"


def test_prices_are_not_interpolated_but_those_of_the_day_before():
    filled, how = completed(without(boundary(), "price_per_kWh", [30, 31]), record(), None)
    np.testing.assert_allclose(filled.price_per_kWh, boundary().price_per_kWh)
    assert "price_per_kWh at 2 of 49 instants by the day before" in how


@pytest.mark.parametrize("name", ["T_out_C", "solar_W_m2", "price_per_kWh", "lower_C"])
def test_a_signal_that_is_missing_altogether_is_the_last_forecast_and_beyond_it_the_day_before(name):
    last = boundary(NOW_S - 6 * HOUR_S)
    filled, how = completed(without(boundary(), name), record(), last)
    found, true = getattr(filled, name)[..., : N - 5], getattr(boundary(), name)[..., : N - 5]
    np.testing.assert_allclose(found, true)
    rest, before = getattr(filled, name)[..., N - 5 :], getattr(filled, name)[..., N - 29 : N - 23]
    np.testing.assert_allclose(rest, before)
    assert f"{name} at 49 of 49 instants by the last forecast (6 h old) and the day before (100 % of the plan)" in how
    # The last forecast was given by somebody, the day before is a guess.
    assert np.flatnonzero(np.atleast_2d(filled.guessed[name])[0]).tolist() == list(range(N - 5, N + 1))
    assert np.isfinite(getattr(filled, name)).all()
    assert not whole(filled)


def test_without_any_forecast_the_weather_is_that_of_the_day_before():
    filled, how = completed(without(without(boundary(), "T_out_C"), "solar_W_m2"), record(), None)
    np.testing.assert_allclose(filled.T_out_C[1:24], boundary().T_out_C[1:24] - 0.5)
    np.testing.assert_allclose(filled.solar_W_m2, boundary().solar_W_m2)
    assert how.count("the day before") == 2


def test_where_the_record_has_holes_too_it_is_the_mean_of_the_hour():
    history = record(9.0)
    T = history.T_out_C.copy()
    T[-8 * 24 :] = np.nan
    filled, how = completed(without(boundary(), "T_out_C"), replace(history, T_out_C=T), None)
    assert np.isfinite(filled.T_out_C).all()
    assert "the mean of the record at that hour" in how


def of_two_machines(dearer: float) -> Boundary:
    """Prices of two machines with a hole at 5 and 6; heating of the second may cost more, with a hole at 8."""
    given = boundary()
    price = np.repeat(without(given, "price_per_kWh", [5, 6]).price_per_kWh, 2, axis=0)
    heating = price.copy()
    if dearer:
        heating[1] = boundary().price_per_kWh + dearer
        heating[1, 8] = np.nan
    names = Names(("room",), ("floor", "fan"), ("heat pump", "heating_boiler"))
    emission = np.repeat(given.emission_kg_per_kWh, 2, axis=0)
    return replace(given, price_per_kWh=price, heating_price_per_kWh=heating, emission_kg_per_kWh=emission, names=names)


@pytest.mark.parametrize("dearer", [0.0, 0.1])
def test_of_a_machine_with_one_price_it_is_said_once_and_of_another_what_heating_lacks(dearer):
    lacking = {"price_per_kWh[heat pump]": 2, "price_per_kWh[heating_boiler]": 2}
    lacking |= {"heating_price_per_kWh[heating_boiler]": 1} if dearer else {}
    given = of_two_machines(dearer)
    filled, how = completed(given, record(), None)
    by = [f"{of} at {n} of 49 instants by the value before ({2 * n} % of the plan)" for of, n in lacking.items()]
    assert how == f"forecast: {', '.join(by)}"
    assert np.isfinite(filled.heating_price_per_kWh).all()
    # What a source of data has filled is said in the same way.
    guessed = {name: np.isnan(getattr(given, name)) for name in ("price_per_kWh", "heating_price_per_kWh")}
    _, how = completed(replace(filled, guessed=guessed), record(), None)
    by = [f"{of} at {n} of 49 instants ({2 * n} % of the plan) by {BY_DAYS}" for of, n in lacking.items()]
    assert how == f"forecast: {', '.join(by)}"


def test_prices_known_only_at_first_go_on_as_they_were():
    filled, how = completed(without(boundary(), "price_per_kWh", slice(3, None)), record(), None)
    assert np.isfinite(filled.price_per_kWh).all()
    assert filled.price_per_kWh[0, 3] == boundary().price_per_kWh[0, 2]
    assert "the value before" in how


def test_what_cannot_be_known_stays_unknown_and_impossible_weather_is_none():
    filled, how = completed(without(boundary(), "price_per_kWh"), record(), None)
    assert np.isnan(filled.price_per_kWh).all()
    assert how == ""
    impossible = replace(boundary(), T_out_C=np.where(np.arange(N + 1) == 4, -300.0, boundary().T_out_C))
    filled, how = completed(impossible, record(), None)
    np.testing.assert_allclose(filled.T_out_C, boundary().T_out_C)
    assert "T_out_C at 1 of 49" in how


@pytest.mark.parametrize("given_steps", [0, 1, 20])
def test_a_forecast_that_ends_early_has_holes_and_is_filled_from_the_last_one(given_steps):
    longer = lengthened(boundary(n=given_steps), N, HOUR_S)
    assert longer.n_steps == N
    np.testing.assert_allclose(longer.time_s, boundary().time_s)
    assert not whole(longer)
    filled, how = completed(longer, record(), boundary(NOW_S - HOUR_S, N + 1))
    np.testing.assert_allclose(filled.T_out_C, boundary().T_out_C)
    assert "the last forecast (1 h old)" in how
    assert lengthened(boundary(), N, HOUR_S).n_steps == N
    at_meter = lengthened(replace(boundary(n=given_steps), others_W=np.full(given_steps + 1, 400.0)), N, HOUR_S)
    assert np.nansum(at_meter.others_W) == 400.0 * (given_steps + 1)


def test_a_guess_of_the_weather_is_as_far_off_as_such_guesses_were_in_the_record():
    filled, _ = completed(without(without(boundary(), "T_out_C", slice(20, None)), "T_out_C", 3), record(), None)
    assert np.flatnonzero(filled.guessed["T_out_C"]).tolist() == [3, *range(20, N + 1)]
    spread = weather_spread("T_out_C", filled, record())
    np.testing.assert_allclose(spread[20:], 0.5)  # from day to day
    assert 0.0 < spread[3] < 1.2  # over two hours: the line misses midnight alone
    assert not np.delete(spread, filled.guessed["T_out_C"]).any()
    assert not weather_spread("solar_W_m2", filled, record()).any()
    longer = lengthened(filled, N + 6, HOUR_S)
    assert longer.guessed["T_out_C"].shape == longer.T_out_C.shape


def test_what_is_guessed_of_more_than_six_hours_errs_as_the_day_before_does():
    filled, _ = completed(without(boundary(), "T_out_C", slice(20, 29)), record(), None)
    np.testing.assert_allclose(weather_spread("T_out_C", filled, record())[20:29], 0.5)
    shorter, _ = completed(without(boundary(), "T_out_C", slice(20, 25)), record(), None)  # a gap of 6 h
    assert weather_spread("T_out_C", shorter, record())[22] != pytest.approx(0.5)
