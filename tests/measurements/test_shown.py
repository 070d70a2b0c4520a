"""A starting map reads the table it was made from; the picture shows it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

import thermoforce_mpc as tf
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.picture import draw_measurements
from thermoforce_mpc.measurements.starting_map import starting_map


def test_a_starting_map_reads_its_table(tmp_path):
    row = np.arange(200.0)
    at = pd.date_range("2025-01-10", periods=200, freq="15min")
    df = pd.DataFrame(
        {"when": at, "Living room °C": 20 + row / 100, "bath_temp": 300 + row / 100, "T_ambient": 41 - row / 100}
        | {"GHI": 10.0, "valve_pos": 100 * (row // 8 % 2), "meter kWh": 0.5 * (row // 8 % 2), "count of birds": row}
    )
    df.to_csv(tmp_path / "house.csv", index=False)
    text = starting_map(tmp_path / "house.csv")
    assert "# not used: count of birds" in text
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    found = tf.read_measurements(tmp_path / "house.csv", tmp_path / "map.yaml")
    assert found.record.names.zones == ("living_room", "bath")
    np.testing.assert_allclose(found.record.T_zone_C[:, 0], [20.0, 26.85])
    np.testing.assert_allclose(found.record.T_out_C[0], 41.0)
    np.testing.assert_array_equal(found.record.u[0], (row // 8 % 2)[:-1])
    np.testing.assert_allclose(found.record.power_W.max(), 2000.0)
    (tmp_path / "birds.csv").write_text("when,birds\n2025-01-01,7\n")
    with pytest.raises(DataError, match="none of birds looks like a temperature"):
        starting_map(tmp_path / "birds.csv")


def test_a_map_for_stamps_that_are_numbers_asks_what_they_count_from(tmp_path):
    (tmp_path / "box.csv").write_text("s,T_int,T_ext\n0,20,5\n900,21,5\n1800,22,5\n")
    rules = yaml.safe_load(starting_map(tmp_path / "box.csv"))
    assert rules["time"]["unit"] == "s"
    assert rules["time"]["since"].startswith("FILL IN")


def test_the_picture_is_drawn_whatever_is_missing(tmp_path):
    at = pd.date_range("2025-01-10", periods=200, freq="15min")
    df = pd.DataFrame({"T": 20.0, "out": np.arange(200) / 9, "u": 0.5}, index=at)
    df.iloc[50:90, 0] = np.nan
    df.iloc[120, 0] = 40.0
    base = {"outdoor": "out", "zones": {"room": {"temperature": {"column": "T", "stuck_h": 0}}}}
    for name, rules in {
        "nothing_acts.png": base,
        "level.svg": base | {"actuators": {"heater": {"level": "u"}}, "time": {"zone": "Europe/Brussels"}},
    }.items():
        draw_measurements(tmp_path / name, tf.read_measurements(df, rules), "title")
        assert (tmp_path / name).stat().st_size > 10_000
