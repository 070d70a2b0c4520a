"""The public names as someone uses them who knows pandas: the documented code runs, and mistakes are explained."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from contextlib import redirect_stdout

import numpy as np
import pandas as pd
import pytest
from places import ROOT
from simple_house import simple_model

import thermoforce_mpc as tf
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, Block, PlanStatus
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.scenario.settings import validate

NAMES = {"zone": "T_room", "outdoor": "T_out", "solar": "sun", "level": "u", "power": "P_el"}
AHEAD = {"outdoor": "T_out", "solar": "sun"}
LINEAR = tf.IdentificationConfig(modulation="linear")


@pytest.fixture(scope="module")
def tables() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Four probed days of the embedded plant as a person would have them, and the forecast of the two days after."""
    plant = EmbeddedPlant(synthetic_weather())
    r = probe(plant, 20 * DAY_S, 4.0, seed=1)
    index = pd.date_range("2025-01-21", periods=r.n_steps + 1, freq="15min", tz="Europe/Brussels", name="time")
    columns = {"T_room": r.T_zone_C[0], "T_out": r.T_out_C, "sun": r.solar_W_m2, "u": [*r.u[0], None]}
    df = pd.DataFrame(columns | {"P_el": [*r.power_W[0], None]}, index=index).astype(float)
    b = plant.forecast(2 * DAY_S, 3600.0)
    ahead = {"T_out": b.T_out_C, "sun": b.solar_W_m2, "T_min": b.lower_C[0], "T_max": b.upper_C[0]}
    forecast = pd.DataFrame(ahead, index=pd.date_range(index[-1], periods=b.n_steps + 1, freq="1h", name="time"))
    return df, forecast


@pytest.fixture(scope="module")
def model(tables) -> tf.ThermalModel:
    return tf.identify(tf.Record.from_dataframe(tables[0], **NAMES), config=LINEAR)


def blocks(page: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"<!-- run-by-tests: tests/test_public_api\.py -->\n```python\n(.*?)```", text, re.S)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # as a user's Python has it
@pytest.mark.parametrize(
    ("page", "number", "says"),
    [
        ("README.md", 0, "2025-01-25 00:15:00+01:00"),
        ("docs/reference/python.md", 0, "2025-01-25 00:15:00+01:00"),
        ("docs/how-to/many.md", 0, "2074800.0 as planned\nsouth"),
    ],
    ids=["readme", "table", "many"],
)
def test_documented_code_runs(page, number, says, tables, tmp_path, monkeypatch, identified_once):
    tables[0].to_csv(tmp_path / "room.csv")
    tables[1].to_csv(tmp_path / "forecast.csv")
    monkeypatch.chdir(tmp_path)
    with redirect_stdout(io.StringIO()) as printed:
        exec(compile(blocks(page)[number], page, "exec"), {"__name__": "__main__"})
    assert says in printed.getvalue()


