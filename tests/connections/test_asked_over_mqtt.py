"""What is asked over MQTT, and what is set at the wall, outlives the controller, each for the rest of its time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest
import yaml
from connected_home import HOUR, SENSORS, START, TimedHome, rules_of
from simple_house import simple_model
from waiting import wait_for

from benchmarks.chaos.mosquitto import PASSWORD, Broker, Listener, missing, subscribed

FAKETIME = next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)
pytest.importorskip("paho.mqtt.client")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.skipif(FAKETIME is None, reason="libfaketime is not installed"),
]
TOPICS = {name: f"house/{name}" for name in SENSORS} | {"set": "house/thermostat"}
THERMOSTAT = {"topic": "house/thermostat/set", "release": "own", "state": TOPICS["set"]}
# Where the clock of Python's sleep is left as it is (that of its locks must be), libfaketime lets it sleep until a time
# of the other clock.
SLEEPS = "import select, time\ntime.sleep = lambda seconds: select.select([], [], [], seconds)\n"
OPTIONS = [
    "step_s=3600", "horizon_h=12", "free_response.name=persistence", "gate.enabled=false", "watch.enabled=false",
]  # fmt: skip


class House:
    """The house on the broker up to now, with a thermostat that says what it holds, and files of `tf-mpc control`."""

    def __init__(self, broker: Broker, folder) -> None:
        self.broker, self.folder, self.home, self.told = broker, folder, TimedHome(days=10), []
        self.begun = pd.Timestamp.now("UTC").ceil("1h") + pd.Timedelta("5min")  # early in a step
        self.shift = self.begun.floor("1h") - START
        (folder / "mqtt.csv").write_text("time,topic,value\n")
        self._written = 0
        self.live_until(self.begun)
        self.home.forecast().shift(freq=self.shift).to_csv(folder / "tomorrow.csv")
        simple_model().save(folder / "model")
        (folder / "map.yaml").write_text(yaml.safe_dump(rules_of(TOPICS, table={"point": "topic", "value": "value"})))
        options = {"host": "127.0.0.1", "port": broker.port, "user": "house", "prefix": "mpc"}
        options |= {"actuators": {"actuator": THERMOSTAT}}
        (folder / "connection.yaml").write_text(yaml.safe_dump({"name": "mqtt", "options": options}))
        (folder / "python").mkdir()
        (folder / "python" / "sitecustomize.py").write_text(SLEEPS)
        self.device = broker.client(on_message=self._on_message)
        subscribed(self.device, "house/thermostat/set")

    def live_until(self, at: pd.Timestamp) -> None:
        """Its readings until then, as something records them."""
        self.home.wait_until(at - self.shift)
        rows, self._written = self.home.rows[self._written :], len(self.home.rows)
        with (self.folder / "mqtt.csv").open("a") as file:
            for row in rows:
                stamp = (row["time"] + self.shift).isoformat()
                file.writelines(f"{stamp},{TOPICS[name]},{row[name]:.6f}\n" for name in SENSORS)

    def _on_message(self, client, userdata, message) -> None:
        self.told.append(message.payload.decode())
        self.hold(message.payload.decode())

    def hold(self, text: str) -> None:
        """The thermostat is set, by whomever."""
        self.device.publish(TOPICS["set"], text, qos=1, retain=True)

    @contextmanager
    def controlled(self, later: pd.Timedelta, end: signal.Signals):
        """`tf-mpc control` so long after the house's begin, once it has decided; how it is ended after."""
        words = [sys.executable, "-m", "thermoforce_mpc", "control", "--model", "model", "--map", "map.yaml"]
        words += ["--connection", "connection.yaml", "--delay", "0"]
        words += [word for option in OPTIONS for word in ("--set", f"controller.{option}")]
        path = os.pathsep.join([str(self.folder / "python"), os.environ.get("PYTHONPATH", "")])
        ahead_s = (self.begun + later - pd.Timestamp.now("UTC")).total_seconds()
        clock = {"LD_PRELOAD": str(FAKETIME), "FAKETIME": f"+{ahead_s:.0f}s"}
        alone = {"FAKETIME_DONT_FAKE_MONOTONIC": "1", "NO_FAKE_STAT": "1", "PYTHONPATH": path}
        heard = Listener(self.broker, "mpc/#")
        env = os.environ | clock | alone | {"MQTT_PASSWORD": PASSWORD}
        with subprocess.Popen(words, cwd=self.folder, env=env, stdout=subprocess.PIPE, text=True) as process:
            try:
                wait_for("a decision", lambda: said_now(heard, "status") or process.poll() is not None)
                assert process.poll() is None, process.stdout.read()
                yield heard
            finally:
                process.send_signal(end)
                process.wait(60)
        heard.close()


def said_now(heard: Listener, key: str) -> list[str]:
    """What is said on a topic while we listen, without what the broker kept."""
    return [text for topic, text, kept in heard.heard if topic == f"mpc/{key}" and not kept]


def people(heard: Listener) -> dict:
    """What the controller says last that people ask."""
    wait_for("what people ask", lambda: said_now(heard, "people"))
    return json.loads(said_now(heard, "people")[-1])


def test_each_is_kept_over_a_kill_for_the_rest_of_its_time(tmp_path):
    folder = tmp_path / "broker"
    folder.mkdir()
    broker = Broker(folder)
    broker.start()

    def wishes() -> dict:
        return json.loads((tmp_path / "control" / "people.json").read_text())

    try:
        house = House(broker, tmp_path)
        away = house.begun + 30 * HOUR
        with house.controlled(pd.Timedelta(0), signal.SIGKILL) as heard:
            wait_for("a set-point", lambda: house.told)
            for key, text in (("boost", "90"), ("away", away.isoformat())):
                house.device.publish(f"mpc/set/{key}", text, qos=1)
            wait_for("what is asked", lambda: people(heard).items() >= {"boost_min": 90, "away": True}.items())
            house.hold("24")  # at the wall
        count = len(house.told)
        with house.controlled(pd.Timedelta("30min"), signal.SIGKILL) as heard:
            said = people(heard)
            assert (said["mode"], said["away"]) == ("control", True)
            assert 50 <= said["boost_min"] <= 65, "and not 90 again"
            wait_for("what was set by hand", lambda: wishes()["by_hand"])
            house.device.publish("mpc/set/mode", "advise", qos=1)
            wait_for("mode advise", lambda: people(heard)["mode"] == "advise")
        value, until = wishes()["by_hand"]["actuator"]
        assert value == 24.0
        assert abs(pd.Timestamp(until) - house.begun - 4.5 * HOUR) < pd.Timedelta("5min")
        house.live_until(house.begun + 3 * HOUR)
        with house.controlled(3 * HOUR, signal.SIGTERM) as heard:
            said = people(heard)
            assert (said["mode"], said["boost_min"], said["away"]) == ("advise", 0, True)
            (notes,) = said_now(heard, "notes")
            assert f"24 °C was set by hand: left alone until {pd.Timestamp(until):%a %H:%M}" in notes
            assert "mode advise was asked: nothing is set" in notes
        assert len(house.told) == count, "nothing was set of what a person holds, nor by a controller that may not"
        house.device.disconnect()
        house.device.loop_stop()
    finally:
        broker.stop()
