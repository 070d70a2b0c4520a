"""Tables as people have them become records: units, clocks, gaps, flags and levels by the rules of the map."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import thermoforce_mpc as tf
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.map.starting_map import starting_map
from thermoforce_mpc.measurements.points import read_points
from thermoforce_mpc.measurements.tables.files import read_tables
from thermoforce_mpc.measurements.tables.forms import Written

NOW = pd.Timestamp("2025-01-12", tz="UTC")
BASE = {
    "outdoor": "out",
    "zones": {"room": {"temperature": "T"}},
    "actuators": {"heater": {"level": "u"}},
    "machines": {"grid": {"power": "P", "price": 0.3}},
}


def house(periods: int = 192, freq: str = "15min", start: str = "2025-01-10") -> pd.DataFrame:
    """Two days whose readings tell their row: temperatures rise by 0.01 K a row, levels alternate."""
    row = np.arange(periods, dtype=float)
    at = pd.date_range(start, periods=periods, freq=freq)
    u = (row // 8) % 2
    return pd.DataFrame({"time": at, "T": 20 + 0.01 * row, "out": 5 - 0.01 * row, "u": u, "P": 1500 * u})


def written(tmp_path, df: pd.DataFrame, changes: dict | None = None, name: str = "house.csv", **how):
    rules = {**BASE, **(changes or {})}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(rules, allow_unicode=True, sort_keys=False), encoding="utf-8")
    df.to_csv(tmp_path / name, index=False, **how)
    return tmp_path / name, tmp_path / "map.yaml"


def test_a_table_and_its_map_make_the_record_that_a_data_frame_makes(tmp_path):
    df = house()
    found = tf.read_measurements(*written(tmp_path, df))
    columns = {"zone": "T", "outdoor": "out", "level": "u", "power": "P"}
    ours = tf.Record.from_dataframe(df.set_index("time"), **columns)
    for name in ("time_s", "T_zone_C", "T_out_C", "u", "power_W"):
        np.testing.assert_allclose(getattr(found.record, name), getattr(ours, name), atol=1e-9, err_msg=name)
    assert found.record.names.zones == ("room",)
    assert found.record.origin == ours.origin
    assert (found.conditions.price_per_kWh == 0.3).all()
    assert np.isnan(found.conditions.lower_C).all()
    assert found.understood.rows_every_s == 900


def test_units_and_several_zones(tmp_path):
    df = house()
    df["bath_K"], df["hall_F"] = df["T"] + 273.15, df["T"] * 9 / 5 + 32
    df["percent"], df["Wh"] = 100 * df["u"], df["P"] / 4
    df["meter_kWh"] = (df["P"] / 4000).cumsum().shift(1, fill_value=0.0)
    changes = {
        "zones": {
            "bath": {"temperature": {"column": "bath_K", "unit": "K"}, "floor_area_m2": 8},
            "hall": {"temperature": {"column": "hall_F", "unit": "°F"}},
        },
        "actuators": {
            "towel": {"zone": "bath", "machine": "heat_pump", "level": {"column": "percent", "unit": "%"}},
            "floor": {"zone": "hall", "machine": "heat_pump", "heat": {"column": "Wh", "unit": "Wh per step"}},
        },
        "machines": {"heat_pump": {"power": {"column": "meter_kWh", "unit": "kWh counter"}}},
    }
    found = tf.read_measurements(*written(tmp_path, df, changes))
    r = found.record
    np.testing.assert_allclose(r.T_zone_C, [df["T"], df["T"]], atol=1e-9)
    np.testing.assert_allclose(r.u, [df["u"][:-1], df["u"][:-1]], atol=1e-9)
    np.testing.assert_allclose(r.heat_W[1], df["P"][:-1], atol=1e-6)
    assert np.isnan(r.heat_W[0]).all()
    np.testing.assert_allclose(r.power_W[0], df["P"][:-1], atol=1e-6)
    assert found.layout.home == (0, 1)
    assert found.layout.machine_of == (0, 0)
    hall = found.of_zones(["hall"])
    assert hall.record.names.actuators == ("floor",)
    np.testing.assert_array_equal(hall.record.T_zone_C[0], r.T_zone_C[1])


@pytest.mark.parametrize("marks", ["start", "end"])
@pytest.mark.parametrize("beside", ["none", "weather at other minutes", "quarters of an hour", "a few empty cells"])
def test_energy_per_step_is_that_of_its_own_interval_in_a_joined_table(beside, marks):
    """2 kWh an hour are 2 kW, whatever rows other columns add between them."""
    at = pd.date_range("2025-01-10", periods=49, freq="h")
    meter = pd.DataFrame({"E": 2.0}, index=at)
    minutes = {"weather at other minutes": ["7min"], "quarters of an hour": ["15min", "30min", "45min"]}
    stamps = at.union([s for gap in minutes.get(beside, []) for s in at[:-1] + pd.Timedelta(gap)])
    df = pd.DataFrame({"T": 21.0, "out": 5.0}, index=stamps).join(meter)
    df["T"] += np.arange(len(df)) / 100
    if beside == "a few empty cells":
        df.loc[df.index[5:45:4], "E"] = np.nan
    rules = {
        "time": {"marks": marks},
        "step": "1h",
        "outdoor": "out",
        "zones": {"room": {"temperature": "T"}},
        "machines": {"grid": {"power": {"column": "E", "unit": "kWh per step"}}},
    }
    np.testing.assert_allclose(tf.read_measurements(df, rules).record.power_W[0], 2000.0)


def test_metered_energy_is_a_share_of_its_robust_maximum(tmp_path):
    df = house()
    df.loc[50, "P"] = 40_000.0  # one wrong peak
    changes = {"actuators": {"heater": {}}}
    found = tf.read_measurements(*written(tmp_path, df, changes))
    assert found.record.u.max() == 1.0
    np.testing.assert_allclose(np.delete(found.record.u[0], 50), np.delete(df["u"][:-1], 50), atol=1e-9)
    assert any("metered power over 1500 W (the 99th percentile" in told for told in found.understood.assumed)
    given = tf.read_measurements(*written(tmp_path, df, {"actuators": {"heater": {"full_W": 3000}}}))
    assert np.delete(given.record.u[0], 50).max() == 0.5


def test_irregular_rows_become_means_of_what_acts_and_samples_of_what_is_sampled():
    at = pd.Timestamp("2025-01-10") + pd.to_timedelta([0, 5, 20, 30, 40, 180, 190, 210], unit="min")
    df = pd.DataFrame(
        {"T": [20.0, 20.5, 22.0, 23.0, 24.0, 10.0, 11.0, 13.0], "out": 0.0, "u": [0, 1, 0, 1, 1, 1, 0, 0], "P": 0.0},
        index=at,
    )
    rules = {**BASE, "step": "15min", "zones": {"room": {"temperature": {"column": "T", "spike": 50, "hold_h": 0.5}}}}
    rules["actuators"] = {"heater": {"level": {"column": "u", "hold_h": 0.5}}}
    found = tf.read_measurements(df, rules).record
    np.testing.assert_allclose(found.T_zone_C[0, :3], [20.0, 21.5, 23.0], atol=1e-9)
    np.testing.assert_allclose(found.u[0, :2], [10 / 15, 5 / 15], atol=1e-9)
    assert np.isnan(found.T_zone_C[0, 4:12]).all(), "a gap of two hours and twenty minutes"
    np.testing.assert_allclose(found.T_zone_C[0, 12], 10.0)
    assert np.isnan(found.u[0, 4:12]).all()


def test_days_of_summer_times_begin_and_end_have_23_and_25_hours(tmp_path):
    zone = {"time": {"zone": "Europe/Brussels"}}
    for day, hours in (("2025-03-30", 23), ("2025-10-26", 25), ("2025-06-01", 24)):
        at = pd.date_range(day, periods=hours * 4 + 1, freq="15min", tz="Europe/Brussels")
        df = house(at.size)
        for stamps in (at.tz_localize(None), at.strftime("%Y-%m-%dT%H:%M%z"), at.tz_convert("UTC")):
            found = tf.read_measurements(*written(tmp_path, df.assign(time=stamps), zone)).record
            assert found.n_steps == 4 * hours
            assert found.stamps()[-1] == at[-1]
            np.testing.assert_allclose(found.T_zone_C[0], df["T"], atol=1e-9)


def test_a_clock_without_summer_time_is_recognised(tmp_path):
    df = house(96 * 3, start="2025-03-29")
    with pytest.raises(DataError, match=r"line 106: 2025-03-30 02:00:00 does not exist.*time\.zone: Etc/GMT-1"):
        tf.read_measurements(*written(tmp_path, df, {"time": {"zone": "Europe/Brussels"}}))
    found = tf.read_measurements(*written(tmp_path, df, {"time": {"zone": "Etc/GMT-1"}}))
    assert found.record.n_steps == 96 * 3 - 1
    autumn = house(96 * 3, start="2025-10-25")
    with pytest.raises(DataError, match="comes twice in Europe/Brussels"):
        tf.read_measurements(*written(tmp_path, autumn, {"time": {"zone": "Europe/Brussels"}}))


@pytest.mark.parametrize(("offset", "days", "flagged"), [(2.5, 0, False), (-3.0, 0, False), (12.0, 2, True)])
def test_a_night_is_no_stuck_sensor(offset, days, flagged):
    df = house(periods=576)
    hour = df.index.to_numpy() / 4 % 24
    df["sun"] = np.maximum(300.0 * np.cos(2 * np.pi * (hour - 12) / 24) - 100.0, 0.0) + offset
    df.loc[100 : 100 + 96 * days, "sun"] = offset  # days without light
    found = tf.read_measurements(df, BASE | {"sun": "sun"})
    sun = next(signal for signal in found.understood.signals if signal.key == "sun")
    assert [flag.rule for flag in sun.flags] == (["frozen"] if flagged else [])


@pytest.mark.parametrize("column", ["T bath", "Temp_hall", "Zimmer 2"])
def test_a_room_outside_the_map_is_said(column):
    df = house()
    assert not tf.read_measurements(df, BASE).understood.beside
    df[column] = df["T"] - 1.5
    df["T_set"], df["T_flow"], df["T fixed"] = 21.0 + df["u"], 45.0 + df["u"], 20.0
    (words,) = tf.read_measurements(df, BASE).understood.beside
    assert words.startswith(f"neighbours left out: {column} looks like a room beside room")
    zones = BASE["zones"] | {"other": {"temperature": column}}
    actuators = {"heater": {"zone": "room", "level": "u"}}
    assert not tf.read_measurements(df, BASE | {"zones": zones, "actuators": actuators}).understood.beside


def test_impossible_stuck_and_isolated_readings_are_flagged_and_the_rules_can_be_changed(tmp_path):
    df = house(480)
    df.loc[100, "T"] = 31.0
    df.loc[200, "T"] = -200.0
    df.loc[300:420, "out"] = 3.0
    found = tf.read_measurements(*written(tmp_path, df))
    assert np.isnan(found.record.T_zone_C[0, [100, 200]]).all()
    assert np.isnan(found.record.T_out_C[300:421]).all()
    flags = {(s.key, flag.rule): flag for s in found.understood.signals for flag in s.flags}
    assert set(flags) == {
        ("zones.room.temperature", "range"),
        ("zones.room.temperature", "jump"),
        ("outdoor", "frozen"),
    }
    assert "31 °C at 2025-01-11 01:00:00" in flags["zones.room.temperature", "jump"].first
    assert flags["outdoor", "frozen"].count == 121
    lenient = {
        "outdoor": {"column": "out", "stuck_h": 0},
        "zones": {"room": {"temperature": {"column": "T", "spike": 30, "range": [-300, 60]}}},
    }
    loose = tf.read_measurements(*written(tmp_path, df, lenient)).record
    assert loose.T_zone_C[0, 100] == 31.0
    assert np.isfinite(loose.T_out_C).all()


def test_many_files_csv_and_parquet_are_one_record(tmp_path):
    df = house()
    _, rules = written(tmp_path, df.iloc[96:], name="b.csv")
    df.iloc[:96].to_csv(tmp_path / "c.csv", index=False, sep=";", decimal=",")
    df.to_parquet(tmp_path / "all.parquet", index=False)
    df.set_index("time").to_parquet(tmp_path / "indexed.parquet")
    whole = tf.read_measurements(tmp_path / "all.parquet", rules).record
    np.testing.assert_allclose(whole.T_zone_C[0], df["T"])
    np.testing.assert_array_equal(tf.read_measurements(tmp_path / "indexed.parquet", rules).record.u, whole.u)
    named = tmp_path / "named.yaml"
    named.write_text(yaml.safe_dump(BASE | {"time": {**BASE.get("time", {}), "column": "time"}}))
    np.testing.assert_array_equal(tf.read_measurements(tmp_path / "indexed.parquet", named).record.u, whole.u)
    two = written(tmp_path, df.iloc[:96], name="a.csv")[1]
    np.testing.assert_allclose(tf.read_measurements(str(tmp_path / "[ab].csv"), two).record.T_zone_C, whole.T_zone_C)
    german = yaml.safe_dump(BASE | {"csv": {"decimal": ","}})
    (tmp_path / "german.yaml").write_text(german)
    np.testing.assert_allclose(
        tf.read_measurements(tmp_path / "c.csv", tmp_path / "german.yaml").record.T_zone_C[0], df["T"][:96]
    )


def test_the_sun_may_be_estimated(tmp_path):
    df = house(97, start="2025-06-21")
    clear = {"time": {"zone": "Etc/GMT-1"}, "site": {"latitude": 50.8, "longitude": 4.4}}
    found = tf.read_measurements(*written(tmp_path, df, clear | {"sun": {"estimate": "clear_sky"}}))
    sun = found.record.solar_W_m2
    assert sun[0] == 0.0
    assert 800 < sun.max() < 1000
    assert 50 <= sun.argmax() <= 52, "noon at 4.4° east is 12:42 by UTC+1"
    assert any("clear sky" in told for told in found.understood.assumed)
    none = tf.read_measurements(*written(tmp_path, df))
    assert not none.record.solar_W_m2.any()
    assert any("no irradiance" in told for told in none.understood.missing)
    with pytest.raises(ConfigError, match=r"sun\.estimate needs site"):
        tf.read_measurements(*written(tmp_path, df, {"sun": {"estimate": "clear_sky"}}))


def broken(df: pd.DataFrame, **cells) -> pd.DataFrame:
    df = df.astype(object)
    for name, (row, value) in cells.items():
        df.loc[row, name] = value
    return df


CASES = {
    "kelvin": (lambda d: d.assign(T=d["T"] + 273.15), {}, r"zones\.room\.temperature \(column T\).*set unit: 'K'"),
    "fahrenheit": (lambda d: d.assign(T=d["T"] * 1.8 + 32), {}, "set unit: '°F'"),
    "percent": (lambda d: d.assign(u=100 * d["u"]), {}, r"actuators\.heater\.level.*set unit: '%'"),
    "shuffled": (lambda d: d.iloc[[0, 1, 3, 2, *range(4, 192)]], {}, r"line 5: .*comes after.*time\.order: sort"),
    "twice": (lambda d: d.iloc[[0, 1, 1, *range(2, 192)]], {}, r"line 4: .*line 3 too.*time\.duplicates"),
    "text": (lambda d: broken(d, T=(7, "warm")), {}, r"line 9: column 'T' holds 'warm'"),
    "no column": (lambda d: d.rename(columns={"T": "Tt"}), {}, r"no column 'T', did you mean 'Tt'\?"),
    "no rows": (lambda d: d.iloc[:0], {}, "has no rows"),
    "one row": (lambda d: d.iloc[:1], {}, "fewer than 2 steps"),
    "bad stamp": (lambda d: broken(d, time=(9, "soon")), {}, r"line 11: 'soon' is no time stamp"),
    "no stamp": (lambda d: broken(d, time=(9, None)), {}, r"line 11: the time stamp is empty"),
    "day first": (lambda d: d.assign(time=d["time"].dt.strftime("%d/%m/%Y %H:%M")), {}, r"line 2: .*set time\.format"),
    "numbers": (lambda d: d.assign(time=range(192)), {}, r"numbers.*set time\.unit"),
    "microseconds for seconds": (
        lambda d: d.assign(time=[1.7e15 + 9e8 * k for k in range(192)]),
        {"time": {"unit": "s", "since": "1970-01-01"}},
        r"line 193: the time stamp 1700171900000000 is no date, read in s since 1970-01-01: check time\.unit",
    ),
    "an endless stamp": (
        lambda d: d.assign(time=[np.inf if k == 5 else 900.0 * k for k in range(192)]),
        {"time": {"unit": "s", "since": "2025-01-01"}},
        "line 7: the time stamp is inf; remove the row",
    ),
    "since nothing": (lambda d: d, {"time": {"unit": "s", "since": ""}}, "time: since is no date"),
    "since no hour": (
        lambda d: d,
        {"time": {"zone": "Europe/Brussels", "unit": "s", "since": "2024-03-31 02:30"}},
        "since does not exist in Europe/Brussels, where summer time begins: 2024-03-31 02:30",
    ),
    "of no column": (lambda d: d, {"outdoor": {"column": []}}, "outdoor: column: name one at least"),
    "two offsets": (
        lambda d: d.assign(time=[f"{t:%Y-%m-%d %H:%M}+0{1 + (i > 90)}:00" for i, t in enumerate(d["time"])]),
        {},
        r"line 93: .*offsets \+01:00 and \+02:00.*time\.zone",
    ),
    "some offsets": (
        lambda d: d.assign(time=[f"{t:%Y-%m-%d %H:%M}{'Z' * (i > 90)}" for i, t in enumerate(d["time"])]),
        {},
        r"line 93: .*two clocks in one table",
    ),
    "zone": (lambda d: d, {"time": {"zone": "Europe/Brussel"}}, r"time\.zone: no such time zone"),
    "unknown key": (lambda d: d, {"outdor": "out"}, "outdor: unknown key, did you mean 'outdoor'"),
    "a zone called as a tag": (
        lambda d: d,
        {"zones": {"room": {"temperature": {"column": "T", "unit": "R", "range": [5]}}}},
        r"line \d: zones\.room\.temperature\.unit: Input should be '°C'",
    ),
    "bounds in °F": (
        lambda d: d,
        {"zones": {"room": {"temperature": "T", "lower": 68, "upper": 75}}},
        r"zones\.room\.lower: 68 is no comfort bound in °C, between -30 and 60: convert °F or K",
    ),
    "bounds ahead in K": (lambda d: d, {"forecast": {"lower": 294.0}}, r"forecast\.lower: 294 is no comfort bound"),
    "unknown unit": (lambda d: d, {"outdoor": {"column": "out", "unit": "R"}}, r"outdoor\.unit"),
    "no such zone": (
        lambda d: d,
        {"actuators": {"h": {"zone": "x", "level": "u"}}},
        r"actuators\.h\.zone: there is no",
    ),
    "same column": (lambda d: d, {"outdoor": "T"}, r"zones\.room\.temperature and outdoor are the same column"),
    "lost stamp": (lambda d: broken(d, time=(0, "1970-01-01 00:00:00")), {}, "55 years .* mend the time stamp"),
    "a code": (lambda d: d.assign(T=d["T"].where(d.index % 4 > 0, -127.0)), {}, r"missing: \['-127'\]"),
    "never ran": (lambda d: d.assign(P=0.0), {"actuators": {"h": {}}}, "never above 0 W"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_message_that_says_where_and_what_to_do(case, tmp_path):
    change, changes, message = CASES[case]
    with pytest.raises((DataError, ConfigError), match=f"(?s){message}"):
        tf.read_measurements(*written(tmp_path, change(house()), changes))


def _exports(tmp_path: Path, parts: list[pd.DataFrame]) -> tuple[list[Path], Path]:
    """Files that an export left, in the order of their names, and their map."""
    _, rules = written(tmp_path, house())
    files = [tmp_path / f"export{k}.csv" for k in range(len(parts))]
    for path, part in zip(files, parts, strict=True):
        part.to_csv(path, index=False)
    return files, rules


def test_exports_that_overlap_and_say_the_same_are_one(tmp_path):
    """They needed two tries: an order, and which of two rows counts, though both are the same."""
    df = house()
    files, rules = _exports(tmp_path, [df.iloc[:100], df.iloc[90:], df.iloc[20:40]])
    files[2].write_text(files[2].read_text().replace(f"{df['T'].iloc[25]}", "", 1))  # says nothing of that
    found, whole = tf.read_measurements(files, rules), tf.read_measurements(*written(tmp_path, df))
    np.testing.assert_array_equal(found.record.T_zone_C, whole.record.T_zone_C)
    assert found.understood.rows == 192
    said = [text for text in found.understood.assumed if "overlap" in text]
    assert len(said) == 1
    assert re.search(r"export0\.csv and .*export2\.csv overlap from .*: 30 rows in both, which say the same", said[0])


def test_exports_that_overlap_and_differ_are_refused_with_what_both_say(tmp_path):
    df = house()
    files, rules = _exports(tmp_path, [df.iloc[:100], broken(df.iloc[90:], T=(92, 21.25))])
    message = r"export1\.csv, line 4: .* stands at .*export0\.csv, line 94 too, and T is 21\.25 here and 20\.92 there; "
    message += r"the files overlap in 10 rows, of which 1 differ: .*time\.duplicates: first"
    with pytest.raises(DataError, match=message):
        tf.read_measurements(files, rules)
    for which, value in (("first", df["T"].iloc[92]), ("last", 21.25)):
        found = tf.read_measurements(files, BASE | {"time": {"duplicates": which}})
        assert found.record.T_zone_C[0, 92] == value
    files, rules = _exports(tmp_path, [df.iloc[:100], df.iloc[90:].assign(time=df["time"] + pd.Timedelta("3min"))])
    with pytest.raises(DataError, match=r"sort the table, .*export0\.csv and .*export1\.csv overlap: cut one"):
        tf.read_measurements(files, rules)


def test_lines_with_other_than_all_cells_are_refused(tmp_path):
    path, rules = written(tmp_path, house())
    whole = path.read_text()
    for line in ("2025-01-10 01:00:00,20,04,4.96,0.0,0.0", "2025-01-10 01:00:00,20.04"):
        path.write_text("\n".join([*whole.splitlines()[:5], line, *whole.splitlines()[6:]]))
        with pytest.raises(DataError, match=rf"line 6: has {line.count(',') + 1} cells, the line of column names 5"):
            tf.read_measurements(path, rules)
    path.write_text("\n".join(f"{line}," if k else line for k, line in enumerate(whole.splitlines())))
    assert tf.read_measurements(path, rules).record.n_steps == 191, "a separator at the end of every row"


def test_separators_in_quotes_part_no_cells(tmp_path):
    df = house().assign(note="north, upper floor")
    path, rules = written(tmp_path, df)
    assert tf.read_measurements(path, rules).record.n_steps == 191


@pytest.mark.parametrize("now", [None, NOW])
def test_a_status_behind_a_number_says_whether_it_is_one(tmp_path, now):
    """As a Niagara station writes it; an overridden one was measured all the same."""
    df, rules = house(40), BASE | {"time": {"zone": "UTC"}}
    same = tf.read_measurements(df, rules, now=now).record.T_zone_C[0]
    df["T"] = [
        f"{T:.2f} °C {{{'fault,down' if k == 7 else 'overridden' if k % 9 == 0 else 'ok'}}}"
        for k, T in enumerate(df["T"])
    ]
    path, _ = written(tmp_path, df)
    found = tf.read_measurements(path, rules, now=now).record.T_zone_C[0]
    assert np.isnan(found[7])
    np.testing.assert_allclose(np.delete(found, 7), np.delete(same, 7), atol=0.011)


@pytest.mark.parametrize("unit", ["", "\xa0°C"])
def test_a_true_minus_sign_is_one(tmp_path, unit):
    df = house(40).assign(out=np.arange(40) / 4 - 5)
    same = tf.read_measurements(df, BASE).record.T_out_C
    df["out"] = [f"{T:.2f}{unit}".replace(".", ",").replace("-", "\u2212") for T in df["out"]]
    path, _ = written(tmp_path, df, sep=";", decimal=",")
    np.testing.assert_allclose(tf.read_measurements(path, BASE | {"csv": {"decimal": ","}}).record.T_out_C, same)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize(
    ("powers", "sure"),
    [
        ([0.0, 645.0, 1500.0, 12350.0], True),  # no decimals are written, and 1,500 would be 1,5
        ([0.5, 645.0, 1501.0, 1234567.0], True),  # 0.5 has the other mark
        ([1501.0, 2350.0, 12345.0, 9999.0], False),
        ([0.0, 645.0, 1501.0, 2351.0], False),
    ],
)
def test_marks_between_thousands_are_read_where_the_column_tells_them(tmp_path, decimal, powers, sure):
    df = house(40)
    powers = np.resize(powers, 40)
    df["P"] = [f"{power:,.10g}" for power in powers]
    if decimal == ",":
        df["P"] = [cell.translate(str.maketrans(",.", ".,")) for cell in df["P"]]
    path, _ = written(tmp_path, df, sep=";", decimal=decimal)
    rules = BASE | {"csv": {"decimal": decimal}}
    if not sure:
        with pytest.raises(DataError, match="which is no number"):
            tf.read_measurements(path, rules)
        return
    np.testing.assert_array_equal(tf.read_measurements(path, rules).record.power_W[0], powers[:-1])
    live = tf.read_measurements(path, rules | {"time": {"zone": "UTC"}}, now=NOW)
    np.testing.assert_array_equal(live.record.power_W[0], powers[:-1])


@pytest.mark.parametrize("quoted", [False, True])
def test_exports_joined_end_to_end_are_one_table(tmp_path, quoted):
    path, rules = written(tmp_path, house())
    header, *rows = path.read_text().splitlines()
    header = ",".join(f'"{name}"' for name in header.split(",")) if quoted else header
    path.write_text("\n".join([header, *rows[:90], header, *rows[90:]]) + "\n")
    assert tf.read_measurements(path, rules).record.n_steps == 191
    assert "FILL IN" not in starting_map(path)


RULES_UTC = MeasurementMap.model_validate(BASE | {"time": {"zone": "UTC"}})


@pytest.mark.parametrize("now", [None, NOW])
@pytest.mark.parametrize("one_a_row", [False, True])
def test_what_cells_say_of_their_unit_counts(tmp_path, now, one_a_row):
    """The map takes W and shares where cells say W below a kilowatt, kW above, and %: never 1000 times too little."""
    df = house(40)
    powers, levels = df["P"].to_numpy() + 300, df["u"].to_numpy()
    df["P"] = [f"{power / 1000:.3f} kW" if power > 999 else f"{power:.0f} W" for power in powers]
    df["u"] = [f"{100 * level:.0f} %" for level in levels]
    rules = BASE | {"time": {"zone": "UTC"}}
    if one_a_row:
        df = df.melt("time").sort_values("time", kind="stable")
        rules |= {"table": {"point": "variable", "value": "value"}}
    df.to_csv(tmp_path / "house.csv", index=False)
    for files in (tmp_path / "house.csv", df):
        record = tf.read_measurements(files, rules, now=now).record
        np.testing.assert_allclose(record.power_W[0, :38], powers[:38])
        np.testing.assert_allclose(record.u[0, :38], levels[:38])


def test_cells_of_what_the_map_does_not_mean_are_refused(tmp_path):
    df = house(40)
    df["T"] = [f"{T:.1f} kWh" for T in df["T"]]
    path, _ = written(tmp_path, df)
    told = r"house\.csv, line 2: column 'T' holds '20\.0 kWh', which says kWh, and its unit in the map is °C"
    with pytest.raises(DataError, match=told):
        tf.read_measurements(path, BASE)
    left_out = tf.read_measurements(path, BASE | {"time": {"zone": "UTC"}}, now=NOW).left_out
    assert any("column 'T' says kWh, and its unit in the map is °C" in note for note in left_out)
    points = {point.key: point for point in read_points(path, RULES_UTC, NOW)}
    problem = points["zones.room.temperature"].problem
    assert re.match(r"never a number: .*column 'T' says kWh, and its unit in the map is °C", problem), problem


def test_a_starting_map_has_the_unit_of_the_cells(tmp_path):
    df = house(40)
    df["P"] = [f"{power / 1000:.3f} kW" for power in df["P"]]
    df = df.rename(columns={"T": "Living room", "out": "Outdoor temperature", "P": "Power (W)"})
    df.to_csv(tmp_path / "house.csv", index=False)
    assert "power: {column: 'Power (W)', unit: 'kW'}" in starting_map(tmp_path / "house.csv")


# Of a row: what is told, of which column, and what one of the unit in the map is of it.
TOLD = (
    ("kW", "P", lambda W: W / 1000), ("mW", "P", lambda W: 1000 * W), ("BTU/h", "P", lambda W: W / 0.29307107),
    ("kcal/h", "P", lambda W: W / 1.163), ("%", "u", lambda u: 100 * u), ("°F", "T", lambda C: 1.8 * C + 32),
    ("K", "out", lambda C: C + 273.15), ("°R", "T", lambda C: 1.8 * (C + 273.15)), ("℃", "T", lambda C: C),
    ("GJ", "E", lambda kWh: kWh / 277.777778), ("MJ", "E", lambda kWh: 3.6 * kWh), ("Wh", "E", lambda kWh: 1000 * kWh),
    ("Mcal", "E", lambda kWh: kWh / 1.163), ("SEK/kWh", "price", lambda p: p), ("öre/kWh", "price", lambda p: 100 * p),
    ("EUR/MWh", "price", lambda p: 1000 * p), ("kW/m2", "sun", lambda W: W / 1000),
    ("BTU/(h⋅ft²)", "sun", lambda W: W / 3.154591),
)  # fmt: skip


@pytest.mark.parametrize(("unit", "column", "as_told"), TOLD, ids=[one[0] for one in TOLD])
@pytest.mark.parametrize("in_cells", [False, True])
def test_what_is_told_in_another_unit_of_the_same_is_converted(unit, column, as_told, in_cells):
    """As Home Assistant's `unit_of_measurement`, and as cells of a file."""
    df = house(40)
    df["E"], df["price"], df["sun"] = df["P"].cumsum() / 4000, 0.25 + 0.001 * np.arange(40), 10.0 * np.arange(40)
    power = {"column": "E", "unit": "kWh counter"} if column == "E" else "P"
    rules = BASE | {"machines": {"grid": {"power": power, "price": "price"}}, "time": {"zone": "UTC"}, "sun": "sun"}
    told = df.assign(**{column: as_told(df[column])})
    if in_cells:
        told[column] = [f"{value:.6f} {unit}" for value in told[column]]
    else:
        told.attrs["units"] = {column: unit}
    found, same = (tf.read_measurements(one, rules) for one in (told, df))
    for signal in ("T_zone_C", "T_out_C", "u", "power_W", "solar_W_m2"):
        np.testing.assert_allclose(getattr(found.record, signal), getattr(same.record, signal), atol=2e-4, rtol=1e-4)
    np.testing.assert_allclose(found.conditions.price_per_kWh, same.conditions.price_per_kWh, rtol=1e-5)


