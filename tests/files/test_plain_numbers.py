"""What is read as a number is one to everybody: '1_0' is ten to Python alone."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from boptest_client import ProtocolError
from boptest_client.answers import number
from thermoforce_mpc.boundary.tariffs import tariff_from_file
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.files import plain_number
from thermoforce_mpc.plants.shell import is_day
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase

HOUSE = "bestest_hydronic_heat_pump"


@pytest.mark.parametrize(
    ("text", "value"), [("10", 10.0), (" -1.5e-3 ", -1.5e-3), (".5", 0.5), ("5.", 5.0), ("+1", 1.0)]
)
def test_numbers(text, value):
    assert plain_number(text) == value


@pytest.mark.parametrize(
    "text", ["1_0", "١٠", "１０", "inf", "Infinity", "nan", "0x10", "1e999", "1 0", "1,5", "", "1e", "."]
)
def test_what_is_none(text):
    with pytest.raises(ValueError, match="number"):
        plain_number(text)
    assert not is_day(text)


@pytest.mark.parametrize(
    "words",
    [
        ["--days", "1_0"],
        ["--seed", "1_0"],
        ["--seed", "١٠"],
        ["--comfort-weight", "0.0_1"],
        ["--start", "4_4"],
        ["--set", "days=1_0"],
        ["--set", "seed=1_0"],
        ["--set", "controller.options.objective.comfort_weight_per_m2=1_0"],
    ],
)
def test_the_command_line_takes_none_of_them(words, tmp_path):
    done = CliRunner().invoke(cli, ["run", "--testcase", HOUSE, *words, "--out", str(tmp_path / "run")])
    assert done.exit_code != 0
    said = done.output + str(done.exception)
    assert words[1].rpartition("=")[2] in said
    assert "number" in said or "window" in said
    assert not (tmp_path / "run").exists()


def test_nor_do_files_and_answers(tmp_path):
    table = tmp_path / "prices.csv"
    table.write_text("time,price\n0,0.1\n3_600,0.2\n")
    with pytest.raises(ConfigError, match=r"line 3, column 'time': '3_600' is not a finite number"):
        tariff_from_file(table)
    with pytest.raises(ConfigError, match=r"days: .*'1_0' is not a number"):
        load_scenario(None, {"testcase": HOUSE, "days": "1_0"})
    with pytest.raises(InputError, match="expected generated:SEED:INDEX"):
        load_testcase("generated:١:2")
    with pytest.raises(ProtocolError):
        number("http://service/advance", "1_0")
    assert number("http://service/advance", "10") == 10.0
