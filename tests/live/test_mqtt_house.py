"""A house behind a real broker, at speed: as good as without one between, and what happens when things fail."""

from __future__ import annotations

import json
import time

import numpy as np
import pandas as pd
import pytest
from connected_home import (
    HOUR,
    SENSORS,
    START,
    TimedHome,
    at_hours,
    check_commands,
    controlled,
    in_process,
    rules_of,
    same_as,
)
from home_by_setpoint import own_setpoint_C
from waiting import wait_for

from benchmarks.chaos.mosquitto import Broker, Listener, missing, subscribed, wire
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import PlantError

pytest.importorskip("paho.mqtt.client")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(missing()), reason=missing())]
TOPICS = {name: f"house/{name}" for name in SENSORS}
THERMOSTAT = {
    "topic": "house/thermostat/set", "release": "own", "payload": '{"t": "$value", "until": "$until"}',
    "state": "house/thermostat/state",
}  # fmt: skip


class MqttHome:
    """The house as a device on the broker, and a connection to it with the house's clock."""

    def __init__(self, broker, folder, monkeypatch, port=None) -> None:
        self.home, self.folder, self.broker, self._stamp = TimedHome(), folder, broker, None
        monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", self.now)
        monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TIMEOUT_S", 0.7)
        monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TAKEN_S", 3.0)
        lines = ["time,topic,value"]
        for row in self.home.rows:
            lines += [f"{row['time'].isoformat()},{TOPICS[name]},{row[name]:.6f}" for name in SENSORS]
        (folder / "mqtt.csv").write_text("\n".join(lines) + "\n")
        self.device = broker.client(on_message=self._told, on_connect=self._here)
        subscribed(self.device, "house/thermostat/set")
        self.unavailable = self.torn = False
        self.connect(port)
        self.events = lambda row: None
        self.home.on_row = self.row

    def connect(self, port=None) -> None:
        self.connection = build_connection(
            "mqtt",
            self.broker.options(
                actuators={"actuator": THERMOSTAT}, record=str(self.folder / "mqtt.csv"), prefix="mpc",
                **({} if port is None else {"port": port}),
            ),
        )  # fmt: skip
        self.connection.forecast = self.home.forecast
        self._recorded, self.connection.measurements = self.connection.measurements, self._measurements
        rules = rules_of(TOPICS, table={"point": "topic", "value": "value"})
        self.rules = rules
        self.connection.reads(list(TOPICS.values()))
        self.connection.begin()
        wait_for("the broker", lambda: self.connection.connected)

    def run(self, steps):
        decisions = controlled(self.home, self.connection, self.rules, steps)
        self.connection.close()
        return decisions

    def _here(self, client, userdata, flags, reason, properties=None) -> None:
        client.subscribe("house/thermostat/set", 1)

    def _told(self, client, userdata, message) -> None:
        said = json.loads(message.payload)
        own = said["t"] == "own"
        until = pd.Timestamp(said["until"])
        if not own and until <= self.home.at:
            return  # too late: it counts no more
        self.home.set_by(None if own else float(said["t"]), None if own else until)
        client.publish("house/thermostat/state", said["t"], qos=1)

    def now(self):
        """The house's time: that of a reading while it is published."""
        return (self.home.at if self._stamp is None else self._stamp).to_pydatetime()

    def _measurements(self):
        out = self.home.rows[-1]["out"]
        self._publish({"time": self.home.at, "T": self.home.T, "out": out})
        return self._recorded()

    def row(self, row) -> None:
        self.events(row)
        self._publish(row)

    def _publish(self, row) -> None:
        """Readings of a time, until they stand in the record."""
        if not self.connection.connected or not self.device.is_connected():
            return
        file, self._stamp = self.folder / "mqtt.csv", row["time"]
        size, lines = file.stat().st_size, 0
        for name in SENSORS:
            if name in row and not (self.unavailable and name in ("T", "set")):
                text = f"{row[name]:.6f}"
                self.device.publish(TOPICS[name], text, qos=1)
                lines += len(f"{self.now().isoformat(timespec='milliseconds')},{TOPICS[name]},{text}\n")
        until = time.monotonic() + 2.0
        while file.stat().st_size < size + lines and self.connection.connected and time.monotonic() < until:
            time.sleep(0.001)
        self._stamp = None


