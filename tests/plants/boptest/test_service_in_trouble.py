"""A run on a service: killed and taken up again, or the service away: no step is lost, none is done twice."""

from __future__ import annotations

import itertools
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from boptest_server import Fault, running_service
from click.testing import CliRunner

from boptest_client import BoptestClient, TransportConfig
from thermoforce_mpc import report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import NoSuchTest, PlantError
from thermoforce_mpc.plants import registry
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.records.journal import read_journal

# Twelve steps of a quarter of an hour. At New Year, so that the warm-up is six hours and its record short.
WORDS = (
    "--testcase", "bestest_hydronic_heat_pump", "--period", "0.25", "--days", "0.125", "--controller", "thermostat",
    "--baselines", "",
)  # fmt: skip


class Killed(BaseException):
    """In place of SIGKILL: nobody stops the test."""


@pytest.fixture(scope="module")
def service():
    with running_service() as running:
        yield running


@pytest.fixture(autouse=True)
def at_once(monkeypatch, service):
    """Pauses are asked for and not slept, and no report is drawn."""
    service.faults.clear()
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())

    def patience(spec) -> TransportConfig:
        return TransportConfig(
            connect_timeout_s=1.0, read_timeout_s=10.0, patience_s=60.0 * spec.patience_min, sleep=lambda seconds: None
        )

    monkeypatch.setattr(registry, "patience", patience)


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def begin(service, folder: Path, *more: str):
    return call("run", *WORDS, "--url", service.url, "--out", folder, *more)


@pytest.fixture(scope="module")
def whole(service, tmp_path_factory):
    """A run that nothing happened to."""
    folder = tmp_path_factory.mktemp("service") / "whole"
    assert begin(service, folder).exit_code == 0
    return folder


def killed_at(service, folder: Path, step: int, monkeypatch, *, after: bool) -> None:
    """A run whose process ends at its `step`-th request to advance, before it was sent or after it was answered."""
    asked, true_advance = itertools.count(), BoptestClient.advance

    def advance(self, inputs=None):
        last = next(asked) == step
        if last and not after:
            raise Killed
        state = true_advance(self, inputs)
        if last:
            raise Killed
        return state

    with monkeypatch.context() as patch:
        patch.setattr(BoptestClient, "advance", advance)
        patch.setattr(BoptestPlant, "close", lambda self: None)
        with pytest.raises(Killed):
            begin(service, folder)


@contextmanager
def troubled(service, faults):
    """From the eighth step on, `faults`."""
    true_answer, asked = service.answer, itertools.count()

    def answer(method, path, body):
        if path.startswith("advance/") and next(asked) == 8:
            service.faults[:] = faults
        return true_answer(method, path, body)

    service.answer = answer
    try:
        yield
    finally:
        service.answer = true_answer
        service.faults.clear()


@pytest.mark.slow
@pytest.mark.parametrize("after", [False, True])
def test_a_killed_run_is_taken_up_where_the_test_stands(service, whole, tmp_path, monkeypatch, after):
    folder = tmp_path / "killed"
    killed_at(service, folder, 10, monkeypatch, after=after)
    steps, stopped = service.count("advance/"), len(service.stopped)
    done = call("resume", folder)
    assert done.exit_code == 0, done.output
    assert "Resuming after 10 recorded steps" in done.output
    assert service.count("advance/") - steps == 12 - 10 - after
    assert len(service.stopped) == stopped + 1
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()


@pytest.mark.slow
def test_a_run_killed_before_its_first_step_goes_on(service, whole, tmp_path, monkeypatch):
    folder = tmp_path / "early"
    killed_at(service, folder, 0, monkeypatch, after=False)
    assert call("resume", folder).exit_code == 0
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()


