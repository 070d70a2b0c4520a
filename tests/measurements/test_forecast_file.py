"""A forecast file goes on where the measurements end."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermoforce_mpc as tf
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.forecast import read_forecast

RULES = {
    "time": {"zone": "Europe/Brussels"},
    "outdoor": "out",
    "sun": "sun",
    "zones": {"room": {"temperature": "T", "lower": 20, "upper": "most"}},
    "actuators": {"heater": {"level": "u"}},
    "machines": {"grid": {"power": "P", "price": "price"}},
}


@pytest.fixture(scope="module")
def measured():
    row = np.arange(97.0)
    at = pd.date_range("2025-01-10", periods=97, freq="15min", name="time")
    df = pd.DataFrame({"T": 21.0, "out": 5.0, "sun": 0.0, "u": row // 8 % 2, "P": 500.0, "most": 24.0}, index=at)
    df["price"] = 0.3
    return tf.read_measurements(df, RULES)


def hourly(hours: int = 25, start: str = "2025-01-11") -> pd.DataFrame:
    row = np.arange(float(hours))
    at = pd.date_range(start, periods=hours, freq="1h", name="time")
    return pd.DataFrame({"out": row, "sun": 10 * row, "most": 24.0 - row % 2, "price": 0.2 + row % 2}, index=at)


def test_weather_is_interpolated_and_schedules_hold(measured):
    ahead = read_forecast(hourly(), measured)
    assert ahead.time_s[0] == measured.record.time_s[-1]
    assert ahead.n_steps == 96
    np.testing.assert_allclose(ahead.T_out_C[:9], np.arange(9) / 4)
    np.testing.assert_allclose(ahead.upper_C[0, :9], [24, 24, 24, 24, 23, 23, 23, 23, 24])
    np.testing.assert_allclose(ahead.price_per_kWh[0, :9], [0.2] * 4 + [1.2] * 4 + [0.2])
    assert (ahead.lower_C == 20).all()
    earlier = read_forecast(hourly(49, "2025-01-10"), measured)
    assert earlier.time_s[0] == measured.record.time_s[-1], "what lies before the end of the record is cut"
    assert earlier.T_out_C[0] == 24


def test_other_columns_for_the_forecast(measured, tmp_path):
    rules = {**RULES, "forecast": {"outdoor": {"column": "t2m", "unit": "K"}, "sun": "ghi", "price": 0.5, "upper": 25}}
    df = hourly().rename(columns={"out": "t2m", "sun": "ghi"})
    df["t2m"] += 273.15
    df[["t2m", "ghi"]].to_csv(tmp_path / "weather.csv")
    past = pd.DataFrame(
        {"T": 21.0, "out": 5.0, "sun": 0.0, "u": 0.5, "P": 500.0, "most": 24.0, "price": 0.3},
        index=pd.date_range("2025-01-10", periods=97, freq="15min"),
    )
    ahead = read_forecast(tmp_path / "weather.csv", tf.read_measurements(past, rules))
    np.testing.assert_allclose(ahead.T_out_C[:5], np.arange(5) / 4, atol=1e-9)
    assert (ahead.price_per_kWh == 0.5).all()
    assert (ahead.upper_C == 25).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.iloc[1:], "the forecast must begin there"),
        (lambda d: d.iloc[:1], "the forecast must begin there"),
        (lambda d: d.drop(columns="sun"), "no column 'sun'"),
        (lambda d: d.assign(out=d["out"].where(d["out"] != 7)), r"T_out_C is missing at 7 of 97 .* 2025-01-11 06:15"),
        (lambda d: d.assign(most=19.0), "the lower bound is above the upper one"),
    ],
)
def test_a_forecast_that_does_not_fit_is_refused(measured, change, message):
    with pytest.raises(DataError, match=message):
        read_forecast(change(hourly()), measured)


def test_a_pattern_of_several_files_is_no_forecast(measured, tmp_path):
    for name in ("monday.csv", "tuesday.csv"):
        hourly().to_csv(tmp_path / name)
    with pytest.raises(DataError, match=r"names 2 files, a forecast is one"):
        read_forecast(str(tmp_path / "*.csv"), measured)
    assert read_forecast(str(tmp_path / "mon*.csv"), measured).n_steps == 96