def test_every_public_name_is_there_and_import_loads_none_of_them():
    code = (
        "import sys, thermoforce_mpc; "
        "print(sorted(m for m in sys.modules if m.split('.')[0] in ('casadi', 'pandas', 'torch')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert all(getattr(tf, name) is not None for name in tf.__all__)
    assert set(tf.__all__) <= set(dir(tf))
    with pytest.raises(AttributeError, match="no attribute 'History'"):
        _ = tf.History


@pytest.mark.slow
def test_a_prediction_is_free_plus_forced_with_its_band_and_times(tables, model):
    df, forecast = tables
    record = tf.Record.from_dataframe(df, **NAMES)
    weather = tf.Boundary.from_dataframe(forecast, record, **AHEAD)
    assert weather.step_s == record.step_s, "hourly rows are interpolated to the record's step"
    off = model.predict(record, weather, 0.0, free_response=LinearWeather()).to_dataframe()
    on = model.predict(record, weather, np.ones(weather.n_steps), free_response=LinearWeather()).to_dataframe()
    assert off.index[0] == df.index[-1] + pd.Timedelta("15min")
    np.testing.assert_allclose(off.T_zone_C, off.T_free_C + off.T_forced_K)
    assert ((off.T_low_C <= off.T_zone_C) & (off.T_zone_C <= off.T_high_C)).all()
    assert (on.T_zone_C > off.T_zone_C).all(), "heating heats"
    assert "a day at full level changes the zone by +" in model.summary()
    assert "2025-01-21 00:00:00+01:00 to 2025-01-25 00:00:00+01:00" in model.summary()


@pytest.mark.slow
def test_the_plan_is_that_of_the_registry_and_has_times(tables, model, tmp_path):
    from controllers.registry import build_controller
    from thermoforce_mpc.plants.testcases import load_testcase

    record = tf.Record.from_dataframe(tables[0], **NAMES)
    weather = tf.Boundary.from_dataframe(tables[1], record, **AHEAD, lower="T_min", upper="T_max", price=0.25)
    seen = tf.Observation(record, weather)
    plan = tf.ThermoForceMPC(tf.load_model(model.save(tmp_path / "house"))).plan(seen)
    ours = build_controller("thermoforce_mpc", {}, load_testcase("bestest_hydronic_heat_pump"), model).plan(seen)
    assert plan.status == "solved", plan.why
    np.testing.assert_array_equal(plan.u, ours.u)
    table = plan.to_dataframe()
    assert table.index[0] == tables[0].index[-1]
    assert len(table) == 192
    without = tf.Boundary.from_dataframe(tables[1], record, **AHEAD, lower=21, upper=24)
    refused = tf.ThermoForceMPC(model).plan(tf.Observation(record, without))
    assert refused.status == "thermostat"
    assert "price_per_kWh is missing" in refused.why


@pytest.mark.slow
def test_what_was_not_measured_is_left_out(tables):
    df = tables[0]
    record = tf.Record.from_dataframe(df, zone="T_room", outdoor="T_out", level="u")
    assert np.isnan(record.power_W).all()
    assert (record.solar_W_m2 == 0).all()
    model = tf.identify(record, config=LINEAR)
    assert model.power == (None,)
    assert "energy cannot be planned" in model.summary()


@pytest.mark.parametrize("day", ["2025-03-30", "2025-10-26"], ids=["23 h", "25 h"])
def test_days_on_which_the_clock_changes_are_as_long_as_they_are(day):
    index = pd.date_range(day, periods=2, freq="1D", tz="Europe/Brussels")
    hours = pd.date_range(index[0], index[1], freq="1h")
    df = pd.DataFrame({"T": 20.0, "out": 5.0, "u": 0.5}, index=hours)
    record = tf.Record.from_dataframe(df, zone="T", outdoor="out", level="u")
    assert record.n_steps == (23 if day == "2025-03-30" else 25)
    assert list(record.stamps()) == list(hours)
    assert record.slice(2, 5).stamps()[0] == hours[2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda df: df.rename(columns={"T_out": "T_ouT"}), r"record: no column 'T_out', did you mean 'T_ouT'\?"),
        (lambda df: df.reset_index(drop=True), r"record: the index holds int64, not time stamps.*parse_dates=True"),
        (lambda df: df.drop(df.index[7]), r"a step of 1800 s among steps of 900 s.*resample"),
        (lambda df: df.assign(T_room=df.T_room.astype(str) + " °C"), r"column 'T_room' holds a cell that is no number"),
        (lambda df: df.iloc[:0], r"record: the table has no rows"),
        (lambda df: pd.concat([df, df[["T_out"]]], axis=1), "record: there are 2 columns 'T_out'; give each a name"),
        (lambda df: df.assign(T_room=df.T_room + 273.15), r"zone: column 'T_room': 385 of 385 .*convert K by x - 273"),
        (lambda df: df.assign(T_out=df.T_out + 273.15), r"outdoor: column 'T_out': .* between -60 and 60 °C, first 2"),
        (lambda df: df.assign(u=100.0 * df.u), r"level: column 'u': .* between -1 and 1, first .* divide % by 100"),
        (lambda df: df["T_room"], r"record: the table is of class Series, expected DataFrame: .*to_frame"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_with_what_to_do(tables, change, message):
    with pytest.raises(DataError, match=message):
        tf.Record.from_dataframe(change(tables[0]), **NAMES)


def test_what_a_broken_sensor_says_for_a_while_is_no_unit(tables):
    """A loop of somebody's own goes on: the controller does not believe these readings."""
    df = tables[0].assign(T_room=tables[0].T_room.where(tables[0].index < tables[0].index[-100], 327.67))
    assert (tf.Record.from_dataframe(df, **NAMES).T_zone_C[0, -100:] == 327.67).all()


@pytest.mark.parametrize("name", [None, 0, ["T_room"], pd.Series([20.0])])
def test_a_room_is_named_by_its_column(tables, name):
    with pytest.raises(DataError, match=r"record: zone is of class .*, expected str: give the name of a column"):
        tf.Record.from_dataframe(tables[0], **NAMES | {"zone": name})


def test_a_table_through_summer_time_says_how_to_read_it_and_then_reads(tmp_path):
    index = pd.date_range("2025-03-29", periods=97, freq="30min", tz="Europe/Brussels", name="time")
    whole = pd.DataFrame({"T": 20.0 + np.arange(97) % 5, "out": 5.0, "u": 0.5}, index=index)
    whole.to_csv(tmp_path / "room.csv")
    df = pd.read_csv(tmp_path / "room.csv", index_col=0, parse_dates=True)
    names = {"zone": "T", "outdoor": "out", "level": "u"}
    with pytest.raises(
        DataError, match=r"'2025-03-29 00:00:00\+01:00'.* summer time.*to_datetime\(df\.index, utc=True\)"
    ):
        tf.Record.from_dataframe(df, **names)
    rules = {"time": {"zone": "Europe/Brussels"}, "outdoor": "out", "zones": {"room": {"temperature": "T"}}}
    by_map = tf.read_measurements(df, rules | {"actuators": {"heater": {"level": "u"}}}).record
    df.index = pd.to_datetime(df.index, utc=True).tz_convert("Europe/Brussels")
    record = tf.Record.from_dataframe(df, **names)
    assert list(record.stamps()) == list(index)
    np.testing.assert_array_equal(by_map.T_zone_C, record.T_zone_C)


def test_a_room_is_not_outdoors(tables):
    with pytest.raises(DataError, match="zone and outdoor are the same column, 'T_room'"):
        tf.Record.from_dataframe(tables[0], **NAMES | {"outdoor": "T_room"})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.tz_localize(None), "time zones: the record has one and forecast has none"),
        (lambda f: f.iloc[3:], "the rows must begin there"),
        (lambda f: f.iloc[::-1], "in order of time"),
        (lambda f: f.assign(T_out=f.T_out + 273.15), r"forecast: outdoor: column 'T_out': 49 of 49 cells"),
        (lambda f: f["T_out"], "forecast: the table is of class Series"),
    ],
)
def test_a_forecast_that_does_not_follow_is_refused(tables, change, message):
    record = tf.Record.from_dataframe(tables[0], **NAMES)
    with pytest.raises(DataError, match=message):
        tf.Boundary.from_dataframe(change(tables[1]), record, **AHEAD)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"lower": 24, "upper": 21}, r"at 20.* the lower bound, 24 °C, is above the upper one, 21 °C: exchange"),
        ({"lower": "T_max", "upper": "T_min"}, "exchange lower and upper"),
        ({"lower": 68, "upper": 75}, r"lower is 68 at 20.* between -30 and 60 °C; convert °F or K"),
        ({"lower": 21, "upper": 297}, "upper is 297 at"),
        (
            {"lower": np.full(49, 21.0)},
            "lower is a ndarray, expected the name of a column, or one number.*lower='lower'",
        ),
        ({"price": pd.Series(0.3)}, "price is a Series, expected the name of a column, or one number"),
        ({"price": True}, "price is a bool"),
    ],
)
def test_bounds_that_would_heat_without_end_are_refused(tables, bounds, message):
    record = tf.Record.from_dataframe(tables[0], **NAMES)
    with pytest.raises(DataError, match=message):
        tf.Boundary.from_dataframe(tables[1], record, **AHEAD, **bounds)


