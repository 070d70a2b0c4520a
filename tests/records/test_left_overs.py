"""What a killed process left is removed, and what has another name elsewhere is not written."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import sweep, write_folder, write_whole
from thermoforce_mpc.records.run_folder import sole_use

KILLED = """
import os, signal, sys
from pathlib import Path
from thermoforce_mpc.files import write_folder, written
what = Path(sys.argv[1])
if what.suffix:
    with written(what) as aside:
        aside.write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
os.fsync = lambda file: os.kill(os.getpid(), signal.SIGKILL)
write_folder(what, {"a": b"half"})
"""


@pytest.mark.parametrize("name", ["levels.json", "model"])
def test_what_a_killed_process_left_goes_with_a_later_write(tmp_path, name):
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / name)], check=False)
    assert killed.returncode == -9
    (left,) = tmp_path.iterdir()
    other = tmp_path / f".{os.getppid()}-aaaaaaaa.part.csv"
    other.write_text("of a process that is there")
    old_s = time.time() - 3600.0
    for path in (left, other):
        os.utime(path, (old_s, old_s))
    write_whole(tmp_path / "new.json", "{}")
    write_folder(tmp_path / "folder", {"a": b""})
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([other.name, "new.json", "folder"])


def test_a_file_that_is_being_written_stays(tmp_path):
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    young = tmp_path / f".{int(gone.stdout)}-aaaaaaaa.part"
    young.touch()
    sweep(tmp_path)
    assert young.exists(), "its process may be on another machine"
    with sole_use(tmp_path):
        assert not young.exists(), "nobody else has this folder"


@pytest.mark.parametrize("name", ["journal.jsonl", "log.jsonl", ".lock"])
def test_a_hard_link_in_a_folder_of_a_run_is_not_written(tmp_path, name):
    theirs, run = tmp_path / "theirs.txt", tmp_path / "run"
    run.mkdir()
    theirs.write_text("as it was")
    os.link(theirs, run / name)
    error = CliRunner().invoke(cli, ["resume", str(run)]).exception
    assert isinstance(error, ConfigError)
    assert f"{run / name}: has another name elsewhere (a hard link)" in str(error)
    assert theirs.read_text() == "as it was"
    assert Path(run / name).exists()