def test_a_test_that_is_gone_is_said_and_the_journal_kept(service, tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    killed_at(service, folder, 10, monkeypatch, after=False)
    before = (folder / "journal.jsonl").read_bytes()
    service.tests.clear()
    error = call("resume", folder).exception
    assert isinstance(error, NoSuchTest)
    assert "no longer has the test" in str(error)
    assert (folder / "journal.jsonl").read_bytes() == before


@pytest.mark.slow
def test_a_test_that_somebody_else_advanced_is_refused(service, tmp_path, monkeypatch):
    folder = tmp_path / "elsewhere"
    killed_at(service, folder, 10, monkeypatch, after=True)
    (testid,) = service.tests
    for _ in range(2):
        service.answer("POST", f"advance/{testid}", {})
    error = call("resume", folder).exception
    assert isinstance(error, PlantError)
    assert "somebody else advanced the test" in str(error)


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults",
    [
        [Fault("(advance|forecast|results)/", "500", times=25)],
        [Fault("advance/", "drop", times=6), Fault("results/", "garbage", times=6)],
        [Fault("advance/", "drop", after_work=True), Fault("results/", "500", times=9, after_work=True)],
        [Fault("advance/", "truncated", times=1, after_work=True)],
    ],
    ids=["500", "dropped before", "dropped after", "cut short"],
)
def test_a_service_in_trouble_costs_no_step_and_doubles_none(service, whole, tmp_path, faults):
    trouble, folder = [replace(fault) for fault in faults], tmp_path / "trouble"
    with troubled(service, trouble):
        done = begin(service, folder)
    assert done.exit_code == 0, done.output
    assert all(fault.times == 0 for fault in trouble)
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    times = [
        entry.content["time_s"] for entry in read_journal(folder / "journal.jsonl").entries if entry.kind == "step"
    ]
    assert set(pd.Series(times).diff().dropna()) == {900.0}


def shifted(seconds: float):
    """The clock of an answer, wrong."""

    def edit(payload):
        times = payload["time"]
        return payload | {"time": [t + seconds for t in times] if isinstance(times, list) else times + seconds}

    return edit


WRONG = {
    "redirect": Fault("advance/", "moved"),
    "redirect after": Fault("advance/", "moved", after_work=True),
    "page": Fault("advance/", "page"),
    "page at results": Fault("results/", "page"),
    "cached": Fault("advance/", "edited", edit=shifted(-900.0)),
    "clock 900 s ahead": Fault("advance/", "edited", edit=shifted(900.0)),
    "clock 0.5 s ahead": Fault("advance/", "edited", edit=shifted(0.5)),
    "clock 0.5 s behind": Fault("advance/", "edited", edit=shifted(-0.5)),
    "record 900 s ahead": Fault("results/", "edited", edit=shifted(900.0)),
    "record 0.5 s ahead": Fault("results/", "edited", edit=shifted(0.5)),
    "record cached": Fault("results/", "edited", edit=shifted(-900.0)),
    "forecast shifted": Fault("forecast/", "edited", edit=shifted(3600.0)),
    "null": Fault("advance/", "edited", edit=lambda payload: None),
    "empty": Fault("advance/", "edited", edit=lambda payload: {}),
    "null before": Fault("advance/", "null"),
}


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("times", [1, 3])
def test_a_wrong_answer_is_waited_out(service, whole, tmp_path, wrong, times):
    folder, done, trouble = tmp_path / "wrong", None, replace(WRONG[wrong], times=times)
    with troubled(service, [trouble]):
        done = begin(service, folder)
    assert done.exit_code == 0, done.output
    assert trouble.times == 0
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("resumed", [True, False])
def test_a_service_that_stays_away_ends_the_run_when_patience_does_and_keeps_its_test(
    service, whole, tmp_path, resumed
):
    folder, stopped = tmp_path / "away", len(service.stopped)
    with troubled(service, [Fault("(advance|forecast|results)/", "500", times=10**6)]):
        done = begin(service, folder, "--set", "plant.patience_min=2")
    assert isinstance(done.exception, PlantError)
    assert str(folder) in str(done.exception)
    assert "Internal error in the simulation" in str(done.exception)
    assert f"resume {folder} --stop" in str(done.exception)
    assert (folder / "INCOMPLETE.txt").exists()
    assert sum(entry.kind == "done" for entry in read_journal(folder / "journal.jsonl").entries) >= 8
    assert len(service.stopped) == stopped, "its test stands where it stood"
    if resumed:
        again = call("resume", folder)
        assert again.exit_code == 0, again.output
        assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    else:
        assert call("resume", folder, "--stop").output == "The test was stopped.\n"
        assert isinstance(call("resume", folder).exception, NoSuchTest)
    assert len(service.stopped) == stopped + 1


def test_a_run_without_a_service_has_no_test_to_stop(tmp_path):
    assert call("run", *WORDS, "--out", tmp_path / "simulated").exit_code == 0
    assert "its plant is simulated" in str(call("resume", tmp_path / "simulated", "--stop").exception)
