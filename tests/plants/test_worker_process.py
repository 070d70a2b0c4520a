"""A simulation's own process gets what it needs of the environment, and nothing that it could tell."""

from __future__ import annotations

import os
from contextlib import closing

from thermoforce_mpc.dependencies import SWITCHES
from thermoforce_mpc.plants.worker_process import PASSED, WorkerProcess

_TELLING = """
import os
from thermoforce_mpc.plants.worker_process import channel

def main():
    receive, send = channel()
    while receive():
        send(dict(os.environ))
"""


def test_a_worker_is_handed_no_token_and_what_its_user_passes(tmp_path, monkeypatch):
    (tmp_path / "telling.py").write_text(_TELLING)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    for name in ("BOPTEST_TOKEN", "AWS_SECRET_ACCESS_KEY", "LM_LICENSE_FILE", "DYMOLA_LICENCE"):
        monkeypatch.setenv(name, "kept-in-a-drawer")
    monkeypatch.setenv(PASSED, "LM_LICENSE_FILE, DYMOLA_*")
    with closing(WorkerProcess("telling", "a worker", tmp_path, 60.0)) as worker:
        handed = worker.ask("start at", True)
    assert {name for name, value in handed.items() if value == "kept-in-a-drawer"} == {
        "LM_LICENSE_FILE",
        "DYMOLA_LICENCE",
    }
    assert handed["PATH"] == os.environ["PATH"]
    assert handed["TMPDIR"] == str(tmp_path)
    assert all(handed[switch.variable] for switch in SWITCHES)
