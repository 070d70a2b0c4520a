"""A full disk, a folder removed or read-only, two runs in one folder: a named error, and nothing is damaged."""

from __future__ import annotations

import errno
import json
import logging
import os
import resource
import shutil
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from click.testing import CliRunner
from places import ROOT
from rich.console import Console
from simple_house import SimpleHouse, simple_model
from waiting import LONG_S

from thermoforce_mpc.cli import cli, main
from thermoforce_mpc.cli.running import comparing
from thermoforce_mpc.comparison.store import Store
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import ConfigError, PlantError, StorageError, Terminated
from thermoforce_mpc.experiment import experiment as experiment_module
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.files import write_whole, written
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.records import run_folder
from thermoforce_mpc.records.journal import read_journal
from thermoforce_mpc.records.run_folder import logging_to

WORDS = ("run", "--testcase", "bestest_hydronic_heat_pump", "--controller", "thermostat", "--baselines", "")


class WatchedHouse(SimpleHouse):
    """Calls `at_noon` once, on the first day."""

    def __init__(self, at_noon=lambda: None) -> None:
        super().__init__()
        self.at_noon = at_noon

    def advance(self, u, duration_s):
        if self.now_s >= 10.5 * DAY_S and self.at_noon:
            at_noon, self.at_noon = self.at_noon, None
            at_noon()
        return super().advance(u, duration_s)


@pytest.fixture
def call(monkeypatch):
    """`tf-mpc` in this process on the house given; the result of the call."""

    def called(house: SimpleHouse, *words: object):
        monkeypatch.setattr(ChosenPlant, "build", lambda *_: house)
        return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)

    return called


