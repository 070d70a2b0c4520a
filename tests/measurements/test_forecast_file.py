"""A forecast file goes on where the measurements end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

import thermoforce_mpc as tf
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.map.mapping import ForecastMap
from thermoforce_mpc.model.forecast_gaps import completed
from thermoforce_mpc.scenario.building import PRICES

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
    earlier = read_forecast(hourly(49, "2025-01-10").assign(out=np.arange(49.0) / 4), measured)
    assert earlier.time_s[0] == measured.record.time_s[-1], "what lies before the end of the record is cut"
    assert earlier.T_out_C[0] == 6


def test_a_forecast_without_the_columns_of_the_map_says_how_to_name_its_own(measured, tmp_path):
    hourly().rename(columns={"out": "t2m"}).to_csv(tmp_path / "weather.csv")
    for now in (None, pd.Timestamp("2025-01-11", tz="Europe/Brussels")):
        with pytest.raises(DataError, match=r"no column 'out'; there are .*t2m.*forecast: \{outdoor: NAME"):
            read_forecast(tmp_path / "weather.csv", measured, now=now)


@pytest.mark.parametrize("live", [False, True])
def test_a_forecast_of_another_program_is_read_as_it_is_written(live, tmp_path):
    """A logger with decimal commas, and weather as a service writes it: no line of the map is needed for that."""
    at = pd.date_range("2025-01-10", periods=97, freq="15min")
    row = np.arange(97.0)
    logged = pd.DataFrame(
        {"T": 21.5, "out": 5.5, "sun": 0.0, "u": row // 8 % 2, "P": 500.0, "most": 24.5, "price": 0.3}
    )
    logged.index = at.strftime("%d.%m.%Y %H:%M").rename("Zeitstempel")
    logged.to_csv(tmp_path / "house.csv", sep=";", decimal=",")
    clock = {"column": "Zeitstempel", "format": "%d.%m.%Y %H:%M", "zone": "Europe/Brussels"}
    rules = RULES | {"time": clock, "csv": {"decimal": ","}}
    measured = tf.read_measurements(tmp_path / "house.csv", rules)
    ahead = hourly().assign(out=lambda df: df["out"] + 0.25)
    expected = read_forecast(ahead, tf.read_measurements(logged.set_axis(at.rename("time")), RULES))
    ahead.index = (
        ahead.index.tz_localize("Europe/Brussels").tz_convert("UTC").strftime("%Y-%m-%dT%H:%M:%SZ").rename("time")
    )
    ahead.to_csv(tmp_path / "tomorrow.csv")
    now = pd.Timestamp("2025-01-11", tz="Europe/Brussels") if live else None
    read = read_forecast(tmp_path / "tomorrow.csv", measured, now=now)
    np.testing.assert_allclose(read.T_out_C, expected.T_out_C)
    np.testing.assert_allclose(read.upper_C, expected.upper_C)


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
        (lambda d: d.iloc[7:], "the forecast must begin there"),
        (lambda d: d.iloc[:1], "the forecast must begin there"),
        (lambda d: d.drop(columns="sun"), "no column 'sun'"),
        (lambda d: d.assign(out=np.nan), r"T_out_C has no value from 2025-01-11 00:00"),
        (lambda d: d.assign(most=19.0), "the lower bound is above the upper one"),
    ],
)
def test_a_forecast_that_does_not_fit_is_refused(measured, change, message):
    with pytest.raises(DataError, match=message):
        read_forecast(change(hourly()), measured)


@pytest.mark.parametrize("by_file", [False, True])
def test_the_number_of_a_map_is_no_hour_of_prices_that_change(tmp_path, by_file):
    """What is known until new prices come at noon is today's: with the map's .5 mixed in, tomorrow is flat and dear."""
    at = pd.date_range("2025-01-10", periods=97, freq="15min", name="time")
    past = pd.DataFrame({"T": 21.0, "out": 5.0, "sun": 0.0, "u": 0.5, "P": 500.0, "most": 24.0}, index=at)
    rules = RULES | {"machines": {"grid": {"power": "P", "price": 0.5}}}
    ahead = hourly(49).drop(columns="price")
    prices = pd.Series(0.1 + ahead.index.hour / 100, index=ahead.index, name="price").iloc[:18]
    if by_file:
        prices.to_csv(tmp_path / "prices.csv")
        found = read_forecast(ahead, tf.read_measurements(past, rules), prices=tmp_path / "prices.csv")
    else:
        found = read_forecast(
            ahead.assign(price=prices), tf.read_measurements(past, rules | {"forecast": {"price": "price"}})
        )
    hours = found.price_per_kWh[0, ::4]
    np.testing.assert_allclose(hours[24:42], prices.to_numpy(), atol=1e-9)
    assert np.isnan(hours[20:24]).all(), "of no day: bridged later"


def test_prices_that_end_early_go_on_as_in_the_same_hour_of_the_days_before(measured):
    df = hourly(49)
    df["price"] = 0.1 + np.arange(49) % 24 / 100
    df.loc[df.index[26:], "price"] = np.nan
    ahead = read_forecast(df, measured)
    assert ahead.n_steps == 192, "weather is used to its end"
    hours = ahead.price_per_kWh[0, ::4]
    known = slice(0, 26)
    np.testing.assert_allclose(hours[known], 0.1 + np.arange(26) % 24 / 100)
    # The record has 0.3 the day before: of two days that are known the mean.
    np.testing.assert_allclose(hours[26:48], (0.1 + np.arange(26, 48) % 24 / 100 + 0.3) / 2)
    guessed = ahead.guessed["price_per_kWh"][0]
    assert not guessed[: 26 * 4].any()
    assert guessed[26 * 4 :].all()
    filled, words = completed(ahead, measured.record, None)
    assert "price_per_kWh at 89 of 193 instants (46 % of the plan) by the same hour of the days before" in words
    assert filled.head(8).guessed["price_per_kWh"].shape == (1, 9)


def test_each_column_is_bridged_by_a_rule_of_its_own(measured):
    df = hourly()
    df.iloc[7, df.columns.get_loc("out")] = np.nan
    df.iloc[10, df.columns.get_loc("most")] = np.nan
    df.iloc[12, df.columns.get_loc("price")] = np.nan
    filled, words = completed(read_forecast(df, measured), measured.record, None)
    np.testing.assert_allclose(filled.T_out_C[:97], np.arange(97) / 4)
    assert filled.upper_C[0, 43] == 24.0, "as in the record a day before"
    assert filled.price_per_kWh[0, 12 * 4 + 3] == pytest.approx(0.3)
    for signal in ("T_out_C", "upper_C", "price_per_kWh"):
        assert signal in words


@pytest.mark.parametrize("by_file", [False, True])
def test_a_price_holds_for_its_own_hour_where_the_next_is_lacking(measured, tmp_path, by_file):
    """The last of a list that ends at midnight does not hold beyond it either."""
    df = hourly(49).assign(price=0.5)
    prices = df["price"].drop(df.index[[6, *range(12, 49)]])
    prices.to_csv(tmp_path / "prices.csv")
    if by_file:
        ahead = read_forecast(df, measured, prices=tmp_path / "prices.csv")
    else:
        ahead = read_forecast(df.assign(price=prices), measured)
    quarters = ahead.price_per_kWh[0, :50]
    given = np.isclose(quarters, 0.5) & ~ahead.guessed.get("price_per_kWh", np.zeros((1, 193), dtype=bool))[0, :50]
    assert np.flatnonzero(given).tolist() == [*range(24), *range(28, 48)]


def test_a_forecast_that_begins_a_little_later_is_joined_to_the_last_reading(measured):
    ahead = read_forecast(hourly().iloc[2:], measured)
    filled, words = completed(ahead, measured.record, None)
    assert filled.T_out_C[0] == 5.0, "as measured"
    np.testing.assert_allclose(filled.T_out_C[4], (5.0 + 2.0) / 2)
    assert "T_out_C at" in words


def test_a_step_has_the_mean_of_its_prices(measured):
    quarters = hourly(25).resample("15min").ffill()
    quarters["price"] = np.arange(97.0) % 4
    late = tf.read_measurements(quarters.assign(T=21.0, u=0.5, P=500.0), RULES, step_s=3600.0)
    assert late.conditions.price_per_kWh[0, 0] == pytest.approx(1.5)


def test_comfort_by_weekday_hour_and_holiday_is_in_the_map():
    """Friday 10 January 2025 and a weekend whose Monday is a holiday, in Brussels."""
    at = pd.date_range("2025-01-09", "2025-01-11", freq="1h", tz="Europe/Brussels")
    df = pd.DataFrame({"T": 21.0, "out": 5.0, "sun": 0.0, "u": 0.5, "P": 500.0, "price": 0.3}, index=at)
    comfort = {"schedule": "weekdays 7-22 21-24, weekend 9-23 20-25, else 16-27", "holidays": ["2025-01-13"]}
    rules = {**RULES, "zones": {"room": {"temperature": "T"}}, "comfort": comfort}
    found = tf.read_measurements(df, rules)
    lower = found.conditions.lower_C[0]
    assert [lower[k] for k in (6, 7, 21, 22)] == [16, 21, 21, 16]
    ahead = read_forecast(hourly(24 * 4 + 1).assign(out=lambda d: d["out"] % 7, sun=0.0), found)
    days = ahead.lower_C[0, :-1].reshape(4, 24)
    np.testing.assert_array_equal(days[:, 8], [16, 16, 16, 21])  # Saturday, Sunday, the holiday, Tuesday
    np.testing.assert_array_equal(days[:, 22], [20, 20, 20, 16])
    assert ahead.upper_C[0, 12] == 25
    other = {**rules, "forecast": {"lower": 19}}
    assert (read_forecast(hourly(), tf.read_measurements(df, other)).lower_C == 19).all()
    for wrong, message in (
        ({**rules, "zones": {"room": {"temperature": "T", "lower": 20}}}, "give lower and upper, or comfort"),
        ({**rules, "comfort": "weekdays 7-22 21-24"}, "the last part says what holds else"),
        ({**rules, "comfort": {"schedule": {"bath": "else 20-24"}}}, "no zone 'bath'"),
        ({**rules, "time": {}}, "comfort needs time.zone"),
    ):
        with pytest.raises(ConfigError, match=message):
            tf.read_measurements(df, wrong)


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("time,price\n{0}\n", [0.1, 0.11, 0.12]),
        ("Beginn;Spotpreis [EUR/MWh];Menge\n{1}\n", [0.1, 0.11, 0.12]),
        ("start,tarif ct/kWh\n{2}\n", [0.1, 0.11, 0.12]),
        ("time,price\n{3}\n", [0.1, 0.11, 0.12]),
        ("MTU (UTC),Day-ahead Price [EUR/MWh]\n{4}\n", [0.1, 0.11, 0.12]),
        ("Start (EET/EEST),EUR/MWh price\n{5}\n", [0.1, 0.11, 0.12]),
        ("start_timestamp,price EUR/MWh\n{6}\n", [0.1, 0.11, 0.12]),
        ("time,price\n{7}\n", [0.1, 0.11, 0.12]),
    ],
    ids=[
        "zone of the map",
        "per MWh, semicolons, commas",
        "cents in UTC",
        "seconds of the year",
        "UTC by its header",
        "another clock by its header",
        "ms since 1970",
        "an offset that no zone has all year",
    ],
)
def test_a_file_of_prices_takes_the_place_of_the_map(measured, tmp_path, text, first):
    at = pd.date_range("2025-01-10", periods=60, freq="1h", tz="Europe/Brussels")
    price = 0.1 + (np.arange(60) - 24) % 24 / 100
    kinds = (
        [f"{t:%Y-%m-%d %H:%M},{p:.2f}" for t, p in zip(at, price, strict=True)],
        [f"{t:%Y-%m-%d %H:%M};{1000 * p:.2f};7".replace(".", ",") for t, p in zip(at, price, strict=True)],
        [f"{t.tz_convert('UTC').isoformat()},{100 * p:.1f}" for t, p in zip(at, price, strict=True)],
        ["0,0.2", *(f"{(t - at[0]).total_seconds() + 9 * 86400:.0f},{p:.2f}" for t, p in zip(at, price, strict=True))],
        [f"{t.tz_convert('UTC'):%d.%m.%Y %H:%M},{1000 * p:.2f}" for t, p in zip(at, price, strict=True)],
        [f"{t.tz_convert('Europe/Athens'):%d.%m.%Y %H:%M},{1000 * p:.2f}" for t, p in zip(at, price, strict=True)],
        [f"{t.timestamp() * 1000:.0f},{1000 * p:.2f}" for t, p in zip(at, price, strict=True)],
        [f"{t.tz_convert('Asia/Kolkata').isoformat()},{p:.2f}" for t, p in zip(at, price, strict=True)],
    )
    (tmp_path / "prices.csv").write_text(text.format(*("\n".join(lines) for lines in kinds)), encoding="utf-8")
    notes = []
    ahead = read_forecast(hourly(49), measured, prices=tmp_path / "prices.csv", left_out=notes)
    np.testing.assert_allclose(ahead.price_per_kWh[0, :12:4], first)
    assert "prices.csv" in notes[0]
    no_zone = text.startswith(("time,price\n{0}", "Beginn"))
    assert ("its stamps name no zone: taken in Europe/Brussels" in notes[0]) is no_zone
    assert ahead.guessed["price_per_kWh"][0, -1], "beyond the file as on the days before"
    np.testing.assert_allclose(ahead.price_per_kWh[0, 40 * 4], 0.1 + 16 / 100)


@pytest.mark.parametrize(
    ("zone", "grid", "said"),
    [
        ("UTC", {"windows": [{"hours": "17:00-19:30", "per_kWh": 0.10}]}, True),
        ("Europe/Brussels", {"windows": [{"hours": "17:00-19:30", "per_kWh": 0.10}]}, False),
        ("UTC", {"per_kWh": 0.1}, False),
    ],
)
def test_hours_of_a_bill_on_a_clock_in_utc_are_said_to_be_none_of_the_building_s(tmp_path, zone, grid, said):
    at = pd.date_range("2025-01-10", periods=97, freq="15min", name="time")
    df = pd.DataFrame({"T": 21.0, "out": 5.0, "sun": 0.0, "u": np.arange(97.0) // 8 % 2, "P": 500.0}, index=at)
    df["most"], df["price"] = 24.0, 0.3
    (tmp_path / "bill.yaml").write_text(yaml.safe_dump({"source": "a contract", "energy": 0.2, "grid": grid}))
    notes: list[str] = []
    measured = tf.read_measurements(df, {**RULES, "time": {"zone": zone}})
    read_forecast(hourly(49), measured, prices=tmp_path / "bill.yaml", left_out=notes)
    assert ("its hours are of UTC" in " ".join(notes)) is said


def test_an_own_building_has_the_tariffs_of_simulated_ones(measured, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    found = {}
    for name in PRICES:
        said: list[str] = []
        ahead = read_forecast(hourly(), measured, prices=Path(name), left_out=said)
        assert said == [
            f"tariff {name} of the simulated buildings, per kWh" + ", synthetic" * (name == "highly_dynamic")
        ]
        found[name] = ahead.price_per_kWh[0]
    hours = np.arange(97) / 4  # from midnight of the building's clock on
    by_day = (hours % 24 >= 7.0) & (hours % 24 < 22.25)
    np.testing.assert_allclose(found["constant"], 0.2535)
    np.testing.assert_allclose(found["dynamic"], np.where(by_day, 0.2666, 0.2383))
    assert np.unique(found["highly_dynamic"]).size > 20
    (tmp_path / "dynamic").write_text("time,price\n2025-01-11,0.5\n2025-01-12,0.5\n")
    np.testing.assert_allclose(read_forecast(hourly(), measured, prices=Path("dynamic")).price_per_kWh[0, :90], 0.5)
    said_of = CliRunner().invoke(cli, ["plan", "--prices", "dynamik"]).output
    assert "'dynamik' is neither a file nor a tariff" in " ".join(said_of.replace("│", " ").split())


def test_prices_whose_column_or_unit_is_not_clear_are_refused(measured, tmp_path):
    at = pd.date_range("2025-01-10", periods=60, freq="1h").strftime("%Y-%m-%d %H:%M")
    for columns, message in (
        ({"a": 0.1, "b": 0.2}, "which column is the price"),
        ({"price": 80.0}, "Say the unit in its name"),
    ):
        pd.DataFrame({"time": at, **columns}).to_csv(tmp_path / "p.csv", index=False)
        with pytest.raises(DataError, match=message):
            read_forecast(hourly(), measured, prices=tmp_path / "p.csv")


def test_prices_in_a_currency_that_is_named_may_be_of_any_size(measured, tmp_path):
    at = pd.date_range("2025-01-10", periods=60, freq="1h").strftime("%Y-%m-%d %H:%M")
    for column, value in (("price JPY/kWh", 31.0), ("spot HUF per MWh", 40000.0)):
        pd.DataFrame({"time": at, column: value}).to_csv(tmp_path / "p.csv", index=False)
        ahead = read_forecast(hourly(), measured, prices=tmp_path / "p.csv")
        assert ahead.price_per_kWh[0, 0] == (31.0 if "JPY" in column else 40.0)
    bill = {"source": "a contract", "energy": "p.csv", "supplier_per_kWh": 5.0, "currency": "HUF"}
    (tmp_path / "bill.yaml").write_text(yaml.safe_dump(bill))
    assert read_forecast(hourly(), measured, prices=tmp_path / "bill.yaml").price_per_kWh[0, 0] == 45.0


@pytest.mark.parametrize(
    ("price", "read", "said"),
    [
        ("Preis ct/kWh", 0.26, "column 'Preis ct/kWh': cent per kWh"),
        ("Preis ct", 0.26, "column 'Preis ct': cent per kWh"),
        ("spot EUR/MWh", 0.026, "column 'spot EUR/MWh': per MWh"),
        ({"column": "price öre/kWh"}, 0.26, "cent per kWh"),
        ({"column": "Preis ct/kWh", "factor": 0.012}, 0.312, ""),
        ({"column": "Preis ct/kWh", "unit": "per MWh"}, 0.026, "per MWh"),
        ({"column": "tariff", "unit": "cent per kWh"}, 0.26, "cent per kWh"),
    ],
)
def test_a_price_of_the_map_is_in_the_unit_that_the_name_of_its_column_tells(measured, price, read, said):
    own = measured.map.model_validate(measured.map.model_dump(exclude_unset=True) | {"forecast": {"price": price}})
    notes: list[str] = []
    table = hourly().assign(**{price if isinstance(price, str) else price["column"]: 26.0})
    ahead = read_forecast(table, replace(measured, map=own), left_out=notes)
    assert ahead.price_per_kWh[0, 0] == pytest.approx(read)
    assert said in " ".join(notes)
    assert bool(notes) is bool(said)


def test_columns_of_one_price_whose_names_tell_two_units_are_refused(measured):
    given = measured.map.model_dump(exclude_unset=True)
    with pytest.raises(ValueError, match="tell cent per kWh and per kWh: a sum is of one unit, name it"):
        measured.map.model_validate(given | {"forecast": {"price": {"column": ["spot ct/kWh", "grid fee"]}}})


def test_prices_of_a_column_of_the_map_that_are_too_large_are_doubted(measured):
    told: list[str] = []
    for column in ("Preis", "price JPY/kWh", "price USD/kWh"):
        own = measured.map.model_validate(measured.map.model_dump(exclude_unset=True) | {"forecast": {"price": column}})
        notes: list[str] = []
        table = hourly().assign(**{column: 26.0})
        ahead = read_forecast(table, replace(measured, map=own), left_out=notes)
        assert ahead.price_per_kWh[0, 0] == 26.0
        told.append(" ".join(notes))
    assert "column 'Preis': prices of 26 per kWh" in told[0]
    assert "in cents" in told[0]
    assert not told[1]
    assert "0.01 to 2 USD are usual" in told[2]


def test_a_pattern_of_several_files_is_no_forecast(measured, tmp_path):
    for name in ("monday.csv", "tuesday.csv"):
        hourly().to_csv(tmp_path / name)
    with pytest.raises(DataError, match=r"names 2 files, a forecast is one"):
        read_forecast(str(tmp_path / "*.csv"), measured)
    assert read_forecast(str(tmp_path / "mon*.csv"), measured).n_steps == 96


@pytest.mark.parametrize("update", [{}, {"stuck_h": 12.0}])
def test_weather_that_stays_is_a_forecast_and_no_stuck_sensor(measured, update):
    outdoor = measured.map.outdoor.model_copy(update=update)
    here = replace(measured, map=measured.map.model_copy(update={"outdoor": outdoor}))
    assert (read_forecast(hourly(49).assign(out=-15.0), here).T_out_C == -15.0).all()
    sunny = measured.map.sun.model_copy(update=update)
    here = replace(measured, map=measured.map.model_copy(update={"sun": sunny}))
    assert (read_forecast(hourly(49).assign(sun=50.0), here).solar_W_m2 == 50.0).all()


@pytest.mark.parametrize(
    ("unit", "of_file", "likelier"),
    [("°C", lambda C: 1.8 * C + 32.0, "°F"), ("°F", lambda C: C, "°C"), ("F", lambda C: C, "°C")],
)
def test_outdoor_temperatures_that_go_on_in_another_unit_are_refused_or_said(measured, unit, of_file, likelier):
    rules = measured.map.model_copy(update={"forecast": ForecastMap(outdoor={"column": "out", "unit": unit})})
    here, ahead = replace(measured, map=rules), hourly().assign(out=of_file(hourly()["out"] / 4))
    words = rf"column 'out': a median of .* in {likelier} it would be 3 °C: set unit: '{likelier}' of forecast.outdoor"
    with pytest.raises(DataError, match=words):
        read_forecast(ahead, here)
    said: list[str] = []
    read_forecast(ahead, here, now=pd.Timestamp("2025-01-11", tz="Europe/Brussels"), left_out=said)
    assert any(likelier in one for one in said)


def test_a_front_that_warms_a_day_by_16_kelvin_is_weather(measured):
    """-10 °C before and 6 °C in the next day's median, which in °F would be -14 °C."""
    record = replace(measured.record, T_out_C=np.full(measured.record.T_out_C.shape, -10.0))
    ahead = hourly(49).assign(out=np.interp(np.arange(49), [0.0, 8.0], [-10.0, 6.0]))
    assert read_forecast(ahead, replace(measured, record=record)).T_out_C.max() == 6.0
