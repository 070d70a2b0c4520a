"""`tf-mpc init --for`: files of a real building that are valid as they are, and what they say."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.inside.files import HOMES
from thermoforce_mpc.connections.registry import connection_settings
from thermoforce_mpc.errors import ConfigError


def told(*words, env=None):
    return CliRunner().invoke(cli, list(map(str, words)), env=env)


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOMES)
def test_its_files_are_valid_and_never_overwritten(kind, tmp_path):
    folder = tmp_path / kind
    assert told("init", folder, "--for", kind).exit_code == 0
    secrets = {"HOME_ASSISTANT_TOKEN": "x", "MQTT_PASSWORD": "x"}
    for name in [] if kind == "boptest" else ["map.yaml", "connection.yaml"]:
        result = told("validate", folder / name, env=secrets)
        assert result.exit_code == 0, result.output
        assert "valid" in result.output
    again = told("init", folder, "--for", kind)
    assert "never overwritten" in str(again.exception)
    for path in folder.glob("*.yaml"):
        assert max(map(len, path.read_text().splitlines())) <= 120


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in HOMES if kind != "boptest"])
@pytest.mark.parametrize("proposed", [False, True])
def test_the_schema_that_a_map_names_is_there(kind, proposed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stamps = [f"2026-01-0{day} {hour:02}:00" for day in (1, 2) for hour in range(24)]
    rows = [f"{at},2{k % 3}.5,{k % 7}" for k, at in enumerate(stamps)]
    Path("house.csv").write_text("\n".join(["time,room,outdoor", *rows, ""]))
    assert told("init", "home", "--for", kind, *(["--data", "house.csv"] if proposed else [])).exit_code == 0
    first = Path("home/map.yaml").read_text().splitlines()[0]
    named = re.fullmatch(r"# yaml-language-server: \$schema=(.+)", first)
    assert "zones" in json.loads((Path("home") / named[1]).read_text())["properties"]


def test_what_is_to_be_done_next_is_said_as_one_types_it(tmp_path):
    said = told("init", tmp_path / "my house", "--for", "mqtt").output
    assert f"cd '{tmp_path / 'my house'}' && tf-mpc validate map.yaml\nThen: tf-mpc commission connection.yaml" in said


def test_a_scenario_of_a_service_names_its_address(tmp_path):
    assert told("init", tmp_path, "--for", "boptest").exit_code == 0
    assert yaml.safe_load((tmp_path / "scenario.yaml").read_text())["plant"] == {
        **yaml.safe_load((tmp_path / "scenario.yaml").read_text())["plant"], "kind": "boptest", "url": "http://127.0.0.1:80"
    }  # fmt: skip


def test_the_automation_of_home_assistant_gives_back_what_the_connection_releases(tmp_path):
    told("init", tmp_path, "--for", "home-assistant")
    options = yaml.safe_load((tmp_path / "connection.yaml").read_text())["options"]
    package = yaml.safe_load((tmp_path / "package.yaml").read_text())
    (automation,) = package["automation"]
    released = options["actuators"]["heat_pump"]
    assert automation["triggers"][0]["event_data"]["entity_id"] == options["watchdog"]
    assert options["watchdog"].removeprefix("timer.") in package["timer"]
    assert automation["actions"][0]["data"]["temperature"] == released["release"]
    assert automation["actions"][0]["target"]["entity_id"] == released["entity"]


def test_no_file_holds_a_secret_and_a_missing_one_is_named(tmp_path):
    told("init", tmp_path, "--for", "mqtt")
    result = told("validate", tmp_path / "connection.yaml", env={"MQTT_PASSWORD": ""})
    assert "MQTT_PASSWORD" in str(result.exception)


def test_wrong_connection_files_are_refused(tmp_path):
    file = tmp_path / "connection.yaml"
    for text, said in (
        ("name: mqtt\noptions: {hots: a}\n", "hots"),
        ("name: mqt\noptions: {}\n", "mqtt"),
        ("name: 1\noptions: 2\n", "options"),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=said):
            raise told("validate", file).exception
    with pytest.raises(ConfigError, match="no such file"):
        connection_settings("none.yaml", {})


def test_a_scenario_is_no_connection_and_the_command_for_it_is_named(tmp_path):
    (tmp_path / "scenario.yaml").write_text("testcase: bestest_hydronic_heat_pump\n")
    with pytest.raises(ConfigError, match=r"no connection: tf-mpc run --config .*scenario\.yaml"):
        connection_settings(str(tmp_path / "scenario.yaml"), {})


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
def test_systemd_knows_every_key_of_the_unit(tmp_path):
    told("init", tmp_path, "--for", "files")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / "tf-mpc.service")], capture_output=True, text=True
    )
    assert "Unknown" not in done.stderr


def test_a_real_building_is_no_test_case(tmp_path):
    result = told("init", tmp_path, "--for", "mqtt", "--testcase", "bestest_air")
    assert "--testcase: --for mqtt is a real building" in str(result.exception)
    assert not list(tmp_path.iterdir())
