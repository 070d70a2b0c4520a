"""A contestant's result must not depend on who else is in the table."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("identified_once")]


def test_a_baseline_changes_nothing_about_the_controller_beside_it(tmp_path):
    """`rc_mpc` switches, `thermoforce_paper` holds levels between off and full: each is probed for its own way."""

    def run(name: str, controller: str, baselines: str):
        words = ["--testcase", "bestest_hydronic_heat_pump", "--period", "20", "--days", "0.125", "--quiet"]
        options = ("modulation=linear", "sun_on_sensor=false", "late_sensor=false")
        words += ["--set", "identification.days=1", *(f"--set=identification.options.{one}" for one in options)]
        words += ["--controller", controller, "--baselines", baselines, "--out", str(tmp_path / name)]
        done = CliRunner().invoke(cli, ["run", *words])
        assert done.exit_code == 0, done.output
        files = (tmp_path / name / "manifest.json", tmp_path / name / "kpis.json")
        return [json.loads(path.read_text(encoding="utf-8")) for path in files]

    (alone, _), (paper_alone, paper_kpis) = run("a", "rc_mpc", ""), run("b", "thermoforce_paper", "")
    both, both_kpis = run("c", "rc_mpc", "thermoforce_paper,thermostat")
    assert both["identification"]["data_sha256"] == alone["identification"]["data_sha256"], "the probed record"
    beside = both["identification"].pop("baselines")["thermoforce_paper"]
    assert both["identification"] == alone["identification"]
    paper_alone["identification"].pop("actuation")  # of the controller, not of its baselines
    assert beside == paper_alone["identification"] != both["identification"]
    assert both_kpis["baselines"]["thermoforce_paper"] == paper_kpis["kpis"]
    assert (tmp_path / "a" / "trajectory.csv").read_bytes() == (tmp_path / "c" / "trajectory.csv").read_bytes()
