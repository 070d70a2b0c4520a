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

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.simulation import report
from thermoforce_mpc.simulation import run as simulation_run
from thermoforce_mpc.simulation.journal import journal as journal_module
from thermoforce_mpc.simulation.journal.journal import JournalError, read_journal

WORDS = ("--testcase", "bestest_hydronic_heat_pump", "--controller", "thermostat", "--baselines", "native")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run of two controllers, its journal in four parts."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation_run, "build_plant", lambda *_: SimpleHouse())
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        patch.setattr(journal_module, "PART_BYTES", 20_000)
        done = call("run", *WORDS, "--days", "1", "--no-equal-comfort", "--out", folder)
        assert done.exit_code == 0, done.output
        assert len(parts(folder)) > 3
        yield folder


def parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("journal*.jsonl"), key=lambda path: (len(path.name), path.name))


def copied(whole: Path, folder: Path) -> Path:
    folder.mkdir()
    for part in parts(whole):
        shutil.copy(part, folder)
    return folder


def command_in(error: BaseException | None) -> list[str]:
    """The words of `tf-mpc resume …` in a message."""
    (words,) = re.findall(r"`tf-mpc (resume [^`]*)`", str(error))
    return shlex.split(words)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(16))
def test_flipped_bits_are_refused_with_the_command_that_goes_on_to_the_same_bytes(whole, tmp_path, seed):
    folder, draw = copied(whole, tmp_path / "flipped run"), random.Random(seed)
    for _ in range(draw.choice([1, 1, 3])):
        part = draw.choice(parts(folder))
        raw = bytearray(part.read_bytes())
        at = draw.randrange(len(raw))
        raw[at] ^= 1 << draw.randrange(8)
        part.write_bytes(raw)
    before = {part.name: part.read_bytes() for part in parts(folder)}
    done = call("resume", folder)
    if done.exit_code:
        assert isinstance(done.exception, JournalError)
        assert "cannot be relied on" in str(done.exception)
        assert {part.name: part.read_bytes() for part in parts(folder)} == before, "a refusal changes nothing"
        first = parts(folder)[0].read_bytes().split(b"\n")[0]
        if first != parts(whole)[0].read_bytes().split(b"\n")[0]:
            assert "start the run again" in str(done.exception)
            return
        done = call(*command_in(done.exception))
        assert done.exit_code == 0, done.output + str(done.exception)
        lost = (folder / "journal.jsonl.lost").read_bytes()
        assert b"".join(before.values()).endswith(lost)
    assert results(folder) == results(whole)
    assert not read_journal(folder / "journal.jsonl").torn


def test_a_part_that_is_missing_is_gone_on_without(whole, tmp_path):
    folder = copied(whole, tmp_path / "missing")
    (folder / "journal.0002.jsonl").unlink()
    error = call("resume", folder).exception
    assert "journal.0002.jsonl: is not there, but later parts are" in str(error)
    assert call(*command_in(error)).exit_code == 0
    assert results(folder) == results(whole)


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
