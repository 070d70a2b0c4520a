"""`tf-mpc serve` as a user starts and stops it."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys

import pytest
from click.testing import CliRunner
from waiting import LONG_S

from boptest_client import BoptestClient
from thermoforce_mpc.cli.live.serve import serve as command
from thermoforce_mpc.errors import ConfigError, PlantError

SERVE = [sys.executable, "-c", "from thermoforce_mpc.cli import main; main()", "serve"]


@pytest.mark.slow
def test_it_says_where_it_serves_and_ends_on_interrupt():
    def interruptible() -> None:  # whoever runs the tests in the background may have had interrupts ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    with subprocess.Popen(
        [*SERVE, "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=interruptible,
    ) as running:
        try:
            line = running.stdout.readline()
            url = re.search(r"http://127\.0\.0\.1:\d+", line)[0]
            with BoptestClient(url, "bestest_hydronic_heat_pump") as client:
                assert client.advance()["time"] == 3600
        finally:
            running.send_signal(signal.SIGINT)
        try:
            _, err = running.communicate(timeout=LONG_S)
        except subprocess.TimeoutExpired:
            running.kill()  # else leaving this block would wait for ever
            raise
    assert running.returncode in (0, 130), err
    assert "Traceback" not in err


def test_an_address_in_use_and_a_missing_file_are_told():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PlantError, match=f"cannot listen on 127.0.0.1:{port}"):
            CliRunner().invoke(command, ["--port", str(port)], catch_exceptions=False, standalone_mode=False)
    with pytest.raises(ConfigError, match=r"nowhere\.csv"):
        CliRunner().invoke(command, ["--prices", "nowhere.csv"], catch_exceptions=False, standalone_mode=False)


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "flask", None)
    for name in [name for name in sys.modules if name.startswith("thermoforce_mpc.service")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ConfigError, match=r"pip install 'thermoforce-mpc\[serve\]'"):
        CliRunner().invoke(command, [], catch_exceptions=False, standalone_mode=False)
