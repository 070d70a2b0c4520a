"""Folders that are whole or absent, also where two commands write one at once."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

from simple_house import simple_model

from thermoforce_mpc import files
from thermoforce_mpc.comparison.store import Identified
from thermoforce_mpc.errors import StorageError
from thermoforce_mpc.files import write_folder

FILES = {"model.json": b"{}", "arrays.safetensors": b"\0" * 1000}


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_two_commands_may_replace_one_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(files.os, "fsync", lambda file: None)  # takes time, and the chance to meet
    together, wrong = threading.Barrier(2), []

    def replace() -> None:
        for _ in range(100):
            together.wait()
            try:
                write_folder(tmp_path / "model", FILES)
            except StorageError as error:
                wrong.append(error)

    threads = [threading.Thread(target=replace) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert [content(path) for path in tmp_path.iterdir()] == [FILES], "no leftovers"


def test_a_model_that_another_command_wrote_meanwhile_stays(tmp_path, monkeypatch):
    other = Identified.of(simple_model())

    def meanwhile(file: int) -> None:
        monkeypatch.undo()
        other.write(tmp_path / "model")

    monkeypatch.setattr(files.os, "fsync", meanwhile)
    Identified(FILES).write(tmp_path / "model")
    assert Identified.read(tmp_path / "model") == other


def test_a_model_that_is_there_stays_and_one_that_cannot_be_read_is_replaced(tmp_path):
    first = Identified.of(simple_model())
    first.write(tmp_path / "model")
    Identified(FILES).write(tmp_path / "model")
    Identified(refused="too short").write(tmp_path / "model")
    assert Identified.read(tmp_path / "model") == first
    (tmp_path / "damaged" / "folder").mkdir(parents=True)
    Identified(FILES).write(tmp_path / "damaged")
    assert content(tmp_path / "damaged") == FILES


def test_a_folder_is_replaced_unless_it_is_to_be_kept(tmp_path):
    folder = tmp_path / "model"
    write_folder(folder, {"file": b"first", "more": b""}, keep=True)
    write_folder(folder, {"file": b"second"}, keep=True)
    assert content(folder) == {"file": b"first", "more": b""}
    write_folder(folder, {"file": b"third"})
    assert content(folder) == {"file": b"third"}
    assert list(tmp_path.iterdir()) == [folder]
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755


def test_files_are_on_the_disk_before_their_folder_is_there(tmp_path, monkeypatch):
    synced = []

    def note(file: int) -> None:
        assert not (tmp_path / "model").exists()
        synced.append(os.fstat(file).st_ino)

    monkeypatch.setattr(files.os, "fsync", note)
    write_folder(tmp_path / "model", FILES)
    assert sorted(synced) == sorted(path.stat().st_ino for path in (tmp_path / "model").iterdir())