@contextmanager
def files_of_at_most(n_bytes: int) -> Iterator[None]:
    """The system refuses to make a file longer, as it does where the disk is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.slow
def test_a_full_disk_ends_a_run_that_goes_on_when_there_is_room(call, tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "full"
    assert call(SimpleHouse(), *WORDS, "--days", 2, "--out", whole).exit_code == 0
    house = SimpleHouse()
    with files_of_at_most(100_000):
        done = call(house, *WORDS, "--days", 2, "--out", folder)
    assert isinstance(done.exception, StorageError)
    assert "journal.jsonl: cannot be written" in str(done.exception)
    assert house.closed
    left = read_journal(folder / "journal.jsonl")
    assert not left.torn
    assert 90_000 < left.size <= 100_000
    assert not list(folder.glob(".*"))
    assert call(SimpleHouse(), "resume", folder).exit_code == 0
    for name in ("trajectory.csv", "steps.csv", "journal.jsonl"):
        ours, theirs = (folder / name).read_text(), (whole / name).read_text()
        assert len(ours.splitlines()) == len(theirs.splitlines()), name
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    assert not (folder / "INCOMPLETE.txt").exists()


def test_a_full_disk_before_the_first_step_leaves_nothing_behind(call, tmp_path):
    house = SimpleHouse()
    with files_of_at_most(100):
        done = call(house, *WORDS, "--days", 1, "--out", tmp_path / "full")
    assert isinstance(done.exception, StorageError)
    assert not (tmp_path / "full").exists()


def test_a_journal_that_cannot_be_made_leaves_nothing_behind(call, tmp_path, monkeypatch):
    opened = os.open

    def refuse(path, *given, **options):
        if Path(path).name == "journal.jsonl":
            raise OSError(28, "no room for another file")
        return opened(path, *given, **options)

    monkeypatch.setattr(os, "open", refuse)
    done = call(SimpleHouse(), *WORDS, "--days", 1, "--out", tmp_path / "full")
    assert isinstance(done.exception, StorageError)
    assert not (tmp_path / "full").exists()


def test_a_log_that_a_full_disk_does_not_take_raises_nothing(tmp_path):
    with files_of_at_most(0), logging_to(tmp_path):
        logging.getLogger("thermoforce_mpc").info("not taken")
    assert not (tmp_path / "log.jsonl").read_text()


@pytest.fixture
def with_model(tmp_path):
    """The words of a run whose models are there before its first step."""
    simple_model().save(tmp_path / "model")
    return (
        "run", "--testcase", "bestest_hydronic_heat_pump", "--baselines", "", "--days", "0.25", "--set", "step_s=3600",
        "--model", tmp_path / "model", "--set", "controller.options.free_response.name=chronos",
        "--out", tmp_path / "run",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("error", "code"), [(KeyboardInterrupt(), 130), (Terminated(15), 143), (StorageError("no room"), 6)]
)
def test_whoever_ends_a_run_is_told_where_it_is_and_what_goes_on(tmp_path, monkeypatch, capsys, error, code):
    def ends() -> None:
        raise error

    folder = tmp_path / "run"
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: WatchedHouse(ends))
    monkeypatch.setattr(sys, "argv", ["tf-mpc", *WORDS, "--days", "2", "--out", str(folder)])
    monkeypatch.setattr("thermoforce_mpc.errors.signal.signal", lambda *_: None)
    with warnings.catch_warnings(), pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    printed = capsys.readouterr()
    assert printed.out.startswith(f"Folder: {folder}\n")
    said = printed.err
    assert f"What was recorded until then is in {folder}" in said
    assert said.rstrip().endswith(f"`tf-mpc resume {folder}` goes on from there")


@pytest.mark.parametrize(("end", "code"), [(KeyboardInterrupt, 130), (partial(Terminated, 15), 143)])
@pytest.mark.parametrize(
    "error", [ValueError("cannot close the file"), ImportError("cannot load"), ConfigError("torn")]
)
def test_an_error_that_came_of_an_interruption_is_one(monkeypatch, capsys, error, end, code):
    """As of a ZIP file that is closed while it is written to, and what we make of such an error."""

    def ends(**_: object) -> None:
        try:
            raise end()
        finally:
            raise error

    monkeypatch.setattr("thermoforce_mpc.cli.cli.main", ends)
    with warnings.catch_warnings(), pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    assert capsys.readouterr().err in ("Interrupted.\n", "Terminated.\n")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), Terminated(15)])
def test_whoever_ends_many_runs_is_told_how_many_are_kept(tmp_path, monkeypatch, error):
    def ends(*_: object) -> None:
        raise error

    monkeypatch.setattr(comparing, "outcomes_of", ends)
    with pytest.raises(type(error)) as ended:
        comparing.run_cells([SimpleNamespace(inputs=None)], Store(tmp_path), Console(), None, True, {})
    assert ended.value.__notes__ == [f"0 of 0 runs are kept in {tmp_path}; repeat the command to resume"]


def test_a_run_ended_between_identification_and_the_first_step_can_be_resumed(call, with_model, tmp_path, monkeypatch):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    run = experiment_module.run_closed_loop
    monkeypatch.setattr(experiment_module, "run_closed_loop", interrupted)
    assert call(SimpleHouse(), *with_model).exit_code != 0
    assert (tmp_path / "run" / "INCOMPLETE.txt").read_text() == "This run did not finish: interrupted\n"
    monkeypatch.setattr(experiment_module, "run_closed_loop", run)
    shutil.rmtree(tmp_path / "model")  # the run has its own
    done = call(SimpleHouse(), "resume", tmp_path / "run")
    assert done.exit_code == 0, done.output + str(done.exception)
    assert (tmp_path / "run" / "kpis.json").exists()


@pytest.mark.parametrize(("option", "message"), [("resolutions=8", "resolutions is '8'"), ("backbone=x/y", "x/y")])
def test_a_forecaster_that_cannot_be_had_ends_the_run_before_the_plant_is_asked(call, with_model, option, message):
    house = SimpleHouse()
    house.reset = lambda *_: pytest.fail("the plant was started")
    done = call(house, *with_model, "--set", f"controller.options.free_response.options.{option}")
    assert message in str(done.exception)
    assert not with_model[-1].exists()


def test_a_folder_removed_during_a_run_ends_it(call, tmp_path):
    folder = tmp_path / "gone"
    house = WatchedHouse(lambda: shutil.rmtree(folder))
    done = call(house, *WORDS, "--days", 1, "--out", folder)
    assert isinstance(done.exception, StorageError)
    assert "journal.jsonl: was removed during the run" in str(done.exception)
    assert house.closed
    assert not folder.exists()


def test_a_folder_that_becomes_read_only_ends_the_run(call, tmp_path, monkeypatch):
    """As the system says it; root may write anywhere, so the refusal is made here."""
    true_write, folder = os.write, tmp_path / "read_only"

    def refused(handle: int, data: bytes) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    house = WatchedHouse(lambda: monkeypatch.setattr(os, "write", refused))
    done = call(house, *WORDS, "--days", 1, "--out", folder)
    monkeypatch.setattr(os, "write", true_write)
    assert isinstance(done.exception, StorageError)
    assert "Read-only file system" in str(done.exception)
    assert house.closed
    assert not read_journal(folder / "journal.jsonl").torn


def test_a_folder_that_cannot_be_made_is_refused(call):
    done = call(SimpleHouse(), *WORDS, "--days", 1, "--out", "/proc/self/run")
    assert isinstance(done.exception, StorageError)
    assert "/proc/self/run" in str(done.exception)


@pytest.mark.slow
def test_a_second_run_in_the_same_folder_is_refused_and_the_first_is_whole(call, tmp_path):
    folder, others = tmp_path / "shared", []

    def begin_others() -> None:
        for words in ((*WORDS, "--days", "1", "--out", str(folder)), ("resume", str(folder))):
            # In a thread of its own: click's runner exchanges the streams of this one.
            thread = threading.Thread(target=lambda w=words: others.append(_raised(w)))
            thread.start()
            thread.join()

    assert call(WatchedHouse(begin_others), *WORDS, "--days", 1, "--out", folder).exit_code == 0
    first, second = others
    assert isinstance(first, ConfigError)
    assert "exists already" in str(first)
    assert isinstance(second, ConfigError)
    assert "another run is using this folder" in str(second)
    assert (folder / "report.html").exists()
    assert not (folder / ".lock").exists()


def _raised(words: tuple[str, ...]) -> BaseException | None:
    try:
        cli.main(list(words), standalone_mode=False)
    except Exception as error:
        return error
    return None


@pytest.mark.parametrize("before", [None, "as it was"])
def test_a_file_is_whole_or_as_it_was(tmp_path, before):
    path = tmp_path / "file.txt"
    if before:
        path.write_text(before)
    with files_of_at_most(1000), pytest.raises(StorageError, match=r"file\.txt: cannot be written"):
        write_whole(path, "x" * 2000)
    assert (path.read_text() if path.exists() else None) == before
    assert [file.name for file in tmp_path.iterdir()] == (["file.txt"] if before else [])


def test_what_is_written_aside_keeps_its_suffix_and_vanishes_after_an_error(tmp_path):
    path = tmp_path / "picture.png"
    with written(path) as aside:
        assert aside.suffix == ".png"
        aside.write_bytes(b"1")
        assert not path.exists()
    assert path.read_bytes() == b"1"
    assert path.stat().st_mode & 0o777 == 0o644

    def interrupted() -> None:
        with written(path) as aside:
            aside.write_bytes(b"2")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"1"]
    with pytest.raises(StorageError, match="cannot be written"), written(tmp_path / "nowhere" / "plan.csv"):
        pytest.fail("not reached")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("there.csv/plan.csv", "there.csv is a file, no folder; choose another name"),
        ("folder", "it is a folder; name a file"),
        ("no/such/plan.csv", "there is no .*no; make it, or name another"),
    ],
)
def test_a_file_for_a_folder_and_the_reverse_are_called_that(tmp_path, place, said):
    (tmp_path / "there.csv").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(StorageError, match=said):
        write_whole(tmp_path / place, "x")


def test_a_folder_that_is_a_file_is_called_that_by_every_command_that_makes_one(tmp_path):
    out = tmp_path / "out"
    out.touch()
    of_air = ("--testcase", "bestest_air")
    for words in (
        ("compare", *of_air, "--windows", "30", "--out", str(out)),
        ("fleet", "small", "--out", str(out)),
        ("init", str(out)),
        ("run", *of_air, "--out", str(out / "run")),
    ):
        error = _raised(words)
        assert isinstance(error, StorageError), words
        assert str(error).endswith(f"cannot be written: {out} is a file, no folder; choose another name"), words


def test_a_model_for_which_there_is_no_room_is_a_storage_error_as_every_other_file(tmp_path):
    with files_of_at_most(1000), pytest.raises(StorageError, match="model: cannot be written"):
        simple_model().save(tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "link.txt").symlink_to(Path("there") / "file.txt")
    write_whole(tmp_path / "link.txt", "°C")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "there" / "file.txt").read_text(encoding="utf-8") == "°C"


def test_a_folder_in_which_nothing_can_be_written_is_no_bad_input(call, tmp_path, monkeypatch):
    """As the system says it; root may write anywhere, so the refusal is made here."""

    def refused(lock: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    (tmp_path / "run").mkdir()
    monkeypatch.setattr(run_folder.FileLock, "acquire", refused)
    for words in (("resume", tmp_path / "run"), (*WORDS, "--days", 1, "--out", tmp_path / "run")):
        error = call(SimpleHouse(), *words).exception
        assert isinstance(error, StorageError)
        assert "run: cannot be written (Read-only file system)" in str(error)


def test_a_run_without_memory_for_a_step_ends_in_words_and_goes_on(call, tmp_path, monkeypatch):
    """As after `ulimit -v`: LLVM aborts the process where it gets none, and a solver hangs."""
    folder, limit = tmp_path / "run", resource.getrlimit(resource.RLIMIT_AS)
    short = lambda: monkeypatch.setattr(resource, "getrlimit", lambda which: (1, 1))  # noqa: E731
    done = call(WatchedHouse(short), *WORDS, "--days", 1, "--out", folder)
    assert isinstance(done.exception, StorageError), done.output
    assert "0 MB of memory of this process's limit (ulimit -v) are left" in str(done.exception)
    assert "out of memory" in (folder / "INCOMPLETE.txt").read_text()
    monkeypatch.setattr(resource, "getrlimit", lambda which: limit)
    assert call(SimpleHouse(), "resume", folder).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (MemoryError(), "out of memory: close other programs"),
        (RuntimeError("std::bad_alloc"), "out of memory: close other programs"),
        (ZeroDivisionError("a bug"), "a bug"),
        (StorageError("no room"), "no room"),
    ],
)
def test_a_run_that_a_fault_ends_leaves_report_and_figures_and_goes_on(call, tmp_path, fault, said):
    def fail() -> None:
        raise fault

    folder, whole = tmp_path / "run", tmp_path / "whole"
    done = call(WatchedHouse(fail), *WORDS, "--days", 1, "--out", folder)
    assert said in str(done.exception)
    if "memory" in said:
        assert isinstance(done.exception, StorageError)
        assert f"`tf-mpc resume {folder}` goes on from there" in str(done.exception)
    assert "thermostat was cut off after 0.5 of 1 days" in (folder / "report.html").read_text()
    figures = json.loads((folder / "incomplete_kpis.json").read_text())
    assert figures["controller"] == "thermostat"
    steps = pd.read_csv(folder / "incomplete_trajectory_thermostat.csv")
    kWh = (steps["power_W"] * steps["duration_s"]).sum() / 3.6e6
    assert figures["kpis"]["ener_tot"] * load_testcase(WORDS[2]).area_m2 == pytest.approx(kWh)
    assert call(SimpleHouse(), "resume", folder).exit_code == 0
    assert call(SimpleHouse(), *WORDS, "--days", 1, "--out", whole).exit_code == 0
    assert (folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    assert not list(folder.glob("[iI][nN][cC][oO]*"))


def test_an_interrupted_run_draws_no_report(call, tmp_path):
    def interrupt() -> None:
        raise KeyboardInterrupt

    call(WatchedHouse(interrupt), *WORDS, "--days", 1, "--out", tmp_path / "run")
    assert (tmp_path / "run" / "INCOMPLETE.txt").exists()
    assert not (tmp_path / "run" / "report.html").exists()


def test_a_run_that_cannot_go_on_keeps_its_folder(call, tmp_path):
    """Also one that was ended before its plant was there."""
    scenario = load_scenario(None, {"testcase": WORDS[2], "controller": {"name": "thermostat"}, "baselines": []})
    (tmp_path / "run").mkdir()
    RunBook.begin(tmp_path / "run", Experiment.of(scenario), ["tf-mpc", "run"]).journal.close()
    house = SimpleHouse()
    house.period = lambda name: (_ for _ in ()).throw(PlantError("is away"))
    assert "is away" in str(call(house, "resume", tmp_path / "run").exception)
    assert (tmp_path / "run" / "journal.jsonl").exists()


_IN_TURN = """
import json, sys
from thermoforce_mpc.cli import main
commands, folder = json.loads(sys.argv[1]), sys.argv[2]
for words in commands:
    sys.argv = ["tf-mpc", *(folder if word == "FOLDER" else word for word in words)]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
"""


@pytest.mark.slow
def test_a_folder_may_have_any_name(tmp_path):
    """Bytes that are no text: run, resume, report, explain and watch in a process whose output is bytes."""
    folder = os.fsencode(tmp_path) + b"/\xff\xfe\n[a] \xe2\x82"
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8:strict"}
    commands = [
        [*WORDS, "--days", "0.25", "--no-equal-comfort", "--out", "FOLDER"], ["resume", "FOLDER"], ["report", "FOLDER"],
        ["explain", "FOLDER"], ["watch", "FOLDER", "--once"],
    ]  # fmt: skip
    call = [sys.executable, "-c", _IN_TURN, json.dumps(commands), folder]
    done = subprocess.run(call, env=env, capture_output=True, timeout=LONG_S, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(Path(os.fsdecode(folder), "manifest.json").read_bytes())["command"][-1] == os.fsdecode(folder)
