"""What dependencies do by themselves is off: no name is asked for, and nothing is left outside our folders.

Of those that are large, torch and the libraries of other models are not loaded with the shipped forecaster.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from sealed import can_trap_names, sealed
from simulated_building import files_of_now

from thermoforce_mpc.cli.inside import installation as doctor
from thermoforce_mpc.dependencies import SWITCHES

_LOADED = """
import sys
from thermoforce_mpc.cli import main
try:
    main()
finally:
    loaded = {"torch", "transformers", "chronos"} & set(sys.modules)
    assert not loaded, f"loaded: {loaded}"
    assert sys.argv[1] == "serve" or "onnxruntime" in sys.modules, "no forecaster ran"
"""
TF_MPC = [sys.executable, "-c", _LOADED]
_SERVED = """
import re, signal, subprocess, sys
from boptest_client import BoptestClient
running = subprocess.Popen([*sys.argv[1:], "--port", "0"], stdout=subprocess.PIPE, text=True)
try:
    url = re.search(r"http://127\\.0\\.0\\.1:\\d+", running.stdout.readline())[0]
    with BoptestClient(url, "bestest_hydronic_heat_pump") as client:
        client.advance()
finally:
    running.send_signal(signal.SIGINT)
    running.wait(60)
"""
_HOUSE = ["--model", "model", "--map", "map.yaml"]
_CONTROL = ["controller.step_s=3600", "controller.horizon_h=12", "controller.gate.enabled=false"]
_PLAN = [
    "--data", "house.csv", "--forecast", "tomorrow.csv", "--step", "1h", "--hours", "12", "--set", "gate.enabled=false",
    "--plot", "plan.png",
]  # fmt: skip
_RUN = ["run", "--testcase", "bestest_hydronic_heat_pump", "--days", "0.05", "--baselines", ""]
_RUN += [f"--set=identification.{one}" for one in ("days=1.5", "most_days=1.5")]
_RUN += [
    f"--set=identification.options.{one}" for one in ("modulation=linear", "sun_on_sensor=false", "late_sensor=false")
]
_ALL = {
    "run": [*TF_MPC, *_RUN],
    "control": [*TF_MPC, "control", *_HOUSE, *(f"--set={one}" for one in _CONTROL), "--dry-run"],
    "plan": [*TF_MPC, "plan", *_HOUSE, *_PLAN],
    "serve": [sys.executable, "-c", _SERVED, *TF_MPC, "serve"],
}


def outside(files: tuple[str, ...]) -> list[str]:
    """Of what a command left, what is neither in its folder nor in our cache."""
    return [file for file in files if not file.startswith(("work/", "home/.cache/thermoforce-mpc/"))]


@pytest.mark.slow
@pytest.mark.parametrize("command", _ALL)
def test_a_command_asks_for_no_name_loads_no_torch_and_leaves_nothing_elsewhere(command, tmp_path):
    (tmp_path / "work").mkdir()
    files_of_now(tmp_path / "work")
    # One compiles anew, in the folder that a user would have for it; compiling takes most of the others' time.
    kept = {} if command == "plan" else {"NUMBA_CACHE_DIR": os.environ["NUMBA_CACHE_DIR"]}
    done = sealed(_ALL[command], tmp_path, **kept)
    assert done.code == 0, done.output[-3000:]
    assert outside(done.files) == []
    if not can_trap_names():
        pytest.skip("only files were looked at: this user may make no network (unshare), so no names were trapped")
    assert done.names == ()


@pytest.mark.slow
def test_the_trap_sees_names_and_files(tmp_path):
    """What the test above would see, were the switches not set."""
    wanted = {switch.variable: "0" for switch in SWITCHES}
    ask = "import socket\ntry:\n  socket.getaddrinfo('collector.test', 443)\nexcept OSError:\n  pass"
    done = sealed([sys.executable, "-c", f"import onnxruntime, thermoforce_mpc\n{ask}"], tmp_path, **wanted)
    assert done.code == 0, done.output
    # onnxruntime before 1.32 writes nothing.
    assert all(file.startswith(("home/.cache/Microsoft/", "tmp/")) for file in done.files)
    if can_trap_names():
        assert "collector.test" in done.names


@pytest.mark.parametrize("way", ["thermoforce_mpc", "controllers", "thermoforce_mpc.cli", "benchmarks.pretraining"])
def test_every_way_in_sets_the_switches_before_a_dependency_is_imported(way):
    code = (
        "import os, sys\n"
        "class Early:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name in ('onnxruntime', 'huggingface_hub', 'numpy', 'torch'):\n"
        f"            assert all(one in os.environ for one in {[one.variable for one in SWITCHES]}), name\n"
        "sys.meta_path.insert(0, Early())\n"
        f"import {way}\n"
        f"assert all(one in os.environ for one in {[one.variable for one in SWITCHES]})\n"
    )
    bare = {key: value for key, value in os.environ.items() if key not in {one.variable for one in SWITCHES}}
    done = subprocess.run([sys.executable, "-c", code], env=bare, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_doctor_says_what_is_off_and_what_the_user_has_on(monkeypatch, tmp_path: Path):
    def told() -> doctor.Finding:
        (finding,) = doctor.examine(testcase="bestest_hydronic_heat_pump", folder=tmp_path, only=["reports"])
        return finding

    assert told().state == "ok"
    assert all(switch.package in told().told for switch in SWITCHES)
    for switch in SWITCHES:
        monkeypatch.setenv(switch.variable, "0")
        assert told().state == "warning"
        assert f"{switch.variable}=0" in told().told
        monkeypatch.setenv(switch.variable, switch.value)