@pytest.mark.parametrize("now", [None, NOW])
@pytest.mark.parametrize(
    ("unit", "what"), [("gal", "which is not known"), ("ft³", "which is not known"), ("kWh", "which is no power")]
)
def test_what_is_told_in_no_such_unit_is_refused_with_what_to_do(unit, what, now):
    df = house(40)
    df.attrs["units"] = {"P": unit, "another": "imp"}
    rules = BASE | {"time": {"zone": "UTC"}}
    with pytest.raises(DataError, match=f"column 'P' is told in {unit}, {what}, and its unit in the map is W: name"):
        tf.read_measurements(df, rules, now=now)
    df.attrs["units"] = {"P": unit, "out": "imp"}
    with pytest.raises(DataError, match=rf"'P' is told in {unit}, .* is W; column 'out' is told in imp, which is not"):
        tf.read_measurements(df, rules, now=now)
    df.attrs["units"] = {"P": unit}
    as_it_stands = rules | {"machines": {"grid": {"power": {"column": "P", "factor": 1}, "price": 0.3}}}
    found = tf.read_measurements(df, as_it_stands, now=now).record.power_W
    np.testing.assert_array_equal(found, tf.read_measurements(house(40), rules, now=now).record.power_W)


def test_words_of_a_device_are_to_get_their_numbers(tmp_path):
    """As of a mode, which is asked for: 'heat' does not say that it heats; the advice can be followed."""
    df = house(40)
    df["u"] = ["heat" if level else "idle" for level in df["u"]]
    path, _ = written(tmp_path, df)
    with pytest.raises(DataError, match=r"'heat', .*; if it says .* csv: \{words: \{heat: NUMBER\}\} in the map; if"):
        tf.read_measurements(path, BASE)
    told = tf.read_measurements(path, BASE | {"csv": {"words": {"heat": 1}}}).record.u
    np.testing.assert_array_equal(told, tf.read_measurements(house(40), BASE).record.u)