def test_what_is_no_observation_model_or_options_is_refused_by_name(tables):
    record = tf.Record.from_dataframe(tables[0], **NAMES)
    weather = tf.Boundary.from_dataframe(tables[1], record, **AHEAD)
    with pytest.raises(DataError, match="observation: history is of class Boundary, expected Record"):
        tf.Observation(weather, record)
    with pytest.raises(
        DataError, match="model is of class str, expected ThermalModel: identify or load_model gives one"
    ):
        tf.ThermoForceMPC("my_house")
    with pytest.raises(DataError, match="runs: one of them is of class str, expected Record"):
        tf.identify(tables[0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r, m: tf.verified_saving(r, "after.csv"), "after is of class str, expected Record"),
        (lambda r, m: tf.counterfactual("my_house", r, 0.5, start=0.0), "model is of class str, expected ThermalModel"),
        (lambda r, m: tf.counterfactual(m, r, "off", start=0.0), r"levels \(u\): could not convert string"),
        (lambda r, m: tf.counterfactual(m, r, np.ones((2, 4)), start=r.time_s[9]), r"\(2, 4\), expected \(1, 4\)"),
        (lambda r, m: tf.counterfactual(m, r, 0.5, start=0.0, hours=float("nan")), "hours is nan"),
        (lambda r, m: m.predict("room.csv", None, 0.5), "record is of class str, expected Record"),
        (lambda r, m: tf.read_forecast("f.csv", r), r"measured is of class Record, expected Measurements: read_meas"),
        (lambda r, m: tf.Plan((), "ok", "why"), "plan: status is 'ok', expected one of solved, bridged"),
        (lambda r, m: tf.plan_many([m], {}), "models is of class list, expected Mapping: give them by the name"),
        (lambda r, m: tf.plan_many({"a": m}, [r]), "observations is of class list, expected Mapping"),
        (
            lambda r, m: tf.read_measurements(None, {"outdoor": "o", "zones": {"r": {"temperature": "T"}}}),
            "files is of",
        ),
        (lambda r, m: tf.read_measurements([r], {"outdoor": "o", "zones": {"r": {"temperature": "T"}}}), "of them is"),
        (lambda r, m: tf.read_measurements("room.csv", None), "map is of class NoneType.*tf-mpc data map FILE"),
        (lambda r, m: tf.load_model(None), "folder is of class NoneType, expected str or PathLike"),
        (lambda r, m: m.save(None), "folder is of class NoneType"),
        (lambda r, m: Block("0.5", 900.0), r"block: a level \(u\) is '0.5', expected a number"),
        (lambda r, m: Block(0.5, None), "block: duration_s is None, expected a number"),
        (lambda r, m: tf.identify(None), "runs is of class NoneType, expected Record or Iterable"),
        (lambda r, m: tf.identify(r, layout="house"), "layout is of class str, expected Layout"),
        (lambda r, m: tf.step_function("my_house"), "model is of class str, expected ThermalModel"),
        (lambda r, m: tf.modulation_function("my_house"), "model is of class str, expected ThermalModel"),
        (
            lambda r, m: tf.run("bestest_hydronic_heat_pump", model="my_house"),
            "model is of class str, expected Thermal",
        ),
    ],
)
def test_what_a_program_mistakes_is_named(tables, call, words):
    with pytest.raises(DataError, match=words):
        call(tf.Record.from_dataframe(tables[0], **NAMES), simple_model())


