from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.errors import WeatherError

COLUMNS = 30


def mos_row(hour: int, T: float = 5.0) -> str:
    cells = ["0"] * COLUMNS
    cells[0], cells[1], cells[2], cells[4] = str(hour * 3600.0), str(T), "1.0", "101300"
    cells[8] = "100" if hour % 24 == 12 else "0"
    cells[15], cells[16], cells[18] = "200", "4.0", "5"
    return "\t".join(cells)


def write_mos(path, rows=None, location="#LOCATION,TOWN,-,BEL,IWEC,064510,50.90,4.53,1.0,58.0"):
    rows = rows if rows is not None else [mos_row(h, T=h % 24) for h in range(8760)]
    path.write_text("\n".join(["#1", "double tab1(8760,30)", location, *rows]))
    return path


def epw_row(hour: int, T: float) -> str:
    """Row of the hour that ends `hour + 1` hours into a year of 365 days."""
    date = np.datetime64("2019-01-01") + np.timedelta64(hour // 24, "D")
    cells = ["0"] * 35
    cells[0:5] = [*str(date).split("-"), str(hour % 24 + 1), "0"]
    cells[5], cells[6], cells[7], cells[9] = "?9", str(T), "1", "101300"
    cells[13] = "100" if hour % 24 == 12 else "0"
    cells[20], cells[21], cells[23] = "200", "4", "5"
    return ",".join(cells)


def epw_rows() -> list[str]:
    return [epw_row(h, T=h % 24 + 1) for h in range(8760)]


def write_epw(path, rows=None):
    rows = rows or epw_rows()
    header = ["LOCATION,Town,-,BEL,IWEC,064510,50.90,4.53,1.0,58.0", *["HEADER"] * 7]
    path.write_text("\n".join([*header, *rows]))
    return path


def test_a_mos_file_is_read_at_its_own_hours(tmp_path):
    weather = load_weather(write_mos(tmp_path / "w.mos"))
    np.testing.assert_allclose(weather.at("T_dry_C", np.arange(24) * HOUR_S), np.arange(24), atol=1e-9)
    assert (weather.latitude_deg, weather.longitude_deg, weather.timezone_h) == (50.9, 4.53, 1.0)
    assert weather.opaque_cover[0] == 0.5
    assert weather.wind_from_rad[0] == pytest.approx(np.deg2rad(200))
    assert "sha256" in weather.name


def test_a_fingerprint_tells_values_not_files(tmp_path):
    rows = [mos_row(h, T=h % 24) for h in range(8760)]
    print_of = load_weather(write_mos(tmp_path / "a.mos", rows)).fingerprint
    assert load_weather(write_mos(tmp_path / "b.mos", [row + "\t" for row in rows])).fingerprint == print_of
    rows[5000] = mos_row(5000, T=5000 % 24 + 0.1)
    assert load_weather(write_mos(tmp_path / "c.mos", rows)).fingerprint != print_of


def test_hour_h_of_an_epw_file_is_h_oclock(tmp_path):
    weather = load_weather(write_epw(tmp_path / "w.epw"))
    assert weather.at("T_dry_C", np.array([HOUR_S, 5 * HOUR_S])) == pytest.approx([1, 5])
    assert weather.at("T_dry_C", np.array([0.0])) == pytest.approx(24), (
        "hour 24 of 31 December is where the year begins"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:4000], "4000 hourly rows, a year has 8760; the file is truncated"),
        (lambda rows: [*rows[:10], mos_row(10, T=float("nan")), *rows[11:]], "row 11: a cell is not a number"),
        (lambda rows: [*rows[:10], mos_row(10, T=99), *rows[11:]], "T_dry_C is 99 at day 1, hour 10"),
        (lambda rows: [*rows[:10], rows[10].replace("\t200\t", "\t360.0001\t"), *rows[11:]], "is 360.0001 at day 1"),
        (lambda rows: [*rows[:10], rows[10].replace("101300", "x"), *rows[11:]], "row 11: a cell is not a number"),
        (lambda rows: [*rows[:10], "36000.0\t1\t2", *rows[11:]], "row 11 has 3 columns"),
        (lambda rows: [*rows[:10], *rows[11:], mos_row(8760), mos_row(8761)], "row 11 is at 39600 s, expected 36000"),
        (lambda rows: [*rows, *map(mos_row, range(8760, 8784))], "8784 hourly rows, a year has 8760"),
    ],
)
def test_a_damaged_file_is_refused_with_file_and_place(tmp_path, change, message):
    path = write_mos(tmp_path / "w.mos", change([mos_row(h) for h in range(8760)]))
    with pytest.raises(WeatherError, match=message) as caught:
        load_weather(path)
    assert "w.mos" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:4000], "4000 hourly rows, a year has 8760; the file is truncated"),
        (lambda rows: [*rows, *rows[:24]], "8784 hourly rows, a year has 8760"),
        (lambda rows: [*rows[:10], epw_row(10, T=99), *rows[11:]], "T_dry_C is 99 at day 1, hour 11"),
        (lambda rows: [*rows[:10], rows[10].replace("101300", ""), *rows[11:]], "row 11: a cell is not a number"),
        (lambda rows: [*rows[:10], "2019,1,1,11,0", *rows[11:]], "row 11 has 5 columns"),
        (
            lambda rows: [*rows[:10], *rows[11:], rows[0]],
            "row 11 is .* day 1, hour 12, expected .* hour 11",
        ),
        (lambda rows: [*rows[4344:], *rows[:4344]], "row 1 is month 7, day 1, hour 1, expected month 1, day 1, hour 1"),
    ],
    ids=["truncated", "a day twice", "hot", "empty cell", "short", "gap", "from July"],
)
def test_a_damaged_epw_file_is_refused_with_file_and_place(tmp_path, change, message):
    path = write_epw(tmp_path / "w.epw", change(epw_rows()))
    with pytest.raises(WeatherError, match=message) as caught:
        load_weather(path)
    assert "w.epw" in str(caught.value)


def test_of_a_leap_year_the_29th_of_february_is_left_out(tmp_path):
    rows = epw_rows()
    extra = [",".join(["2020", "02", "29", *row.split(",")[3:6], "40", *row.split(",")[7:]]) for row in rows[:24]]
    leap = load_weather(write_epw(tmp_path / "leap.epw", [*rows[: 59 * 24], *extra, *rows[59 * 24 :]]))
    assert leap.fingerprint == load_weather(write_epw(tmp_path / "w.epw", rows)).fingerprint


@pytest.mark.parametrize(
    ("name", "message"), [("absent.mos", "cannot be read"), ("w.csv", "end in .mos"), ("w.epw", "not an EPW file")]
)
def test_other_files_are_refused(tmp_path, name, message):
    if name == "w.epw":
        (tmp_path / name).write_text("hello")
    with pytest.raises(WeatherError, match=message):
        load_weather(tmp_path / name)


def test_the_synthetic_year_is_deterministic_and_temperate_maritime():
    a, b, other = synthetic_weather(), synthetic_weather(), synthetic_weather(1)
    for name in ("T_dry_C", "global_W_m2", "wind_m_s"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not np.array_equal(a.T_dry_C, other.T_dry_C)
    for year in (a, other):
        assert 9.0 < year.T_dry_C.mean() < 11.5
        assert -15.0 < year.T_dry_C.min() < -3.0
        assert 850 < year.global_W_m2.sum() / 1000 < 1050
        assert (year.T_dew_C <= year.T_dry_C).all()
