"""`tf-mpc doctor`: what is in order is said to be, what is not is named with what to do."""

from __future__ import annotations

import json
import shutil
from collections import namedtuple

import pytest
from boptest_server import running_service
from click.testing import CliRunner

from controllers import ThermoForceMPC
from controllers.optimisation.solvers.qp import QPSolver
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.inside import installation as doctor
from thermoforce_mpc.errors import ConfigError

TESTCASE = "bestest_hydronic_heat_pump"


def found(name: str, tmp_path, **options) -> doctor.Finding:
    (finding,) = doctor.examine(testcase=TESTCASE, folder=tmp_path / "runs", only=[name], **options)
    assert finding.name == name
    return finding


@pytest.mark.parametrize(
    "name", ["Python", "packages", "plant", "solver qp", "solver milp", "solver ipopt", "solver sqp", "disk"]
)
def test_a_sound_installation_is_sound(name, tmp_path):
    finding = found(name, tmp_path)
    assert finding.state in ("ok", "warning"), finding.told
    assert finding.seconds > 0


@pytest.mark.slow
@pytest.mark.usefixtures("unhurried")
def test_a_service_is_tried_and_left_as_it_was(tmp_path):
    with running_service() as service:
        finding = found("service", tmp_path, url=service.url)
        assert finding.state == "ok", finding.told
        assert not service.tests
        assert found("clock", tmp_path, url=service.url).told.endswith("as the service's")
        (finding,) = doctor.examine(testcase="bestest_air", url=service.url, folder=tmp_path, only=["service"])
        assert finding.state == "failed"
        assert "--testcase" in finding.todo
    gone = found("service", tmp_path, url="http://127.0.0.1:9")
    assert gone.state == "failed"
    assert "127.0.0.1:9" in gone.told
    assert "running" in gone.todo
    assert found("service", tmp_path).state == "skipped"


@pytest.mark.parametrize(("free", "state"), [(1e8, "failed"), (1e9, "warning"), (1e11, "ok")])
def test_a_disk_without_room(tmp_path, monkeypatch, free, state):
    usage = namedtuple("usage", "total used free")(1e12, 0, free)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    finding = found("disk", tmp_path)
    assert finding.state == state
    assert state == "ok" or "make room" in finding.todo
    assert list(tmp_path.iterdir()) == []


def test_a_solver_that_does_not_solve_and_one_that_is_missing(tmp_path, monkeypatch):
    def broken(self, problem, guess=None):
        raise ModuleNotFoundError("No module named 'piqp'", name="piqp")

    monkeypatch.setattr(QPSolver, "solve", broken)
    finding = found("solver qp", tmp_path)
    assert finding.state == "failed"
    assert "no plan" in finding.told
    monkeypatch.setattr(ThermoForceMPC, "plan", broken)
    finding = found("solver qp", tmp_path)
    assert finding.told == "piqp is not installed"
    assert "pip install" in finding.todo


def test_a_package_that_is_too_old_or_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(
        doctor, "requires", lambda name: ["numpy>=99", "nothing-of-the-kind", "flask; extra == 'serve'"]
    )
    finding = found("packages", tmp_path)
    assert finding.state == "failed"
    assert ">=99 is required" in finding.told
    assert "nothing-of-the-kind is not installed" in finding.told
    assert "flask" not in finding.told


@pytest.mark.slow
@pytest.mark.usefixtures("unhurried")
def test_the_command_says_what_failed(tmp_path, monkeypatch):
    words = ["doctor", "--out", str(tmp_path), "--only", "disk, Python", "--json", str(tmp_path / "d.json")]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0
    assert "Nothing failed" in done.output
    assert [one["name"] for one in json.loads((tmp_path / "d.json").read_text())["findings"]] == ["Python", "disk"]
    done = CliRunner().invoke(cli, ["doctor", "--url", "http://127.0.0.1:9", "--only", "service"])
    assert done.exit_code == 1
    assert "FAILED  service" in done.output
    assert "→" in done.output
    with pytest.raises(ConfigError, match="did you mean 'disk'"):
        CliRunner().invoke(cli, ["doctor", "--only", "disc"], catch_exceptions=False)