@pytest.mark.parametrize("now", [None, NOW])
@pytest.mark.parametrize("long", [False, True])
def test_what_a_thermostat_says_that_it_does_is_a_level(tmp_path, long, now):
    """As of `zigbee2mqtt/hall#running_state`, and the `hvac_action` of a climate entity."""
    df, same = house(40), tf.read_measurements(house(40), BASE | {"time": {"zone": "UTC"}}, now=now).record.u
    for name, on in (("zigbee2mqtt/hall#running_state", "heat"), ("climate.hall.hvac_action", "heating")):
        said = df.assign(u=[on if level else "idle" for level in df["u"]]).rename(columns={"u": name})
        rules = BASE | {"actuators": {"heater": {"level": name}}, "time": {"column": "time", "zone": "UTC"}}
        if long:
            said = said.melt("time", var_name="topic").sort_values("time")
            rules |= {"table": {"point": "topic", "value": "value"}}
        path = tmp_path / "house.csv"
        said.to_csv(path, index=False)
        np.testing.assert_array_equal(tf.read_measurements(path, rules, now=now).record.u, same)


COMMA = BASE | {"csv": {"decimal": ","}}


def test_what_is_no_number_beside_decimal_commas_is_named(tmp_path):
    """Before, one such cell made a complaint of every number with a comma, and 1.002 kWh of a counter was 1 kWh."""
    df = house()
    path, _ = written(tmp_path, df, sep=";", decimal=",")
    text = path.read_text()
    path.write_text(text.replace(";20,04;", ";***;", 1))
    with pytest.raises(DataError, match=r"line 6: column 'T' holds '\*\*\*', which is no number; if it stands for"):
        tf.read_measurements(path, COMMA)
    found = tf.read_measurements(path, COMMA | {"csv": {"decimal": ",", "missing": ["***"]}})
    np.testing.assert_allclose(found.record.T_zone_C[0, 5], 20.05)
    df.assign(P=[f"{0.998 + k / 1000:.3f}" for k in range(192)]).to_csv(path, sep=";", decimal=",", index=False)
    with pytest.raises(DataError, match=r"line 2: column 'P' holds '0\.998'.*without marks between thousands"):
        tf.read_measurements(path, COMMA)


