from __future__ import annotations

import json
from pathlib import Path

import pytest

from thermoforce_mpc.errors import ConfigError, StorageError
from thermoforce_mpc.files import file_sha256, write_json
from thermoforce_mpc.records.run_folder import create_run_folder


def test_folders_are_numbered_and_never_reused(tmp_path):
    made = [create_run_folder(None, "a-b", tmp_path) for _ in range(3)]
    assert [folder.name for folder in made] == ["a-b-001", "a-b-002", "a-b-003"]


@pytest.mark.parametrize("what", ["file", "full folder"])
def test_an_existing_target_is_refused_untouched(tmp_path, what):
    out = tmp_path / "out"
    if what == "file":
        out.write_text("x")
    else:
        out.mkdir()
        (out / "x").write_text("x")
    with pytest.raises(ConfigError, match="never overwritten"):
        create_run_folder(out, "s")
    assert out.exists()


def test_a_folder_that_cannot_be_made_is_one_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="file is a file, no folder; choose another name"):
        create_run_folder(tmp_path / "file" / "below", "s")


def test_json_is_valid_where_a_number_is_missing(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": float("nan"), "b": [float("inf"), 1.5], "c": {"d": None}})
    assert json.loads(path.read_text()) == {"a": None, "b": [None, 1.5], "c": {"d": None}}


def test_hash_is_of_the_bytes(tmp_path: Path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    assert file_sha256(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
