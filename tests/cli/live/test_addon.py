"""The add-on of Home Assistant: keys that are documented, what it starts, and sources that make its image."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys

import pytest
import yaml
from places import ROOT

from thermoforce_mpc.cli.live.control import control
from thermoforce_mpc.records.run_folder import LOCK
from thermoforce_mpc.service.page_process import PageSettings
from thermoforce_mpc.version import VERSION
from tools.addon import main, put_together

# https://developers.home-assistant.io/docs/add-ons/configuration, of which these are required:
REQUIRED = {"name", "version", "slug", "description", "arch"}
DOCUMENTED = REQUIRED | {
    "machine", "url", "startup", "webui", "boot", "ports", "ports_description", "host_network", "host_ipc", "host_dbus",
    "host_pid", "host_uts", "hassio_api", "hassio_role", "homeassistant_api", "docker_api", "privileged", "full_access",
    "apparmor", "map", "environment", "audio", "video", "gpio", "usb", "uart", "udev", "devicetree", "kernel_modules",
    "stdin", "legacy", "options", "schema", "image", "timeout", "tmpfs", "discovery", "services", "ingress", "auth_api",
    "ingress_port", "ingress_entry", "ingress_stream", "panel_icon", "panel_title", "panel_admin", "backup", "init",
    "backup_pre", "backup_post", "backup_exclude", "advanced", "stage", "watchdog", "realtime", "journald",
    "breaking_versions", "homeassistant",
}  # fmt: skip
TYPES = r"(str|bool|int|float|email|url|password|port|match\(.+\)|list\(.+\)|device)(\(.*\))?\??"


@pytest.fixture(scope="module")
def config():
    return yaml.safe_load((ROOT / "addon" / "config.yaml").read_text())


@pytest.fixture(scope="module")
def runs():
    return runpy.run_path(str(ROOT / "addon" / "run.py"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    there = tmp_path_factory.mktemp("addon")
    put_together(there)
    return there


def test_its_keys_are_documented_and_its_values_of_the_kinds_there(config):
    assert REQUIRED <= set(config) <= DOCUMENTED
    assert config["version"] == VERSION
    assert re.fullmatch(r"[a-z0-9_]+", config["slug"])
    assert set(config["arch"]) <= {"aarch64", "amd64"}
    assert config["startup"] in ("initialize", "system", "services", "application", "once")
    assert config["backup"] in ("hot", "cold")
    assert config["map"] == [{"type": "addon_config"}]
    assert config["timeout"] >= 90, "as long as systemd waits"


def test_every_option_has_its_kind_and_a_value_of_it(config):
    schema, options = config["schema"], config["options"]
    assert set(options) == set(schema)
    for name, kind in schema.items():
        if isinstance(kind, list):
            assert options[name] == []
            kinds = kind[0].values() if isinstance(kind[0], dict) else kind
            assert all(re.fullmatch(TYPES, one) for one in kinds)
        else:
            assert re.fullmatch(TYPES, kind)
            assert isinstance(options[name], str)
    assert schema["secrets"][0]["value"] == "password", "Home Assistant hides what is typed there"
    modes = schema["mode"].removeprefix("list(").removesuffix(")").split("|")
    (given,) = [one for one in control.params if one.name == "mode"]
    assert set(modes) == set(given.type.choices)
    assert options["mode"] == "shadow", "it sets nothing until somebody says so"


def test_it_starts_control_with_its_page_behind_ingress(config, runs, tmp_path):
    words = runs["command"](config["options"] | {"settings": ["controller.horizon_h=24"]})
    assert words[:2] == ["tf-mpc", "control"]
    known = {name for one in control.params for name in one.opts}
    given = dict(zip(words[2::2], words[3::2], strict=True))
    assert set(given) <= known
    assert given["--model"] == "/config/my_house"
    assert given["--set"] == "controller.horizon_h=24"
    settings = PageSettings.of(given["--page"], tmp_path, None)
    assert settings.ingress
    assert settings.port == config["ingress_port"]
    assert "--model" not in runs["command"](config["options"] | {"mode": "probe"})


def test_secrets_are_in_the_environment_and_not_in_the_command(config, runs):
    options = config["options"] | {"secrets": [{"name": "MQTT_PASSWORD", "value": "kept"}]}
    environment = runs["environment"](options, {"SUPERVISOR_TOKEN": "token", "PATH": "/bin"})
    assert environment["HOME_ASSISTANT_TOKEN"] == "token"
    assert environment["MQTT_PASSWORD"] == "kept"
    assert environment["PATH"] == "/bin"
    assert "kept" not in shlex.join(runs["command"](options))


def test_its_image_installs_what_ours_does(folder):
    ours, text = (ROOT / "Dockerfile").read_text(), (folder / "Dockerfile").read_text()
    installs = re.search(r"^RUN .*?runner$", ours, re.M | re.S)[0]
    assert installs in text
    for source in re.findall(r"^COPY (\S+)", text, re.M):
        assert (folder / source).exists()
    for source in re.findall(r"/src/(\S+)", text):
        assert (folder / "src" / source).exists()
    assert "/data/control/log.jsonl" in text
    assert not list(folder.rglob("__pycache__"))
    assert not list(folder.rglob(LOCK))
    with pytest.raises(SystemExit, match="is not empty"):
        main([str(folder)])


@pytest.mark.slow
def test_its_sources_make_the_wheel(folder, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=folder / "src", capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("*.whl"))) == 1