@pytest.mark.parametrize(("decimal", "cell"), [(",", "1.002,5"), (".", "1,002.5")])
def test_a_number_with_both_marks_can_be_read_in_one_way_only(tmp_path, decimal, cell):
    df = house().assign(P=[cell, "3" + decimal + "5"] * 96)
    path, _ = written(tmp_path, df, sep=";", decimal=decimal)
    found = tf.read_measurements(path, BASE | {"csv": {"decimal": decimal}})
    np.testing.assert_allclose(np.unique(found.record.power_W[0]), [3.5, 1002.5])


def test_any_end_of_line_and_cells_of_any_length(tmp_path):
    path, rules = written(tmp_path, house())
    text = path.read_text()
    for end in ("\r", "\r\n"):
        path.write_bytes(text.replace("\n", end).encode())
        assert tf.read_measurements(path, rules).record.n_steps == 191
    path.write_text("x" * 200_000)
    with pytest.raises(DataError, match=r"house\.csv: cannot be read as CSV \(field larger"):
        tf.read_measurements(path, rules)


def test_columns_without_a_name_or_with_two(tmp_path):
    df = house()
    path, rules = written(tmp_path, df)
    df.set_index("time").rename_axis(None).to_csv(path)
    assert path.read_text().startswith(",T,out")
    np.testing.assert_allclose(tf.read_measurements(path, rules).record.T_zone_C[0], df["T"])
    path.write_text(path.read_text().replace(",T,out,", ', "T" , out,', 1))
    np.testing.assert_allclose(tf.read_measurements(path, rules).record.T_out_C, df["out"])
    df.rename(columns={"P": "T"}).to_csv(path, index=False)
    with pytest.raises(DataError, match=r"no column 'T', but 'T 1', 'T 2' .columns of the same name are numbered"):
        tf.read_measurements(path, BASE | {"machines": {}})


