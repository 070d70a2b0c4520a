"""A run that was killed goes on from its journal, to the same bytes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT
from run_folders import call, results
from simple_house import SimpleHouse, simple_model
from waiting import LONG_S, wait_for

from thermoforce_mpc import report
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.records import journal as journal_module
from thermoforce_mpc.records.journal import Journal, JournalError, read_journal

TESTCASE = "bestest_hydronic_heat_pump"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run of the MPC and a baseline on the simple house, and how to make others like it."""
    root = tmp_path_factory.mktemp("runs")
    simple_model().save(root / "model")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        words = ("--model", root / "model", "--baselines", "thermostat", "--days", "1", "--out", root / "whole")
        settings = ("--set", "controller.options.gate.enabled=false", "--set", "step_s=3600")
        done = call("run", "--testcase", TESTCASE, *words, *settings)
        assert done.exit_code == 0, done.output
        yield root / "whole"


def killed(whole: Path, at: int, folder: Path) -> Path:
    """What a run leaves that was killed when its journal was `at` bytes long."""
    folder.mkdir()
    shutil.copytree(whole / "model", folder / "model")
    (folder / "journal.jsonl").write_bytes((whole / "journal.jsonl").read_bytes()[:at])
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.97])
def test_a_run_killed_at_any_instant_goes_on_to_the_same_bytes(whole, tmp_path, share):
    size = (whole / "journal.jsonl").stat().st_size
    folder = killed(whole, int(share * size), tmp_path / "killed")
    done = call("resume", folder)
    assert done.exit_code == 0, done.output
    assert "planned otherwise" not in done.output
    assert results(folder) == results(whole)
    assert read_journal(folder / "journal.jsonl").entries[5:] != ()
    again = call("resume", folder)
    assert again.exit_code == 0
    assert "nothing to resume" in again.output


@pytest.mark.slow
def test_a_run_killed_between_two_records_goes_on_to_the_same_bytes(whole, tmp_path):
    """After a decision and before it acted (or before that was recorded); after the step was closed."""
    lines = (whole / "journal.jsonl").read_bytes().split(b"\n")
    for kind in (b"step", b"done"):
        last = [i for i, line in enumerate(lines) if b'"kind":"%s"' % kind in line][20]
        folder = killed(whole, sum(len(line) + 1 for line in lines[: last + 1]), tmp_path / kind.decode())
        assert call("resume", folder).exit_code == 0
        assert results(folder) == results(whole)


def test_a_damaged_record_in_the_middle_is_refused_by_its_line(whole, tmp_path):
    folder = killed(whole, 10**9, tmp_path / "damaged")
    path = folder / "journal.jsonl"
    lines = path.read_bytes().split(b"\n")
    lines[40] = lines[40].replace(b"2", b"3", 1)
    path.write_bytes(b"\n".join(lines))
    error = call("resume", folder).exception
    assert isinstance(error, JournalError)
    assert "journal.jsonl, line 41: the record is damaged" in str(error)
    del lines[40]
    path.write_bytes(b"\n".join(lines))
    assert "line 41" in str(call("resume", folder).exception), "a missing line is damage too"


def test_a_run_that_does_not_repeat_itself_is_refused(whole, tmp_path, monkeypatch):
    folder = killed(whole, 150_000, tmp_path / "other")
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse(T_start_C=20.5))
    error = call("resume", folder).exception
    assert isinstance(error, JournalError)
    assert "the plant answers" in str(error)
    assert "otherwise than it did then" in str(error)


def test_a_model_that_was_edited_is_refused(whole, tmp_path):
    folder = killed(whole, 150_000, tmp_path / "swapped")
    path = folder / "model" / "model.json"
    path.write_text(path.read_text().replace('"simple', '"other').replace('"source": "', '"source": "another '))
    assert "damaged or edited" in str(call("resume", folder).exception)


def test_a_folder_without_a_run_is_refused(tmp_path):
    assert "journal.jsonl: no such file; give the folder of a run" in str(call("resume", tmp_path).exception)
    (tmp_path / "journal.jsonl").write_bytes(b'{"n": 0, "kind": "run"')
    assert "ended before it began" in str(call("resume", tmp_path).exception)
    assert isinstance(call("resume", tmp_path / "nowhere").exception, ConfigError)


def test_the_journal_drops_a_torn_end_and_goes_on(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    for i in range(3):
        journal.write("note", {"value": 0.1 * i, "text": "°C"})
    journal.close()
    whole = path.read_bytes()
    for cut in range(1, len(whole)):
        path.write_bytes(whole[:cut])
        read = read_journal(path)
        assert len(read.entries) == whole[:cut].count(b"\n")
        assert read.torn == (whole[cut - 1 : cut] != b"\n")
    path.write_bytes(whole[:-5])
    journal = Journal(path, read_journal(path))
    journal.write("note", {"value": 0.2, "text": "°C"})
    journal.close()
    assert path.read_bytes() == whole


@pytest.mark.parametrize("harm", ["torn", "changed", "missing", "exchanged"])
def test_damage_before_the_last_line_is_refused(tmp_path, harm):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    for i in range(30):
        journal.write("note", {"value": i, "text": "°C" * 20})
    journal.close()
    lines = path.read_bytes().splitlines(keepends=True)
    if harm == "torn":
        lines[9] = lines[9][:-5]
    elif harm == "changed":
        lines[9] = lines[9].replace(b'"value":', b'"value": ', 1)
    elif harm == "missing":
        del lines[9]
    else:
        lines[9], lines[10] = lines[10], lines[9]
    path.write_bytes(b"".join(lines))
    with pytest.raises(JournalError, match=r"journal\.jsonl, line 10: the record is damaged"):
        read_journal(path)
    assert len(read_journal(path, 9).entries) == 9


def test_a_line_longer_than_any_record_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(journal_module, "MOST_LINE_BYTES", 100)
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.write("note", {"text": "x" * 100})
    journal.close()
    with pytest.raises(JournalError, match="more than 100 bytes, longer than any"):
        read_journal(path)


@pytest.mark.slow
def test_sigkill_and_sigterm_in_earnest(tmp_path):
    """The embedded plant in a process of its own: SIGKILL, then SIGTERM, then to the end."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = ["--controller", "thermostat", "--baselines", "native", "--days", "150", "--period", "10"]

    def start(*call: str) -> subprocess.Popen[str]:
        tf_mpc = [sys.executable, "-m", "thermoforce_mpc", *call, "--quiet"]
        return subprocess.Popen(tf_mpc, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def grown(folder: Path, process: subprocess.Popen[str], size: int) -> None:
        journal = folder / "journal.jsonl"
        long = lambda: journal.exists() and journal.stat().st_size > size  # noqa: E731
        wait_for("the journal grows", lambda: process.poll() is not None or long())

    run = tmp_path / "run"
    first = start("run", "--testcase", TESTCASE, *words, "--out", str(run))
    grown(run, first, 200_000)
    first.kill()
    first.communicate(timeout=LONG_S)
    assert first.returncode == -signal.SIGKILL
    assert {path.name for path in run.iterdir()} >= {"journal.jsonl"}
    size = len(read_journal(run / "journal.jsonl").entries)
    assert size > 100
    second = start("resume", str(run))
    grown(run, second, (run / "journal.jsonl").stat().st_size + 200_000)
    second.send_signal(signal.SIGTERM)
    out = second.communicate(timeout=LONG_S)
    assert second.returncode == 143, out
    assert "Traceback" not in out[1]
    assert not read_journal(run / "journal.jsonl").torn
    assert len(read_journal(run / "journal.jsonl").entries) > size
    assert (run / "INCOMPLETE.txt").exists()
