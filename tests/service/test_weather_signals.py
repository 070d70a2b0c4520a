"""The weather's points at the wire: against the test case's own records, psychrolib, and what the weather file says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import psychrolib
import pytest

from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.service.points import WEATHER_SIGNALS

psychrolib.SetUnitSystem(psychrolib.SI)


@pytest.fixture(scope="module")
def weather():
    return synthetic_weather()


def signal(name, weather, time_s):
    return WEATHER_SIGNALS[name].at(weather, np.asarray(time_s, dtype=np.float64))


def test_every_recorded_point_of_the_real_test_case_is_met(shared):
    real = pd.read_csv(shared / "boptest_hp" / "boundary_hourly.csv.gz")
    weather = load_weather(shared / "boptest_hp" / "Brussels.mos")
    recorded = [name for name in WEATHER_SIGNALS if name in real]
    assert {"pAtm", "relHum", "nOpa", "nTot", "HHorIR", "HGloHor", "TBlaSky", "solZen", "winDir"} <= set(recorded)
    for name in recorded:
        ours = signal(name, weather, real.time) - (273.15 if name.startswith("T") else 0.0)
        np.testing.assert_allclose(ours, real[name], atol=1.5e-5, err_msg=name)


def test_cover_humidity_infrared_and_ceiling_are_the_files(tmp_path):
    cells = ["0"] * 30
    cells[2], cells[3], cells[4], cells[7] = "4.0", "70", "99000", "301"
    cells[17], cells[18], cells[20] = "8", "3", "1500"
    rows = []
    for hour in range(8760):
        cells[0], cells[1], cells[8] = str(hour * 3600.0), str(9.0 + hour % 2), str(100 * (hour % 24 == 12))
        rows.append("\t".join(cells))
    path = tmp_path / "w.mos"
    path.write_text("\n".join(["#1", "double tab1(8760,30)", "#LOCATION,T,-,B,I,0,50.90,4.53,1.0,58.0", *rows]))
    weather = load_weather(path)
    expected = {"nTot": 0.8, "nOpa": 0.3, "relHum": 0.7, "HHorIR": 301.0, "ceiHei": 1500.0, "pAtm": 101_325.0}
    assert {name: float(signal(name, weather, [5 * HOUR_S])[0]) for name in expected} == pytest.approx(expected)


def test_the_pressure_is_the_constant_of_the_test_case(weather):
    low = dataclasses.replace(weather, pressure_Pa=np.full(8760, 97_000.0))
    np.testing.assert_array_equal(signal("pAtm", low, np.arange(24) * HOUR_S), 101_325.0)


def test_the_hour_angle_goes_on_from_day_to_day(weather):
    time_s = np.arange(0.0, 365 * DAY_S, 1800.0)
    angle, solar_s = signal("solHouAng", weather, time_s), signal("solTim", weather, time_s)
    np.testing.assert_allclose(angle, (solar_s / HOUR_S - 12.0) * 2.0 * np.pi / 24.0)
    np.testing.assert_allclose(np.diff(angle), 2.0 * np.pi / 48.0, rtol=1e-3)
    assert angle[-1] > 364 * 2.0 * np.pi - np.pi


def test_wet_bulb_is_that_of_dry_bulb_humidity_and_pressure(weather):
    time_s = np.arange(0.0, 365 * DAY_S, 7 * HOUR_S + 600.0)
    dry, humidity, pressure = (signal(name, weather, time_s) for name in ("TDryBul", "relHum", "pAtm"))
    expected = psychrolib.GetTWetBulbFromRelHum(dry - 273.15, humidity, pressure) + 273.15
    wet = signal("TWetBul", weather, time_s)
    np.testing.assert_allclose(wet, expected, atol=0.01)
    # At whole hours, where nothing is interpolated, and above freezing, where all conventions mean water.
    hours = np.arange(0.0, 365 * DAY_S, 7 * HOUR_S)
    dry, dew, wet = (signal(name, weather, hours) - 273.15 for name in ("TDryBul", "TDewPoi", "TWetBul"))
    thawed = dew > 0
    by_dew = psychrolib.GetTWetBulbFromTDewPoint(dry[thawed], dew[thawed], 101_325.0)
    np.testing.assert_allclose(wet[thawed], by_dew, atol=0.05)


def test_air_out_of_the_tables_limits_is_still_air(weather):
    """Humidity may be missing (999), or the spline overshoot saturation."""
    odd = np.where(np.arange(8760) % 2, 9.99, 0.0)
    strange = dataclasses.replace(weather, relative_humidity=odd, total_cover=odd, ceiling_m=-odd)
    time_s = np.arange(0.0, DAY_S, 600.0)
    for name, low, high in (("relHum", 0, 1), ("nTot", 0, 1), ("ceiHei", 0, 1e6)):
        values = signal(name, strange, time_s)
        assert ((values >= low) & (values <= high)).all(), name
    wet, dry = signal("TWetBul", strange, time_s), signal("TDryBul", strange, time_s)
    assert np.isfinite(wet).all()
    assert (wet <= dry + 1e-3).all()
