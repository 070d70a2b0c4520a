"""Weather and price files of any content: a checked year or tariff, or one named error."""

from __future__ import annotations

import gzip
import warnings

import numpy as np
import pytest
from fuzzing import fuzz, mutated, result_or_error
from hypothesis import given
from hypothesis import strategies as st

from thermoforce_mpc.boundary.tariffs import tariff_from_file
from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
from thermoforce_mpc.errors import ConfigError, WeatherError
from thermoforce_mpc.files import DoubtfulInput


def as_mos() -> bytes:
    year = synthetic_weather()
    lines = ["#1", "double tab1(8760,30)", "#LOCATION,TOWN,-,BEL,IWEC,064510,51.0,4.5,1.0,58.0"]
    for h in range(8760):
        cells = ["0"] * 30
        cells[0], cells[1], cells[2], cells[4] = f"{h * 3600}", f"{year.T_dry_C[h]}", f"{year.T_dew_C[h]}", "101300"
        cells[8], cells[9], cells[10] = (f"{getattr(year, name)[h]:g}" for name in SUN)
        lines.append("\t".join(cells))
    return "\n".join(lines).encode()


def as_epw() -> bytes:
    year = synthetic_weather()
    lines = ["LOCATION,Town,-,BEL,IWEC,064510,51.0,4.5,1.0,58.0", *["HEADER"] * 7]
    for h in range(1, 8761):
        date, at = np.datetime64("2019-01-01") + np.timedelta64((h - 1) // 24, "D"), h % 8760
        cells = [*str(date).split("-"), str((h - 1) % 24 + 1), "0", "?9", *["0"] * 29]
        cells[6], cells[7], cells[9] = f"{year.T_dry_C[at]}", f"{year.T_dew_C[at]}", "101300"
        cells[13], cells[14], cells[15] = (f"{getattr(year, name)[at]:g}" for name in SUN)
        lines.append(",".join(cells))
    return "\n".join(lines).encode()


SUN = ("global_W_m2", "normal_W_m2", "diffuse_W_m2")
YEARS = {"w.mos": as_mos, "w.epw": as_epw}
CELLS = st.sampled_from(["", "nan", "inf", "-1e308", "99999", "x", "1_0", "0x10", "1e-320", "\u0663", "9" * 500, "é"])


@pytest.fixture(scope="module")
def years():
    return {name: make() for name, make in YEARS.items()}


def read_year(path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulInput)
        weather = result_or_error(WeatherError, lambda: load_weather(path), names=path.name)
    assert weather is None or all(
        np.isfinite(weather.at(name, np.arange(0.0, 4e7, 1e5))).all() for name in ("T_dry_C", *SUN)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", YEARS)
def test_bytes_of_a_year_that_were_changed(years, tmp_path, name):
    @fuzz(15)
    @given(content=mutated(years[name]))
    def check(content):
        (tmp_path / name).write_bytes(content)
        read_year(tmp_path / name)

    check()


@pytest.mark.slow
@pytest.mark.parametrize("name", YEARS)
def test_a_cell_of_a_year_that_was_changed(years, tmp_path, name):
    lines, separator = years[name].decode().split("\n"), "\t" if name == "w.mos" else ","

    @fuzz(25)
    @given(line=st.integers(0, len(lines) - 1), column=st.integers(0, 34), cell=CELLS)
    def check(line, column, cell):
        cells = lines[line].split("," if line < 8 else separator)
        cells[column % len(cells)] = cell
        changed = [*lines[:line], ("," if line < 8 else separator).join(cells), *lines[line + 1 :]]
        (tmp_path / name).write_bytes("\n".join(changed).encode())
        read_year(tmp_path / name)

    check()


def read_prices(path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulInput)
        tariff = result_or_error(ConfigError, lambda: tariff_from_file(path), names=path.name)
    if tariff is not None:
        prices = result_or_error(ConfigError, lambda: tariff(np.arange(0.0, 4e7, 1e5)), names="has prices until day")
        assert prices is None or np.isfinite(prices).all()


PRICES = "time,price,other\n" + "".join(f"{hour * 3600},{0.2 + hour % 5 / 100:.2f},\n" for hour in range(300))


@pytest.mark.parametrize("name", ["prices.csv", "prices.csv.gz"])
def test_prices_that_were_changed(tmp_path, name):
    @fuzz(80)
    @given(content=mutated(PRICES.encode()), torn=st.booleans())
    def check(content, torn):
        packed = gzip.compress(content, 1) if name.endswith("gz") else content
        (tmp_path / name).write_bytes(packed[: len(packed) // 2] if torn else packed)
        read_prices(tmp_path / name)

    check()


@fuzz(80)
@given(content=st.binary(max_size=200) | mutated(gzip.compress(PRICES.encode(), mtime=0)))
def test_prices_of_any_bytes(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.csv.gz"
    path.write_bytes(content)
    read_prices(path)
