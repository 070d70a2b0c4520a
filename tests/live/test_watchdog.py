"""The watchdog gives a building back where its controller is stopped or killed, and leaves it to the next one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import wait_for

from thermoforce_mpc.connections.sole import sole_control
from thermoforce_mpc.connections.watchdog import Watchdog
from thermoforce_mpc.errors import PlantError

# A controller that sets a level for a second, says so, and then does nothing more.
_SETS = """
import sys, time
from pathlib import Path
from thermoforce_mpc.connections.files import FilesConnection
from thermoforce_mpc.connections.sole import sole_control
from thermoforce_mpc.connections.watchdog import Watchdog
levels = Path("levels.json")
with sole_control(levels):
    house, dog = FilesConnection(levels=levels), Watchdog("files", {"levels": "levels.json"}, levels, 0.5, Path("dog"))
    dog.about_to_set(["pump"], 1.0, None)
    house.write({"pump": 0.7}, 1.0)
    dog.set(["pump"], 1.0)
    print("set", flush=True)
    time.sleep(600)
"""


def raise_after_setting(dog):
    dog.set(["pump"], 1.0)
    raise PlantError("the building did not take back pump")


def raise_in_an_attempt(dog):
    dog.set(["pump"], 1.0, {"pump": [(21.0, 0.255)]})
    dog.about_to_set(["pump"], 1.0, {"pump": [(20.0, 0.255)]})
    raise PlantError("the building did not take back pump")


def level(folder):
    return json.loads((folder / "levels.json").read_text())["levels"]["pump"]


def memory_MB(pid):
    """The most that a process has taken until now."""
    (line,) = [one for one in Path(f"/proc/{pid}/status").read_text().splitlines() if one.startswith("VmHWM")]
    return int(line.split()[1]) / 1000.0


@pytest.fixture
def controller(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", _SETS], cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=os.environ
    ) as process:
        assert process.stdout.readline() == "set\n"
        yield process
        process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGSTOP, signal.SIGKILL])
def test_a_building_is_given_back_where_its_controller_is_stopped_or_killed(tmp_path, controller, sent):
    controller.send_signal(sent)
    assert level(tmp_path) == 0.7
    wait_for("the building is given back", lambda: level(tmp_path) is None)
    wait_for("the log", lambda: "gave back pump" in (tmp_path / "dog").read_text())
    assert ("has died" in (tmp_path / "dog").read_text()) == (sent is signal.SIGKILL)


@pytest.mark.slow
def test_a_building_that_another_controller_took_over_is_left_to_that_one(tmp_path, controller, monkeypatch):
    controller.kill()
    controller.wait()
    monkeypatch.chdir(tmp_path)
    with sole_control(tmp_path / "levels.json"):
        time.sleep(2.0)
    time.sleep(1.0)
    assert level(tmp_path) == 0.7
    assert "gave back" not in (tmp_path / "dog").read_text()


@pytest.mark.slow
def test_a_building_that_cannot_be_reached_at_first_is_asked_again_after_the_controller_died(tmp_path, controller):
    controller.kill()
    (tmp_path / "levels.json").unlink()
    (tmp_path / "levels.json").mkdir()
    wait_for("a try", lambda: "could not be given back" in (tmp_path / "dog").read_text())
    (tmp_path / "levels.json").rmdir()
    wait_for("the building is given back", (tmp_path / "levels.json").exists)
    assert level(tmp_path) is None
    wait_for("the log", lambda: "gave back pump, at attempt " in (tmp_path / "dog").read_text())
    assert (tmp_path / "dog").read_text().count("could not be given back") == 1, "it is said once"


@pytest.mark.slow
def test_what_a_controller_could_not_give_back_at_its_end_the_watchdog_does(tmp_path):
    levels = tmp_path / "levels.json"
    dog = Watchdog("files", {"levels": str(levels)}, levels, 0.0, tmp_path / "dog")

    with pytest.raises(PlantError), sole_control(levels):
        raise_after_setting(dog)
    dog.close()
    wait_for("the building is given back", levels.exists)
    assert level(tmp_path) is None


@pytest.mark.slow
def test_of_several_things_that_are_set_each_is_kept_for_the_controller(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    levels, sets = tmp_path / "levels.json", ("broker hall", "broker bath")
    dog = Watchdog("files", {"levels": str(levels)}, sets, 0.0, tmp_path / "dog")
    with pytest.raises(PlantError), sole_control(sets):
        raise_after_setting(dog)
    dog.close()
    wait_for("the building is given back", levels.exists)
    assert level(tmp_path) is None


_HOLDS = """
import json
from pathlib import Path
from thermoforce_mpc.connections.files import FilesConnection

class Holds(FilesConnection):
    "Levels that a device holds"
    def present(self, names):
        return json.loads(Path("held.json").read_text())

def holds(levels: Path = Path("levels.json")) -> Holds:
    "Files, and a device that says what it holds"
    return Holds(levels=levels)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("held", "left"), [(24.0, True), (21.2, False), (20.0, False)])
def test_what_a_device_holds_that_nobody_here_set_is_a_persons(tmp_path, monkeypatch, held, left):
    """21.0 was set, and 20.0 was tried and may have arrived."""
    levels, code = tmp_path / "levels.json", tmp_path / "holds.py"
    code.write_text(_HOLDS)
    (tmp_path / "held.json").write_text(json.dumps({"pump": held}))
    levels.write_text('{"levels": {"pump": 21.0}}')
    monkeypatch.chdir(tmp_path)
    about = tmp_path / "holds-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: holds\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[thermoforce_mpc.connections]\nholds = holds:holds\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    dog = Watchdog("holds", {"levels": str(levels)}, levels, 0.0, tmp_path / "dog")
    with pytest.raises(PlantError), sole_control(levels):
        raise_in_an_attempt(dog)
    dog.close()
    wait_for("the end of the watchdog", lambda: "gave back" in (tmp_path / "dog").read_text())
    assert (level(tmp_path) == 21.0) is left


@pytest.mark.slow
def test_what_is_released_is_not_given_back_again_and_a_watchdog_that_died_is_started_anew(tmp_path, caplog):
    levels = tmp_path / "levels.json"
    levels.write_text('{"levels": {"pump": 0.3}}')
    dog = Watchdog("files", {"levels": str(levels)}, levels, 0.0, tmp_path / "dog")
    dog.set(["pump"], 0.2)
    dog.released()
    wait_for("it waits", lambda: memory_MB(dog.pid) > 15.0)
    assert memory_MB(dog.pid) < 60.0, "it does for months: no pandas, no connection"
    dog.close()
    assert level(tmp_path) == 0.3
    dog = Watchdog("files", {"levels": str(levels)}, levels, 0.0, tmp_path / "dog")
    os.kill(dog.pid, signal.SIGKILL)
    time.sleep(0.2)
    with sole_control(levels):
        dog.set(["pump"], 0.2)
        dog.set(["pump"], 0.2)
    assert "started again" in caplog.text
    with sole_control(levels):
        wait_for("the building is given back", lambda: level(tmp_path) is None)
    dog.close()
