"""Two checkouts beside each other: what is measured, and what is refused."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from places import ROOT

from benchmarks.speed import __main__ as speed
from thermoforce_mpc.errors import ConfigError


@pytest.fixture
def other(tmp_path):
    """A checkout that only spends time and memory."""
    (tmp_path / "thermoforce_mpc").mkdir()
    (tmp_path / "thermoforce_mpc" / "__init__.py").write_text("")
    spends = "import time\nkept = bytearray(60_000_000)\nwhile time.process_time() < 0.4: pass\n"
    (tmp_path / "spends.py").write_text(spends)
    return tmp_path


@pytest.mark.slow
def test_ours_is_a_share_of_theirs(other, tmp_path, monkeypatch):
    code = "import importlib.util\nif importlib.util.find_spec('spends'): import spends"
    row = speed.Row("spends: nothing here", ("-c", code), {speed.PROCESSOR: 0.5, speed.PEAK: 0.5}, {speed.WALL: 0.0})
    monkeypatch.setattr(speed, "ROWS", (row,))
    words = ["--against", str(other), "--times", "1", "--json", str(tmp_path / "speed.json")]
    done = CliRunner().invoke(speed.main, words)
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "speed.json").read_text())
    shares = {one["figure"]: one["share"] for one in result["rows"]}
    assert list(shares) == [speed.PROCESSOR, speed.WALL, speed.PEAK]
    assert shares[speed.PROCESSOR] < 0.5
    assert shares[speed.PEAK] < 0.5
    assert {target["name"].partition(": ")[2].partition(": ")[2]: target["holds"] for target in result["targets"]} == {
        speed.PROCESSOR: True,
        speed.WALL: False,
        speed.PEAK: True,
    }


def test_modules_are_compiled_once_whatever_the_shell_says(other, monkeypatch):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    row = speed.Row("keeps: what it compiled", ("-c", "import sys, thermoforce_mpc; sys.exit(sys.dont_write_bytecode)"))
    speed.measured(row, other)
    assert list((other / "thermoforce_mpc" / "__pycache__").iterdir())


def test_what_cannot_be_measured_is_refused(other, tmp_path):
    row = speed.Row("fails", ("-c", "raise SystemExit('out of heat')"))
    with pytest.raises(ConfigError, match=r"fails: failed in .*out of heat"):
        speed.compared([row], other, 1)
    with pytest.raises(ConfigError, match="no checkout"):
        speed.compared([row], ROOT / "docs", 1)
    done = CliRunner().invoke(speed.main, ["--against", str(other), "--rows", "help,x"])
    assert "--rows x: no row begins so; there are help, tab, names, step" in done.output
