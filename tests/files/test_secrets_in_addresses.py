"""A password in an address would stand in logs, journals and errors: every address that we take is refused with one."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from boptest_client import BadAddress, BoptestClient
from thermoforce_mpc.cli import cli
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.cluster import DaskEngine
from thermoforce_mpc.providers.registry import build_provider

# A password with a slash, as some generators make it, hides what is host and what is path.
ADDRESSES = ["http://me:hunter2@127.0.0.1:1", "https://me:hunt/er2@127.0.0.1:1", "http://hunter2@127.0.0.1:1/x"]


def refused(what, *error):
    with pytest.raises(error) as problem:
        what()
    assert "hunt" not in str(problem.value)
    assert "er2" not in str(problem.value)


@pytest.mark.parametrize("url", ADDRESSES)
def test_no_address_holds_a_password(url, monkeypatch):
    monkeypatch.setenv("HOME_ASSISTANT_TOKEN", "x")
    refused(lambda: build_connection("home-assistant", {"url": url}), ConfigError)
    refused(lambda: build_connection("mqtt", {"host": url}), ConfigError)
    refused(lambda: build_connection("mqtt", {"host": url.partition("//")[2]}), ConfigError)
    for name in ("open-meteo", "awattar", "nord-pool"):
        refused(lambda of=name: build_provider(of, {"url": url}), ConfigError)
    refused(lambda: BoptestClient(url, "bestest_air"), BadAddress)
    refused(lambda: DaskEngine(url.replace("http", "tcp")), ConfigError)


def test_nor_does_the_command_line_say_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", "--testcase", "bestest_hydronic_heat_pump", "--url", ADDRESSES[0], "--days", "1"]
    told = CliRunner().invoke(cli, words)
    assert told.exit_code != 0
    assert "hunter2" not in told.output + str(told.exception)
    assert not [file for file in tmp_path.rglob("*") if file.is_file() and b"hunter2" in file.read_bytes()]