def test_excursions_are_flagged_and_lasting_jumps_are_told():
    away, moved, endless = house(), house(), house()
    away.loc[20:30, "T"] += 12.0
    moved.loc[100:, "T"] += 12.0
    endless.loc[7, "P"] = np.inf
    found = tf.read_measurements(away, BASE)
    assert np.isnan(found.record.T_zone_C[0, 20:31]).all()
    assert np.isfinite(found.record.T_zone_C[0, [19, 31]]).all()
    found = tf.read_measurements(moved, BASE)
    assert np.isfinite(found.record.T_zone_C).all()
    room = next(s for s in found.understood.signals if s.key == "zones.room.temperature")
    assert "the largest of 12 °C" in room.doubt
    found = tf.read_measurements(endless, BASE)
    assert np.isnan(found.record.power_W[0, 7])
    assert [f.first for s in found.understood.signals for f in s.flags] == ["an infinite one at 2025-01-10 01:45:00"]


def test_a_level_in_shares_that_is_said_to_be_in_percent_is_doubted():
    found = tf.read_measurements(house(), BASE | {"actuators": {"heater": {"level": {"column": "u", "unit": "%"}}}})
    level = next(s for s in found.understood.signals if s.key == "actuators.heater.level")
    assert level.doubt == "never above 0.01: check the unit, 0-1 is likelier than %"


