"""A run whose FMU is in trouble: what stands in its folder, how it goes on, and how it is ended."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")
from click.testing import CliRunner
from places import ROOT
from waiting import wait_for

from benchmarks.chaos.fmu.building import build_troubled
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.worker_process import PASSED

pytestmark = pytest.mark.slow
TESTCASE = "bestest_hydronic_heat_pump"
RESTARTED = "restarted with tolerance 1e-07: the FMU's step from day 0.302083 took more than 2 s"


@pytest.fixture(autouse=True)
def told_by_the_environment(monkeypatch):
    monkeypatch.setenv(PASSED, "FMU_HOUSE_*")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return build_troubled(tmp_path_factory.mktemp("fmu"))


def words(file: Path, folder: Path, patience_min: float = 2.0 / 60.0) -> list[str]:
    """Of a run from six o'clock at New Year, so that the warm-up is six hours."""
    run = ["run", "--testcase", TESTCASE, "--fmu", str(file), "--period", "0.25", "--days", "0.125", "--baselines", ""]
    return [*run, "--controller", "thermostat", "--set", f"plant.patience_min={patience_min}", "--out", str(folder)]


def test_a_restart_stands_in_the_folder_and_a_resumed_run_does_the_same(file, tmp_path, monkeypatch):
    monkeypatch.setenv("FMU_HOUSE_SLEEPS_ON_DAY", "0.31")
    monkeypatch.setenv("FMU_HOUSE_UNLESS", str(tmp_path / "happened"))
    done = CliRunner().invoke(cli, words(file, tmp_path / "whole"), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert re.search(r"the FMU's step from day 0\.302083 takes \d\.?\d* s already; it is ended after 2 s", done.output)
    assert RESTARTED in done.output
    assert RESTARTED in json.loads((tmp_path / "whole" / "manifest.json").read_text())["plant"]["details"]["restarts"]
    for name in ("report.html", "log.jsonl", "journal.jsonl"):
        assert RESTARTED in (tmp_path / "whole" / name).read_text().replace("&#39;", "'"), name

    (tmp_path / "cut").mkdir()
    journal = (tmp_path / "whole" / "journal.jsonl").read_bytes()
    (tmp_path / "cut" / "journal.jsonl").write_bytes(journal[: int(0.9 * len(journal))])
    page = tmp_path / "cut.html"
    done = CliRunner().invoke(cli, ["report", str(tmp_path / "cut"), "--out", str(page)], catch_exceptions=False)
    assert RESTARTED in page.read_text().replace("&#39;", "'"), done.output
    done = CliRunner().invoke(cli, ["resume", str(tmp_path / "cut")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "already" not in done.output, "it does not hang again"
    assert (tmp_path / "cut" / "trajectory.csv").read_bytes() == (tmp_path / "whole" / "trajectory.csv").read_bytes()
    assert RESTARTED in json.loads((tmp_path / "cut" / "manifest.json").read_text())["plant"]["details"]["restarts"]


def test_a_run_whose_fmu_cannot_go_on_ends_with_a_report_until_there(file, tmp_path, monkeypatch):
    monkeypatch.setenv("FMU_HOUSE_FAILS_ON_DAY", "0.31")
    done = CliRunner().invoke(cli, words(file, tmp_path / "run"))
    assert isinstance(done.exception, PlantError), done.output
    assert "could not simulate at day 0.302083" in str(done.exception)
    assert "restarted with tolerance 1e-05" in str(done.exception)
    assert ", with a report: report.html; `tf-mpc resume" in str(done.exception)
    assert "1e-05" in (tmp_path / "run" / "INCOMPLETE.txt").read_text()
    assert len((tmp_path / "run" / "incomplete_trajectory_thermostat.csv").read_text().splitlines()) > 3
    report = (tmp_path / "run" / "report.html").read_text()
    assert "thermostat was cut off after 0.0" in report
    assert "restarted with tolerance 1e-07" in report


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_step_that_hangs_ends_with_its_run(file, tmp_path, how):
    folder, hangs = tmp_path / "run", tmp_path / "hangs"
    environment = {"FMU_HOUSE_SLEEPS_ON_DAY": "0.31", "FMU_HOUSE_UNLESS": str(hangs), "PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(
        [sys.executable, "-m", "thermoforce_mpc", *words(file, folder, 15.0)],
        env=os.environ | environment, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        start_new_session=True,
    )  # fmt: skip
    wait_for("the step that hangs", hangs.exists)
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    began = time.monotonic()
    run.send_signal(how)
    output = run.communicate()[0].decode()
    wait_for("the end of the FMU's process", lambda: not any(Path(f"/proc/{child}").exists() for child in children))
    assert children
    assert time.monotonic() - began < 5.0, output
    if how == signal.SIGINT:
        assert "Traceback" not in output
        assert "interrupted" in (folder / "INCOMPLETE.txt").read_text()
    shutil.rmtree(folder)
