"""BOPTEST_TOKEN goes to services that its owner named, not to one that a file names."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

import thermoforce_mpc as tf
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.plants.boptest.plant import allow_token, check_token

URL = "http://service.invalid:8000"
SCENARIO = (
    f"testcase: bestest_hydronic_heat_pump\ncontroller: {{name: native}}\nplant: {{kind: boptest, url: '{URL}'}}\n"
)


@pytest.fixture(autouse=True)
def owner_of_a_token(monkeypatch, tmp_path, unhurried):
    """Who has named no service on this machine so far."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("BOPTEST_TOKEN", "kept-in-a-drawer-0123456789")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.yaml").write_text(SCENARIO)


def call(*words: str) -> BaseException | None:
    return CliRunner().invoke(cli, words).exception


def test_a_scenario_of_others_gets_no_token_until_its_service_is_named(tmp_path):
    run = ("run", "--config", "theirs.yaml", "--quiet")
    refused = call(*run)
    assert isinstance(refused, ConfigError)
    assert f"{URL} is named by a file, and BOPTEST_TOKEN would go there" in str(refused)
    assert f"--url {URL}" in str(refused)
    assert not list((tmp_path / "runs").glob("*")), "nothing is left behind"
    assert isinstance(call(*run, "--url", URL), PlantError), "it is asked, and does not exist"
    assert isinstance(call(*run), PlantError), "it was named once"


@pytest.mark.parametrize("words", [("--url", URL), ("--set", f"plant.url={URL}")])
def test_a_service_named_on_the_command_line_is_named(words):
    assert isinstance(call("run", "--config", "theirs.yaml", "--quiet", *words), PlantError)


def test_without_a_token_there_is_nothing_to_keep(monkeypatch):
    monkeypatch.delenv("BOPTEST_TOKEN")
    assert isinstance(call("run", "--config", "theirs.yaml", "--quiet"), PlantError)
    monkeypatch.setenv("BOPTEST_TOKEN", "set since")
    assert isinstance(call("run", "--config", "theirs.yaml", "--quiet"), ConfigError), "that was not for this token"


def test_a_service_named_in_python_is_named():
    with pytest.raises(PlantError):
        tf.run("bestest_hydronic_heat_pump", controller="native", plant={"kind": "boptest", "url": URL}, progress=False)


@pytest.mark.parametrize("url", ["http://127.0.0.1:8000", "http://localhost", "https://[::1]:443/base"])
def test_this_machine_is_named(url):
    check_token(url)


@pytest.mark.parametrize("url", [f"{URL}/other", "http://SERVICE.invalid:8000"])
def test_paths_of_one_host_share_its_token(monkeypatch, url):
    with pytest.raises(ConfigError):
        check_token(url)
    allow_token(URL)
    check_token(url)


@pytest.mark.parametrize(
    "url", ["https://service.invalid:8000", "http://service.invalid", "http://127.0.0.1.invalid:8000"]
)
def test_another_port_or_host_is_another_service(monkeypatch, url):
    allow_token(URL)
    with pytest.raises(ConfigError):
        check_token(url)
    monkeypatch.setenv("BOPTEST_URL", url)
    check_token(url)