def test_options_of_python_are_explained_as_those_of_files_are():
    with pytest.raises(ConfigError, match=r"MPCConfig:\n  horizn_h: unknown key, did you mean 'horizon_h'\?; known"):
        tf.MPCConfig(horizn_h=24)
    with pytest.raises(ConfigError, match="IdentificationConfig:\n  modulation: Input should be 'always', 'auto' or"):
        tf.IdentificationConfig(modulation="lin")
    with pytest.raises(ConfigError, match=r"file:\n  watch\.most_seconds: unknown key"):  # the whole path of a key
        validate(tf.MPCConfig, {"watch": {"most_seconds": 3}}, "file")


def test_a_price_of_no_kilowatt_hour_is_refused_or_doubted(tables):
    record, ahead = tf.Record.from_dataframe(tables[0], **NAMES), tables[1].assign(**{"price EUR/MWh": 85.0, "p": 30.0})
    with pytest.raises(DataError, match="column 'price EUR/MWh' is per MWh by its name: divide by 1000"):
        tf.Boundary.from_dataframe(ahead, record, **AHEAD, price="price EUR/MWh")
    with pytest.raises(DataError, match=r"price is -0\.3: no price of every kWh is below 0"):
        tf.Boundary.from_dataframe(ahead, record, **AHEAD, price=-0.3)
    for price in (85, "p"):
        with pytest.warns(DoubtfulInput, match="are they per MWh, or in cents, or in another currency"):
            tf.Boundary.from_dataframe(ahead, record, **AHEAD, price=price)
    ahead = ahead.rename(columns={"p": "price JPY/kWh"})
    assert tf.Boundary.from_dataframe(ahead, record, **AHEAD, price="price JPY/kWh").price_per_kWh.max() == 30.0