@pytest.mark.parametrize(("signal", "doubted"), [("P_Wh", True), ({"column": "P_Wh", "unit": "W"}, False)])
def test_a_column_named_by_energy_is_doubted_where_no_unit_is_given(signal, doubted):
    table = house().rename(columns={"P": "P_Wh"})
    found = tf.read_measurements(table, BASE | {"machines": {"hp": {"power": signal}}})
    power = next(s for s in found.understood.signals if s.key == "machines.hp.power")
    assert ("its name says energy: name the unit" in power.doubt) is doubted


def test_a_column_of_prices_in_cents_is_doubted():
    found = tf.read_measurements(house().assign(tariff=26.0), BASE | {"machines": {"hp": {"price": "tariff"}}})
    price = next(s for s in found.understood.signals if s.key == "machines.hp.price")
    assert "in cents, or in another currency? Set unit: per MWh or cent per kWh, or a factor" in price.doubt


def test_files_of_different_clocks_are_refused(tmp_path):
    df = house()
    winter = df.assign(time=[f"{t:%Y-%m-%d %H:%M}+01:00" for t in df["time"]])
    a, rules = written(tmp_path, winter.iloc[:96], name="a.csv")
    b, _ = written(tmp_path, df.iloc[96:], name="b.csv")
    with pytest.raises(DataError, match=r"b\.csv: its time stamps have no time zone"):
        tf.read_measurements([a, b], rules)
    summer = df.iloc[96:].assign(time=[f"{t:%Y-%m-%d %H:%M}+02:00" for t in df["time"].iloc[96:]])
    c, _ = written(tmp_path, summer, name="c.csv")
    with pytest.raises(DataError, match=r"c\.csv: its time stamps have the offset UTC\+02:00"):
        tf.read_measurements([a, c], rules)
    named = {**BASE, "time": {"zone": "Europe/Brussels", "duplicates": "first", "order": "sort"}}
    assert tf.read_measurements([a, c], named).understood.zone == "Europe/Brussels"


