"""`tf-mpc weather fetch`, and what the commands make of weather files that cannot be used."""

from __future__ import annotations

import shutil

import pytest
from click.testing import CliRunner

from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.boundary.weather.readers import FILE_NAME, FINGERPRINT
from thermoforce_mpc.cli import main
from thermoforce_mpc.cli.inside.doctor import weather as command
from thermoforce_mpc.errors import WeatherError

TESTCASE = "bestest_hydronic_heat_pump"


def weather_file(T: list[float | str]) -> str:
    header = ["#1", "double tab1(8760,30)", "#LOCATION,TOWN,-,BEL,IWEC,064510,50.90,4.53,1.0,58.0"]
    rows = [
        f"{h * 3600.0} {value} 1 0 101300 0 0 0 {100 * (h % 24 == 12)} 0 0 0 0 0 0 200 4 0 5 10 22000"
        for h, value in enumerate(T)
    ]
    return "\n".join([*header, *rows]) + "\n"


def outcome(words, monkeypatch, capsys):
    """Exit code and what was said on standard error by the program as it is started."""
    monkeypatch.setattr("sys.argv", ["tf-mpc", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, capsys.readouterr().err


def test_the_cached_file_is_used_without_a_network(shared, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = tmp_path / "thermoforce-mpc" / FILE_NAME
    kept.parent.mkdir()
    shutil.copy(shared / "boptest_hp" / FILE_NAME, kept)
    done = CliRunner().invoke(command, ["fetch", "--url", "http://127.0.0.1:9/nothing"], catch_exceptions=False)
    assert done.exit_code == 0
    assert done.stdout.strip() == str(kept)
    assert load_weather(kept).fingerprint == FINGERPRINT


def test_without_a_network_it_says_what_to_do_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "w"
    words = ["weather", "fetch", "--out", str(folder), "--url", "http://127.0.0.1:9/nothing"]
    code, said = outcome(words, monkeypatch, capsys)
    assert code == 2
    assert "pass it with --weather, or use the synthetic year" in said
    assert not folder.exists()


def test_another_file_of_that_name_in_the_cache_is_refused(tmp_path):
    (tmp_path / FILE_NAME).write_text(weather_file([5.0, 6.0] * 4380))
    with pytest.raises(WeatherError, match="is not the Brussels year"):
        CliRunner().invoke(command, ["fetch", "--out", str(tmp_path)], catch_exceptions=False, standalone_mode=False)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["run", "--testcase", TESTCASE], ["identify", "--testcase", TESTCASE], ["serve"]])
@pytest.mark.parametrize(
    ("T", "message"),
    [
        ([5.0] * 4000, "4000 hourly rows, a year has 8760; the file is truncated"),
        ([5.0] * 100 + ["nan"] + [5.0] * 8659, "hourly row 101: a cell is not a number ('nan' is not a number)"),
        ([5.0] * 100 + ["warm"] + [5.0] * 8659, "a cell is not a number"),
    ],
    ids=["truncated", "NaN", "text"],
)
def test_a_weather_file_that_cannot_be_used_is_one_message_and_nothing_written(
    tmp_path, monkeypatch, capsys, words, T, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "w.mos").write_text(weather_file(T))
    code, said = outcome([*words, "--weather", "w.mos"], monkeypatch, capsys)
    assert code == 2
    assert "w.mos" in said
    assert message in " ".join(said.split())
    left = {path.name for path in tmp_path.rglob("*")} - {"w.mos", "runs"}
    assert not left, "nothing half-written"
