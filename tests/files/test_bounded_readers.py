"""Files of others: a device, a pipe or a file that unpacks to any size is one message, soon and in little memory."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from waiting import LONG_S

import thermoforce_mpc as tf
from thermoforce_mpc.boundary.tariffs import tariff_from_file
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.cli.building.courses import levels_of
from thermoforce_mpc.cli.inside.files import validate_file as validate
from thermoforce_mpc.comparison.input_files import input_files
from thermoforce_mpc.errors import DataError, InputError, WeatherError
from thermoforce_mpc.experiment.measured_model import check_measurements
from thermoforce_mpc.measurements.map.starting_map import starting_map
from thermoforce_mpc.measurements.tables import files as tables
from thermoforce_mpc.scenario.settings import read_yaml
from thermoforce_mpc.state_file import StateFormat

MAP = {
    "time": {"zone": "Europe/Berlin"},
    "outdoor": "out",
    "zones": {"a": {"temperature": "T"}},
    "actuators": {"h": {"level": "u"}},
    "machines": {"h": {"power": "P"}},
}
YAML = """
time: {zone: Europe/Berlin}
outdoor: out
zones: {a: {temperature: T}}
actuators: {h: {level: u}}
"""


@pytest.fixture(params=["device", "pipe", "link to a device"])
def endless(request, tmp_path):
    path = tmp_path / "endless.csv"
    if request.param == "device":
        return Path("/dev/zero")
    os.mkfifo(path) if request.param == "pipe" else path.symlink_to("/dev/zero")
    return path


def levels(path):
    return levels_of(path, None, tf.data.Names(("a",), ("h",), ("h",)), np.zeros(1), pd.Timestamp("2025-01-01"))


READERS = {
    "measurements": lambda path: tf.read_measurements(path, MAP),
    "starting map": lambda path: starting_map(str(path)),
    "schedule": levels,
    "prices": tariff_from_file,
    "map or scenario": read_yaml,
    "input files": lambda path: input_files([str(path)]),
    "state": StateFormat({}).read,
}


@pytest.mark.parametrize("reader", READERS)
def test_a_device_or_a_pipe_is_not_read(endless, reader):
    with pytest.raises(InputError, match="not a file"):
        READERS[reader](endless)


def test_columns_are_not_looked_for_in_a_device(tmp_path, endless):
    (tmp_path / "map.yaml").write_text(YAML)
    with pytest.raises(DataError, match="not a file"):
        check_measurements(endless, tmp_path / "map.yaml")


def test_a_weather_file_that_is_a_device_is_not_read(tmp_path):
    (tmp_path / "year.epw").symlink_to("/dev/zero")
    with pytest.raises(WeatherError, match="not a file"):
        load_weather(tmp_path / "year.epw")


@pytest.mark.slow
@pytest.mark.parametrize("pack", [gzip.open, bz2.open, lzma.open], ids=["gz", "bz2", "xz"])
def test_what_a_file_unpacks_to_counts(tmp_path, pack, request):
    """A file of some kilobytes that unpacks to 60 MB, where 20 MB are read at most."""
    path = tmp_path / f"bomb.csv.{request.node.callspec.id}"
    with pack(path, "wb") as file:
        file.write(b"time,T,out,u,P\n")
        for _ in range(60):
            file.write(bytes(1_000_000))
    assert path.stat().st_size < 2_000_000, "ten times its size is not too large"
    tracemalloc.start()
    begun = time.monotonic()
    with pytest.raises(DataError, match=r"bomb\.csv\.\w+: unpacked more than 0\.0 GB.*`most_bytes`"):
        tf.read_measurements(path, MAP, most_bytes=20_000_000)
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    assert time.monotonic() - begun < LONG_S
    tracemalloc.stop()


def test_a_table_of_a_few_bytes_a_million_rows_is_counted_by_its_rows(tmp_path, monkeypatch):
    rows = 2_000_000
    frame = pd.DataFrame(dict.fromkeys(("time", "T", "out", "u", "P"), np.zeros(rows)))
    frame.to_parquet(tmp_path / "flat.parquet")
    assert (tmp_path / "flat.parquet").stat().st_size < 1_000_000
    monkeypatch.setattr(tables, "MOST_BYTES", 50_000_000)
    with pytest.raises(DataError, match="2,000,000 rows"):
        tf.read_measurements(tmp_path / "flat.parquet", MAP)


def test_a_first_line_without_end_is_no_header(tmp_path):
    (tmp_path / "line.csv").write_bytes(b"a" * 50_000_000)
    tracemalloc.start()
    with pytest.raises(DataError, match="cannot be read as CSV"):
        tf.read_measurements(tmp_path / "line.csv", MAP)
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    tracemalloc.stop()


@pytest.mark.slow
def test_an_archive_of_a_state_that_unpacks_to_more_than_a_state_is_refused(tmp_path):
    array = io.BytesIO()
    np.save(array, np.zeros(30_000_000))
    with zipfile.ZipFile(tmp_path / "state.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a0.npy", array.getvalue())
    with pytest.raises(InputError, match="bytes when unpacked, at most 200,000,000 are read"):
        StateFormat({}).read(tmp_path / "state.npz")


@pytest.mark.parametrize(
    ("setting", "message"),
    [("weather: /etc/passwd", "weather files end in"), ("prices_file: /etc/passwd", "expected a CSV file")],
)
def test_a_scenario_with_any_file_as_its_weather_or_prices_is_not_valid(tmp_path, setting, message):
    path = tmp_path / "scenario.yaml"
    path.write_text(f"testcase: bestest_hydronic_heat_pump\nplant:\n  {setting}\n")
    with pytest.raises(InputError, match=message):
        CliRunner().invoke(validate, [str(path)], catch_exceptions=False, standalone_mode=False)