def test_stamps_at_the_end_of_intervals_shift_what_acts_only():
    df = house()
    begun, ended = (
        tf.read_measurements(df, BASE | {"time": {"marks": marks}, "machines": {"g": {"power": energy}}}).record
        for marks, energy in (("start", "P"), ("end", {"column": "P", "unit": "Wh per step", "factor": 0.25}))
    )
    np.testing.assert_array_equal(begun.T_zone_C, ended.T_zone_C)
    np.testing.assert_allclose(ended.u[0], df["u"][1:])
    np.testing.assert_allclose(ended.power_W[0], df["P"][1:])
    np.testing.assert_allclose(begun.power_W[0], df["P"][:-1])


def test_a_counter_that_starts_anew_is_flagged():
    df = house()
    df["meter"] = df["P"].cumsum() / 4
    df.loc[100:, "meter"] -= df.loc[100, "meter"]
    found = tf.read_measurements(df, BASE | {"machines": {"g": {"power": {"column": "meter", "unit": "Wh counter"}}}})
    flags = [flag for s in found.understood.signals for flag in s.flags]
    assert [(flag.rule, flag.count) for flag in flags] == [("counter", 1)]
    np.testing.assert_allclose(np.delete(found.record.power_W[0], 99), np.delete(df["P"].to_numpy()[1:], 99))


@pytest.mark.parametrize(
    ("wrong", "rows", "unknown", "said"),
    [
        (0.0, [100], 2, "fell below the one before and came back, first at 2025-01-11 01:00"),
        (0.0, [60, 61, 100, 140], 7, "fell below the one before and came back, first at 2025-01-10 15:00"),
        (9.9e6, [100], 2, "rises of more than 10 times the usual largest"),
    ],
)
def test_wrong_readings_of_a_counter_are_no_energy(wrong, rows, unknown, said):
    """Before, a single 0 counted all that the meter had ever counted once more."""
    df = house()
    df["meter"] = 150_000.0 + df["P"].cumsum() / 4
    df.loc[rows, "meter"] = wrong
    found = tf.read_measurements(df, BASE | {"machines": {"g": {"power": {"column": "meter", "unit": "Wh counter"}}}})
    flags = [flag for s in found.understood.signals for flag in s.flags]
    assert any(said in flag.first for flag in flags)
    power = found.record.power_W[0]
    assert np.nanmax(power) == pytest.approx(1500.0)
    assert np.isnan(power[:-1]).sum() <= unknown


def test_the_code_of_a_meter_for_no_reading_is_no_energy_of_a_step():
    """65535 kWh in a quarter of an hour are 262 MW, and were believed."""
    df = house()
    df["E"] = (df["P"] / 4000.0).where(df.index != 100, 65535.0)
    rules = BASE | {"machines": {"g": {"power": {"column": "E", "unit": "kWh per step"}}}}
    found = tf.read_measurements(df, rules)
    (flag,) = (flag for s in found.understood.signals for flag in s.flags)
    assert (flag.rule, flag.count) == ("energy", 1)
    assert flag.first.endswith("wrong readings, first at 2025-01-11 01:00:00")
    assert np.isnan(found.record.power_W[0, 100])
    np.testing.assert_allclose(np.delete(found.record.power_W[0], 100), np.delete(df["P"].to_numpy()[:-1], 100))


@pytest.mark.parametrize("unit", ["kWh per step", "kWh counter"])
def test_a_machine_that_ran_once_in_a_short_table_took_its_energy(unit):
    energy = np.where(np.arange(40) == 30, 0.6, 0.002)
    df = house(periods=40).assign(E=energy.cumsum() if unit.endswith("counter") else energy)
    found = tf.read_measurements(df, BASE | {"machines": {"g": {"power": {"column": "E", "unit": unit}}}})
    assert not [flag for s in found.understood.signals for flag in s.flags]
    assert np.nanmax(found.record.power_W[0]) == pytest.approx(2400.0)


@pytest.mark.parametrize("unit", ["kWh per step", "kWh counter"])
@pytest.mark.parametrize(
    ("standby_W", "runs_W", "wrong"),
    [(6.0, [3000.0] * 9, 0), (200.0, [80e3, 82e3, 84e3, 85e3], 0), (200.0, [262e6] * 4, 4), (2000.0, [25e3], 1)],
    ids=["heater", "boiler of a school", "code", "glitch"],
)
def test_what_a_machine_that_rests_nearly_always_takes_is_its_energy(unit, standby_W, runs_W, wrong):
    """Runs in less than one of a hundred steps lie beyond all percentiles that tell wrong readings of others."""
    power_W = np.full(1200, standby_W)
    power_W[100 : 100 * (len(runs_W) + 1) : 100] = runs_W
    energy = power_W / 4000.0
    df = house(periods=1200).assign(E=energy.cumsum() if unit.endswith("counter") else energy)
    found = tf.read_measurements(df, BASE | {"machines": {"g": {"power": {"column": "E", "unit": unit}}}})
    assert sum(flag.count for s in found.understood.signals for flag in s.flags) == wrong
    assert np.nanmax(found.record.power_W[0]) == pytest.approx(standby_W if wrong else max(runs_W))


