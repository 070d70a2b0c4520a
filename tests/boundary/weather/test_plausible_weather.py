"""Weather that no place on Earth can have is refused; weather that is possible but improbable is doubted."""

from __future__ import annotations

import dataclasses
import os
import tracemalloc
import warnings

import numpy as np
import pytest

from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
from thermoforce_mpc.errors import WeatherError
from thermoforce_mpc.files import DoubtfulInput

TOWN = "50.90,4.53,1.0"


@pytest.fixture(scope="module")
def year():
    return synthetic_weather()


def written(path, year, place=TOWN, *, later_h=0, **columns):
    """`year` as a .mos file at a place, with other columns, the sun `later_h` hours later."""
    of = {name: np.broadcast_to(columns.get(name, getattr(year, name)), 8760) for name in ("T_dry_C", "T_dew_C")}
    sun = [np.roll(columns.get(name, getattr(year, name)), later_h) for name in ("global_W_m2", "normal_W_m2")]
    rows = [f"#LOCATION,TOWN,-,BEL,IWEC,064510,{place},58.0"]
    for h in range(8760):
        cells = ["0"] * 30
        cells[0], cells[1], cells[2], cells[4] = f"{h * 3600}", f"{of['T_dry_C'][h]}", f"{of['T_dew_C'][h]}", "101300"
        cells[8], cells[9] = f"{sun[0][h]}", f"{sun[1][h]}"
        rows.append("\t".join(cells))
    path.write_text("\n".join(rows))
    return path


def test_a_year_of_its_place_is_taken_without_a_word(tmp_path, year):
    assert load_weather(written(tmp_path / "w.mos", year)).latitude_deg == 50.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("999,4.53,1.0", "latitude_deg is 999, expected -90 to 90"),
        ("nan,4.53,1.0", "no number in"),
        ("5_0.9,4.53,1.0", "no number in"),
        ("50.9,360,1.0", "longitude_deg is 360, expected -180 to 180"),
        ("50.9,4.53,1e308", r"timezone_h is 1e\+308, expected -12 to 14"),
        ("50.9,4.53,", "time zone missing or no number"),
    ],
)
def test_a_place_that_is_not_on_earth_is_refused(tmp_path, year, place, message):
    with pytest.raises(WeatherError, match=message):
        load_weather(written(tmp_path / "w.mos", year, place))


@pytest.mark.parametrize("T_C", [60.0, -65.0])
def test_a_year_warmer_or_colder_than_any_is_refused(tmp_path, year, T_C):
    with pytest.raises(WeatherError, match=rf"w\.mos: the year's mean temperature is {T_C:.1f} °C, that of no place"):
        load_weather(written(tmp_path / "w.mos", year, T_dry_C=T_C, T_dew_C=0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "later_h"),
    [(TOWN, 12), (TOWN, 5), ("50.9,-120,1.0", 0), ("50.9,4.53,-8", 0)],
    ids=["sun at midnight", "five hours late", "longitude of California", "its time zone"],
)
def test_sun_at_night_is_refused(tmp_path, year, place, later_h):
    with pytest.raises(WeatherError, match=r"% of the year's sun shines in the dark at latitude 50.9"):
        load_weather(written(tmp_path / "w.mos", year, place, later_h=later_h))


def test_an_hour_of_summer_time_is_not_night(tmp_path, year):
    load_weather(written(tmp_path / "w.mos", year, later_h=1))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"global_W_m2": np.zeros(8760), "normal_W_m2": np.zeros(8760)}, "the sun never shines"),
        ({"T_dry_C": np.repeat([10.0, *range(40)], [8720, *[1] * 40])}, "10 °C for 8720 hours from day 1"),
        ({"T_dry_C": 33.0 + np.arange(8760) % 2}, "mean temperature is 33.5 °C: few people live there"),
    ],
)
def test_the_improbable_is_read_and_doubted(tmp_path, year, columns, message):
    with pytest.warns(DoubtfulInput, match=message):
        weather = load_weather(written(tmp_path / "w.mos", year, **columns))
    assert weather.T_dry_C.shape == (8760,)


def test_the_command_line_says_a_doubt_in_one_line(tmp_path, year, monkeypatch, capsys):
    from thermoforce_mpc.cli import main

    path = written(tmp_path / "w.mos", year, global_W_m2=np.zeros(8760), normal_W_m2=np.zeros(8760))
    monkeypatch.setattr("sys.argv", ["tf-mpc", "serve", "--weather", str(path)])
    monkeypatch.setattr("thermoforce_mpc.service.server.serve", lambda year, **options: None)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        main()
    said = [line for line in capsys.readouterr().err.splitlines() if "never shines" in line]
    assert said == [f"Warning: {path}: the sun never shines in it: the columns of irradiance are empty"]


def test_what_is_no_file_or_has_no_end_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.epw")
    os.symlink("/dev/zero", tmp_path / "zero.mos")
    for name in ("pipe.epw", "zero.mos"):
        with pytest.raises(WeatherError, match=f"{name}: not a file"):
            load_weather(tmp_path / name)


@pytest.mark.parametrize(("name", "row"), [("w.mos", "1\n"), ("w.epw", "\n"), ("w.mos", "12 " * 400 + "\n")])
def test_a_long_file_costs_little_more_memory_than_it_has(tmp_path, name, row):
    head = "LOCATION,1,2,3,4,5,50,4,1,0\n#LOCATION,1,2,3,4,5,50,4,1,0\n"
    (tmp_path / name).write_text(head + row * (9_000_000 // len(row)))
    tracemalloc.start()
    try:
        with pytest.raises(WeatherError, match=r"this reader needs hourly rows|truncated"):
            load_weather(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 250e6
    finally:
        tracemalloc.stop()


def test_a_year_on_the_other_hemisphere_has_its_nights_too(tmp_path, year):
    """The half-year shifts, not the day: at 50.9° south the same hours are night, in another season."""
    half = np.roll(np.arange(8760), 182 * 24)
    south = dataclasses.replace(
        year, **{name: getattr(year, name)[half] for name in ("T_dry_C", "T_dew_C", "global_W_m2", "normal_W_m2")}
    )
    load_weather(written(tmp_path / "w.mos", south, "-50.90,4.53,1.0"))
