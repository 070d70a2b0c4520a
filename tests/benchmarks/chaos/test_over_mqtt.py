"""`bench mqtt`: a house behind a real broker lives as it does in process, and what goes wrong there is said."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from benchmarks.chaos.mosquitto import missing
from thermoforce_mpc.cli import cli

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(missing()), reason=missing() or "a broker is there")]


def test_house_behind_a_broker_lives_as_in_process(tmp_path):
    words = ["bench", "mqtt", "--quick", "--by", "set-points", "--json", str(tmp_path / "out.json")]
    ended = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert ended.exit_code == 0, ended.output
    found = json.loads((tmp_path / "out.json").read_text())
    usual, behind = found["rows"]
    assert behind["cost"] == usual["cost"] > 0.0
    assert behind["outside_Kh"] == usual["outside_Kh"]
    # The device says what it took: three rooms tried, an hour of shadow, two of control.
    assert len(trials := behind["trials"].split(", ")) == 3
    assert set(trials) <= {"taken", "answered"}
    assert (behind["shadowed"], behind["decisions"], behind["planned"]) == (1, 2, 2)
    assert behind["wrong"] == ""
    assert all(target["holds"] for target in found["targets"])
