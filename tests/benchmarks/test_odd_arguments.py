"""Arguments of benches that make no sense are refused at once, not after hours, and by words."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError, StorageError


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("contest modulation --houses 0 --windows=", "no building is left to judge on"),
        ("contest modulation --json .", "is a directory"),
        ("contest modulation --json file/result.json", "file is a file"),
        ("detectors --json file/result.json", "file is a file"),
        ("saving --seed -1", "not in the range"),
        ("worth --history x", "expected whole days separated by commas, such as 1,3"),
        ("worth --history 0,3", "a day at least"),
        ("worth --free-responses nosuch", "nosuch"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_runs(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    told = CliRunner().invoke(cli, ["bench", *words.split()], standalone_mode=False)
    assert isinstance(told.exception, ConfigError | StorageError | click.UsageError)
    assert message in str(told.exception)
