"""Flipped bits in a journal cost no run: refused with the command that goes on, and then the same bytes."""

from __future__ import annotations

import random
import re
import shlex
import shutil
from pathlib import Path

import pytest
from run_folders import call, results
from simple_house import SimpleHouse

from thermoforce_mpc import report
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.records.journal import JournalError, read_journal

WORDS = ("--testcase", "bestest_hydronic_heat_pump", "--controller", "thermostat", "--baselines", "native")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run of two controllers, with its journal."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        done = call("run", *WORDS, "--days", "1", "--no-equal-comfort", "--out", folder)
        assert done.exit_code == 0, done.output
        yield folder


def copied(whole: Path, folder: Path) -> Path:
    folder.mkdir()
    shutil.copy(whole / "journal.jsonl", folder)
    return folder


def command_in(error: BaseException | None) -> list[str]:
    """The words of `tf-mpc resume …` in a message."""
    (words,) = re.findall(r"`tf-mpc (resume [^`]*)`", str(error))
    return shlex.split(words)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(16))
def test_flipped_bits_are_refused_with_the_command_that_goes_on_to_the_same_bytes(whole, tmp_path, seed):
    folder, draw = copied(whole, tmp_path / "flipped run"), random.Random(seed)
    path, undamaged = folder / "journal.jsonl", (whole / "journal.jsonl").read_bytes()
    raw = bytearray(undamaged)
    for _ in range(draw.choice([1, 1, 3])):
        raw[draw.randrange(len(raw))] ^= 1 << draw.randrange(8)
    path.write_bytes(raw)
    done = call("resume", folder)
    if done.exit_code:
        assert isinstance(done.exception, JournalError)
        assert "cannot be relied on" in str(done.exception)
        assert path.read_bytes() == raw, "a refusal changes nothing"
        if raw.split(b"\n")[0] != undamaged.split(b"\n")[0]:
            assert "start the run again" in str(done.exception)
            return
        done = call(*command_in(done.exception))
        assert done.exit_code == 0, done.output + str(done.exception)
        lost = (folder / "journal.jsonl.lost").read_bytes()
        assert raw.endswith(lost)
    assert results(folder) == results(whole)
    assert not read_journal(folder / "journal.jsonl").torn


@pytest.mark.slow
def test_a_run_goes_on_from_a_time_or_an_earlier_line(whole, tmp_path):
    folder = copied(whole, tmp_path / "back")
    done = call("resume", folder, "--from", f"{10.25 * DAY_S:.0f}s")
    assert done.exit_code == 0, done.output
    assert b'"time_s":885600.0' in (folder / "journal.jsonl.lost").read_bytes().split(b"\n")[0]
    assert results(folder) == results(whole)
    again = copied(whole, tmp_path / "at the second line")
    assert call("resume", again, "--from", "2").exit_code == 0
    assert results(again) == results(whole)


@pytest.mark.parametrize(
    ("since", "said"),
    [("1", "a line from 2 to"), ("100000", "a line from 2 to"), ("40 06:00", "give a line"), ("x", "--from x: not a")],
)
def test_a_line_or_time_that_is_not_there_is_refused(whole, tmp_path, since, said):
    folder = copied(whole, tmp_path / "nowhere")
    (folder / "journal.jsonl").write_bytes((folder / "journal.jsonl").read_bytes())
    if since == "40 06:00":
        since = "2 06:00"
    error = call("resume", folder, "--from", since).exception
    assert isinstance(error, InputError)
    assert said in str(error)
    assert not (folder / "journal.jsonl.lost").exists()


def test_more_than_the_first_line_is_needed(whole, tmp_path):
    folder = copied(whole, tmp_path / "headless")
    raw = (folder / "journal.jsonl").read_bytes()
    (folder / "journal.jsonl").write_bytes(b"[" + raw[1:])
    assert "nothing can be read before it: start the run again" in str(call("resume", folder).exception)
