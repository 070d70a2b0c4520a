"""Two checkouts beside each other: what is measured, and what is refused."""

from __future__ import annotations

import json
import sys

import pytest
from click.testing import CliRunner
from places import ROOT

from benchmarks import speed
from thermoforce_mpc.errors import ConfigError


@pytest.fixture
def other(tmp_path):
    """A checkout that only spends time and memory."""
    (tmp_path / "thermoforce_mpc").mkdir()
    (tmp_path / "thermoforce_mpc" / "__init__.py").write_text("")
    spends = "import time\nkept = bytearray(60_000_000)\nwhile time.process_time() < 0.4: pass\n"
    (tmp_path / "spends.py").write_text(spends)
    return tmp_path


def test_ours_is_a_share_of_theirs(other, tmp_path, monkeypatch):
    code = "import importlib.util\nif importlib.util.find_spec('spends'): import spends"
    row = speed.Row("spends: nothing here", (sys.executable, "-c", code), 0.5, 0.5)
    monkeypatch.setattr(speed, "ROWS", (row,))
    words = ["--against", str(other), "--times", "1", "--json", str(tmp_path / "speed.json")]
    done = CliRunner().invoke(speed.main, words)
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "speed.json").read_text())
    (found,) = result["rows"]
    assert found["processor"] < 0.5
    assert found["peak"] < 0.5
    assert [target["holds"] for target in result["targets"]] == [True, True]


def test_what_cannot_be_measured_is_refused(other, tmp_path):
    row = speed.Row("fails", (sys.executable, "-c", "raise SystemExit('out of heat')"))
    with pytest.raises(ConfigError, match=r"fails: failed in .*out of heat"):
        speed.compared([row], other, 1)
    with pytest.raises(ConfigError, match="no checkout"):
        speed.compared([row], ROOT / "docs", 1)
    assert "there are help, tab" in CliRunner().invoke(speed.main, ["--against", str(other), "--only", "x"]).output
