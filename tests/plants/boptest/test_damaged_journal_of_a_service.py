"""A damaged journal of a run on a service: the run goes on where the test stands, as after an outage."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest
from boptest_server import running_service
from click.testing import CliRunner

from boptest_client import BoptestClient
from thermoforce_mpc import report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.records.journal import JournalError, read_journal

# At New Year, so that the warm-up is six hours and its record short.
WORDS = ("--testcase", "bestest_hydronic_heat_pump", "--period", "0.25", "--days", "0.25", "--no-equal-comfort")


class Killed(BaseException):
    """In place of SIGKILL: nobody stops the test."""


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


@pytest.fixture(scope="module")
def service():
    with running_service() as running:
        yield running


def killed(service, folder: Path, controllers: tuple[str, str], advances: int) -> None:
    """A run whose process ended after its `advances`-th request to advance."""
    asked, true_advance = iter(range(advances)), BoptestClient.advance

    def advance(self, inputs=None):
        if next(asked, None) is None:
            raise Killed
        return true_advance(self, inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BoptestClient, "advance", advance)
        patch.setattr(BoptestPlant, "close", lambda self: None)
        words = ("--controller", controllers[0], "--baselines", controllers[1])
        with pytest.raises(Killed):
            call("run", *WORDS, *words, "--url", service.url, "--out", folder)


def damaged(folder: Path, kind: str, which: int) -> list[str]:
    """Flip a bit in a record; the words of the command that the refusal of `resume` gives."""
    path = folder / "journal.jsonl"
    lines = path.read_bytes().split(b"\n")
    at = [i for i, line in enumerate(lines) if b'"kind":"%s"' % kind.encode() in line][which]
    lines[at] = lines[at][:-20] + bytes([lines[at][-20] ^ 4]) + lines[at][-19:]
    path.write_bytes(b"\n".join(lines))
    error = call("resume", folder).exception
    assert isinstance(error, JournalError)
    (words,) = re.findall(r"`tf-mpc (resume [^`]*)`", str(error))
    return shlex.split(words)


@pytest.fixture(autouse=True)
def no_report(monkeypatch):
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "which"), [("done", 4), ("step", 4), ("step", 11), ("step", 0)])
def test_a_run_goes_on_where_the_test_stands(service, tmp_path, kind, which):
    folder = tmp_path / "run"
    killed(service, folder, ("thermostat", ""), 12)
    command, asked = damaged(folder, kind, which), service.count("advance/")
    done = call(*command)
    assert done.exit_code == 0, done.output + str(done.exception)
    steps = pd.read_csv(folder / "steps.csv")
    trajectory = pd.read_csv(folder / "trajectory.csv")
    end_s = trajectory["start_s"].iloc[-1] + trajectory["duration_s"].iloc[-1]
    begun_s = trajectory["start_s"].iloc[0]
    assert end_s - begun_s == 6 * 3600
    if kind == "step" and which == 0:  # nothing of the loop is known: it begins again
        assert service.count("advance/") - asked == 24
        return
    assert service.count("advance/") - asked == 12, "no step is done twice, and none is left out"
    assert len(steps) == which + 1 + 12
    gap = steps.iloc[which]
    assert ("the plant gives no forecast" in gap["notes"]) == (kind == "step")
    assert steps["time_s"].iloc[which + 1] == begun_s + 12 * 900, "it goes on from now"
    if which == 4:
        assert "what happened meanwhile is read from its record" in gap["notes"]
    entries = read_journal(folder / "journal.jsonl").entries
    assert sum(entry.kind == "past" for entry in entries) == (2 if which == 4 else 1)


@pytest.mark.slow
def test_a_loop_that_is_over_at_the_service_begins_again(service, tmp_path):
    folder = tmp_path / "run"
    killed(service, folder, ("thermostat", "native"), 27)
    command, asked = damaged(folder, "done", 4), service.count("advance/")
    done = call(*command)
    assert done.exit_code == 0, done.output + str(done.exception)
    assert service.count("advance/") - asked == 24 + 6
    assert len(pd.read_csv(folder / "trajectory.csv")) == 24
    assert len(pd.read_csv(folder / "trajectory_native.csv")) == 6  # in steps of an hour