def test_the_status_of_a_plan_may_be_its_word():
    assert tf.Plan((), "rule", "why").status is PlanStatus.RULE


def test_a_forecast_needs_the_step_of_its_record(tables):
    record = tf.Record.from_dataframe(tables[0].iloc[-1:], **NAMES)
    with pytest.raises(DataError, match=r"the record is of one instant.*give two rows or more"):
        tf.Boundary.from_dataframe(tables[1], record, **AHEAD)


def test_a_run_gives_kpis_and_trajectories_and_leaves_nothing_behind(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    result = tf.run(
        "bestest_hydronic_heat_pump", controller="thermostat", days=0.5, period="20", baselines=["native"],
        progress=False,
    )  # fmt: skip
    assert list(result.kpis) == ["thermostat", "native"]
    assert result.kpis["thermostat"]["cost_tot"] > 0
    assert result.to_dataframe().T_zone_C.between(15, 30).all()
    assert len(result.to_dataframe("native")) == 12
    with pytest.raises(ConfigError, match="no run of 'natve', did you mean 'native'"):
        result.to_dataframe("natve")
    with pytest.raises(ConfigError, match="horizn"):
        tf.run("bestest_hydronic_heat_pump", horizn=3)
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_a_run_with_a_model_identifies_nothing_and_says_whose_model_it_was(model):
    result = tf.run(
        "bestest_hydronic_heat_pump", model=model, days=0.25, period="20", baselines=["thermostat"], progress=False
    )
    assert result.models == {"thermoforce_mpc": model}
    assert result.identification == {}
    assert result.result.fallback_levels()["solved"] == 24


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("package", ("-c", "import thermoforce_mpc; thermoforce_mpc.ThermoForceMPC")),
        ("package", ("-c", "import thermoforce_mpc.gym")),
        ("package", ("-m", "thermoforce_mpc", "controllers")),
        ("file", ("-c", "from thermoforce_mpc import run")),
    ],
)
def test_something_of_the_users_called_controllers_is_named_where_it_hides_ours(tmp_path, kind, words):
    hides = tmp_path / "controllers.py"
    if kind == "package":
        hides = tmp_path / "controllers"
        hides.mkdir()
        (hides / "__init__.py").touch()
    else:
        hides.touch()
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path, env=environment
    )
    assert done.returncode == (2 if words[0] == "-m" else 1)
    assert f"{hides} hides the package `controllers`" in done.stderr
    assert "rename yours" in done.stderr