def test_a_counter_that_begins_anew_each_day_keeps_its_energy():
    df = house(periods=385)
    day = df["time"].dt.day
    df["meter"] = (df["P"] / 4).groupby(day).cumsum()
    found = tf.read_measurements(df, BASE | {"machines": {"g": {"power": {"column": "meter", "unit": "Wh counter"}}}})
    expected = df["P"].to_numpy()[1:]
    known = np.isfinite(found.record.power_W[0])
    np.testing.assert_allclose(found.record.power_W[0][known], expected[known])
    assert known.sum() >= expected.size - 5


def test_mended_by_the_rules_that_the_messages_name(tmp_path):
    df = house()
    mixed = df.iloc[[0, 1, 3, 2, 4, 4, *range(5, 192)]]
    rules = {"time": {"order": "sort", "duplicates": "first"}}
    found = tf.read_measurements(*written(tmp_path, mixed, rules))
    np.testing.assert_allclose(found.record.T_zone_C[0], df["T"], atol=1e-9)
    assert len([told for told in found.understood.assumed if "line" in told]) == 2


def test_files_that_are_none_or_too_large_are_refused(tmp_path):
    path, rules = written(tmp_path, house())
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01" * 9)
    (tmp_path / "fake.parquet").write_text("no parquet")
    for name, message in (
        ("empty.csv", "the file is empty"),
        ("bytes.csv", "utf-8"),
        ("fake.parquet", "no Parquet file"),
        ("nothing.csv", "no such file"),
        (".", "is a folder"),
    ):
        with pytest.raises(DataError, match=message):
            tf.read_measurements(tmp_path / name, rules)
    with pytest.raises(DataError, match="no Parquet file"):
        starting_map(str(tmp_path / "fake.parquet"))
    with pytest.raises(DataError, match=r"0\.0 GB to read, at most 0\.0 GB are read at once"):
        tf.read_measurements(path, rules, most_bytes=100)
    with (tmp_path / "huge.csv").open("wb") as huge:
        huge.truncate(10_000_000_000)  # sparse: takes no room
    with pytest.raises(DataError, match=r"huge\.csv: 10\.0 GB to read"):
        tf.read_measurements(tmp_path / "huge.csv", rules)
    with pytest.raises(ConfigError, match="no such file"):
        tf.read_measurements(path, tmp_path / "other.yaml")


@pytest.mark.parametrize(("suffix", "packed"), [(".gz", gzip.compress), (".bz2", bz2.compress), (".xz", lzma.compress)])
def test_a_packed_file_that_was_damaged_is_named(suffix, packed, tmp_path):
    _, rules = written(tmp_path, house())
    df = house()
    df["T"] += np.random.default_rng(1).uniform(0, 1, len(df))
    content = bytearray(packed(df.to_csv(index=False).encode()))
    content[20:26] = bytes(255 - byte for byte in content[20:26])
    file = tmp_path / f"house.csv{suffix}"
    file.write_bytes(content)
    for read in (lambda: tf.read_measurements(file, rules), lambda: starting_map(file)):
        with pytest.raises(DataError, match=rf"house\.csv{suffix}: cannot be read"):
            read()


def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(
        DataError, match=r"house\.parquet: Parquet needs pyarrow.*pip install 'thermoforce-mpc.parquet.'"
    ):
        read_tables([tmp_path / "house.parquet"], ["T"], lambda _: Written(), [])


def test_a_coarse_counter_that_is_read_often_is_even_between_its_steps():
    """A heat meter of whole kWh, read every 10 min, of a machine of 1.5 to 4.5 kW: as differences, 0 or 6 kW."""
    at = pd.date_range("2026-01-12", periods=3 * 144 + 1, freq="10min")
    power_W = 3000.0 + 1500.0 * np.sin(np.arange(at.size) / 20.0)
    counted = 812.3 + np.concatenate([[0.0], np.cumsum(power_W[:-1])]) / 6000.0
    df = pd.DataFrame(
        {"T": 21.0 + np.sin(np.arange(at.size) / 9.0), "out": 3.0 + np.cos(np.arange(at.size) / 30.0)}, index=at
    )
    rules = {
        "time": {"zone": "Europe/Berlin"}, "outdoor": "out", "step": "1h", "zones": {"r": {"temperature": "T"}},
        "machines": {"m": {"power": {"column": "meter", "unit": "kWh counter"}}},
    }  # fmt: skip
    fine = tf.read_measurements(df.assign(meter=counted), rules)
    coarse = tf.read_measurements(df.assign(meter=np.floor(counted)), rules)
    truth, read = fine.record.power_W[0], coarse.record.power_W[0]
    assert np.sqrt(np.nanmean((read - truth) ** 2)) < 250.0  # of differences 350
    assert np.nanmax(read) < 5200.0
    assert np.nansum(read) == pytest.approx(np.nansum(truth), abs=1000.0)
    assert any("in steps of 1 is read" in note for note in coarse.understood.assumed)
    assert not any("in steps of" in note for note in fine.understood.assumed)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"outdoor": {"column": "out", "factor": 0}}, "factor: 0 makes every reading 0"),
        ({"outdoor": {"column": "out", "range": [5, 1]}}, "range: the least, 5, is not below the largest, 1"),
        ({"machines": {"m": {"power": "P", "price": 1e300}}}, r"machines.m.price.*no price of every kWh"),
        (
            {"machines": {"m": {"power": "P", "price": -0.25}}},
            r"machines.m.price: -0.25 is no price of every kWh, from 0",
        ),
    ],
)
def test_numbers_of_a_map_that_mean_nothing_are_refused_by_their_key(keys, said):
    df = pd.DataFrame(
        {"T": [21.0] * 9, "out": 3.0, "P": 5.0}, index=pd.date_range("2026-01-12", periods=9, freq="15min")
    )
    with pytest.raises(ConfigError, match=said):
        tf.read_measurements(df, {"outdoor": "out", "zones": {"r": {"temperature": "T"}}} | keys)


def test_a_power_that_no_building_has_is_flagged():
    at = pd.date_range("2026-01-12", periods=96, freq="15min")
    df = pd.DataFrame({"T": 21.0 + np.sin(np.arange(96.0)), "out": 3.0 + np.cos(np.arange(96.0)), "P": 500.0}, index=at)
    df.iloc[8, 2] = -1e12
    rules = {"outdoor": "out", "zones": {"r": {"temperature": "T"}}, "machines": {"m": {"power": "P"}}}
    found = tf.read_measurements(df, rules)
    assert [
        flag.rule for signal in found.understood.signals if signal.key.endswith("power") for flag in signal.flags
    ] == ["range"]