@pytest.fixture
def broker(tmp_path):
    folder = tmp_path / "broker"
    folder.mkdir()
    one = Broker(folder)
    one.start()
    yield one
    one.stop()


def test_it_is_as_good_as_without_a_broker_between(broker, tmp_path, monkeypatch):
    usual, plain = in_process(24)
    house = MqttHome(broker, tmp_path, monkeypatch)
    decisions = house.run(24)
    assert [one.plan.status for one in decisions] == [one.plan.status for one in plain]
    dearer, discomfort = same_as(house.home, usual)
    assert abs(dearer) < 0.02
    assert abs(discomfort) < 0.2
    check_commands(house.home)
    house.device.disconnect()
    house.device.loop_stop()


def test_broker_restarted_wire_cut_readings_gone_and_the_record_torn(broker, tmp_path, monkeypatch):
    """Nothing is lost for good: the house's own control in between, then control again, without a person."""
    with wire(broker.port) as (port, cut, snap):
        house = MqttHome(broker, tmp_path, monkeypatch, port)
        connection, record = house.connection, tmp_path / "mqtt.csv"

        def restart():
            broker.stop()
            broker.start()
            for one in (house.device, connection):
                wait_for("the broker", getattr(one, "is_connected", lambda one=one: one.connected))

        def back():
            cut.clear()
            snap()
            wait_for("the wire", lambda: connection.connected)

        def tear():
            with record.open("ab") as file:
                file.write(b"2026-01-29T07:0\x00\x00\x00")

        house.events = at_hours(
            {
                2.1: restart,
                4.1: cut.set,
                5.1: back,
                7.1: lambda: setattr(house, "unavailable", True),
                9.1: lambda: setattr(house, "unavailable", False),
                11.1: tear,
            }
        )
        decisions = house.run(16)
        home = house.home
        assert len(decisions) == 16
        last = [one.plan.status for one in decisions[-4:]]
        assert last == ["solved"] * 4
        # An hour without a wire: what was set ended by itself, and nothing arrived later.
        cut_rows = [row for row in home.rows if 4.2 * HOUR <= row["time"] - START < 5.0 * HOUR]
        after = [row for row in cut_rows if row["time"] - START >= 5.0 * HOUR - pd.Timedelta("20min")]
        assert after
        late = [at for at, value in home.written if value is not None and 4.2 * HOUR < at - START < 5.05 * HOUR]
        assert not late
        check_commands(home)
        assert min(row["T"] for row in home.rows if row["time"] >= START) > 18.0
        house.device.disconnect()
        house.device.loop_stop()


def test_killed_the_house_takes_over_and_the_next_start_goes_on(broker, tmp_path, monkeypatch):
    house = MqttHome(broker, tmp_path, monkeypatch)
    heard = Listener(broker, "mpc/availability")

    class Killed(BaseException):
        """Nothing after it runs, as after SIGKILL."""

    def kill():
        raise Killed

    house.events = at_hours({5.5: kill})
    written = house.connection.write
    # What a killed process would still say is not said.
    monkeypatch.setattr(house.connection, "write", lambda levels, s: written(levels, s) if s > 0 else dead())
    with pytest.raises((Killed, PlantError)):
        house.run(24)
    house.connection.close()
    told_when = house.home.at
    house.home.on_row = house.row
    house.home.wait_until(told_when.ceil("1h") + 2 * HOUR)
    rows = [row for row in house.home.rows if row["time"] > told_when + HOUR]
    assert rows
    assert all(row["set"] == own_setpoint_C(row["time"]) for row in rows)
    assert heard.wait("mpc/availability")[-1] in ("online", "offline")
    monkeypatch.undo()
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", house.now)
    house.connect()
    decisions = house.run(6)
    assert [one.plan.status for one in decisions] == ["solved"] * 6
    check_commands(house.home)
    assert np.isfinite([row["T"] for row in house.home.rows]).all()
    heard.close()
    house.device.disconnect()
    house.device.loop_stop()


def dead():
    raise PlantError("killed")
