"""MQTT against a real broker: what comes is recorded, what is set arrives in time or never."""

from __future__ import annotations

import errno
import json
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from waiting import wait_for

from benchmarks.chaos.mosquitto import Broker, Listener, missing, subscribed, wire
from thermoforce_mpc.cli import cli
from thermoforce_mpc.connections.discovery import device_message
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import ConfigError, NoConnection, NotAsTold, PlantError
from thermoforce_mpc.measurements.load import read_measurements

pytest.importorskip("paho.mqtt.client")
needs_broker = pytest.mark.skipif(bool(missing()), reason=missing())
HALL = {"hall": {"topic": "hall/set", "release": 20.0}}


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    one = Broker(tmp_path_factory.mktemp("broker"))
    one.start()
    yield one
    one.stop()


@pytest.fixture
def connect(broker, tmp_path):
    made = []

    def connected(**options):
        home = build_connection(
            "mqtt", broker.options(record=str(tmp_path / "mqtt.csv"), prefix=f"t{len(made)}") | options
        )
        made.append(home)
        return home

    yield connected
    for home in made:
        home.close()


@pytest.fixture
def listener(broker):
    one = Listener(broker)
    yield one
    one.close()


@needs_broker
@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_commands_arrive_and_are_given_back(version, connect, listener):
    home = connect(actuators=HALL, version=version)
    home.write({"hall": 21.5}, 1020.0)
    home.write({"hall": None}, 0.0)
    assert listener.wait("hall/set", 2)[-2:] == ["21.5", "20"]


@needs_broker
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho 2.2.0 leaves the socket open
def test_over_tls_the_certificate_is_checked(connect, broker, listener):
    secure = {"port": broker.tls_port, "tls": True}
    home = connect(actuators=HALL, ca_file=str(broker.folder / "ca.crt"), **secure)
    home.write({"hall": 23.0}, 900.0)
    assert listener.wait("hall/set")[-1] == "23"
    with pytest.raises(PlantError, match=r"CERTIFICATE_VERIFY_FAILED|certificate"):
        connect(actuators=HALL, **secure).write({"hall": 21.0}, 900.0)


@needs_broker
def test_a_wrong_password_is_said_without_it(connect, tmp_path):
    file = tmp_path / "wrong"
    file.write_text("wrong-word")
    file.chmod(0o600)
    home = connect(actuators=HALL, password_file=str(file))
    with pytest.raises(PlantError, match=r"Not authorized|not authorised") as problem:
        home.write({"hall": 21.0}, 900.0)
    assert "wrong-word" not in repr(problem.value)


@needs_broker
@pytest.mark.slow
@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_what_could_not_be_published_never_arrives(version, tmp_path, monkeypatch):
    """paho keeps a failed publish of quality 1 and sends it when the broker is back, last of all."""
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TIMEOUT_S", 1.0)
    (tmp_path / "broker").mkdir()
    broker = Broker(tmp_path / "broker")
    broker.start()
    try:
        with wire(broker.port) as (port, cut, _):
            home = build_connection(
                "mqtt", broker.options(port=port, actuators=HALL, version=version, record=str(tmp_path / "mqtt.csv"))
            )
            home.write({"hall": 21.0}, 900.0)
            broker.stop()
            with pytest.raises(PlantError, match=r"nothing was set|withdrawn"):
                home.write({"hall": 22.0}, 900.0)
            broker.start()
            cut.set()
            began = time.monotonic()
            with pytest.raises(PlantError, match=r"nothing was set|withdrawn"):
                home.write({"hall": 23.0}, 900.0)
            assert time.monotonic() - began < 8.0
            listener = Listener(broker, "hall/#")
            cut.clear()
            home.write({"hall": 24.0}, 900.0)
            assert listener.wait("hall/set") == ["24"]
            time.sleep(1.0)
            assert listener.texts("hall/set") == ["24"]
            home.close()
            listener.close()
    finally:
        broker.stop()


@needs_broker
def test_a_retained_command_of_mqtt_5_ends_with_its_time_and_what_is_given_back_stays(connect, broker):
    home = connect(actuators={"hall": HALL["hall"] | {"retain": True, "topic": "kept/set"}})
    home.write({"hall": 24.0}, 1.0)
    time.sleep(2.2)  # the broker counts in whole seconds
    late = Listener(broker, "kept/#")
    assert late.wait("kept/set", seconds=0.5) == []
    late.close()
    home.write({"hall": 24.0}, 900.0)
    home.write({"hall": None}, 0.0)
    late = Listener(broker, "kept/#")
    assert late.wait("kept/set") == ["20"]
    late.close()


@needs_broker
@pytest.mark.parametrize(("form", "held"), [("{:.1f}", "24.0"), ("{:.1f} °C", "24,0 °C")])
def test_what_the_device_says_is_waited_for(connect, broker, monkeypatch, form, held):
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TAKEN_S", 0.4)

    def answers(client, userdata, message):
        taken = min(float(json.loads(message.payload)["t"]), 24.0)
        said = taken if form == "{:.1f}" else form.format(taken).replace(".", ",")
        client.publish("room/state", json.dumps({"set": said}), qos=1)

    device = broker.client(on_message=answers)
    subscribed(device, "room/set")
    room = {
        "topic": "room/set",
        "release": 20,
        "payload": '{"t": $value, "until": "$until"}',
        "state": "room/state#set",
    }
    home = connect(actuators={"hall": room})
    home.begin()
    home.write({"hall": 22.0}, 900.0)
    with pytest.raises(NotAsTold, match=f"room/state#set says {held}, not 25") as refused:
        home.write({"hall": 25.0}, 900.0)
    assert refused.value.names == ("hall",)
    device.disconnect()
    device.loop_stop()


@needs_broker
@pytest.mark.parametrize("lost", ["its answer", "the broker"])
def test_what_a_device_said_before_does_not_say_that_it_was_put_back(connect, broker, monkeypatch, lost):
    """It took 21 and its answer was lost: the 20 that it had said before passed for the answer to the next 20."""
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TAKEN_S", 0.3)
    device = broker.client()
    with wire(broker.port) as (port, _, snap):
        home = connect(actuators={"hall": {"topic": "deaf/set", "release": 20, "state": "deaf/state"}}, port=port)
        home.begin()
        wait_for("the broker", lambda: home.connected)
        wait_for(
            "its state", lambda: device.publish("deaf/state", "20", 1) and home.present(["hall"]) == {"hall": 20.0}
        )
        if lost == "the broker":
            snap()
            wait_for("that it is gone", lambda: not home.connected)
            wait_for("that it is back", lambda: home.connected)
        else:
            with pytest.raises(PlantError, match="deaf/state says 20, not 21") as silent:
                home.write({"hall": 21.0}, 900.0)
            assert not isinstance(silent.value, NotAsTold)
        with pytest.raises(PlantError, match="deaf/state says None, not 20"):
            home.put_back({"hall": 20.0})
        device.publish("deaf/state", "20", 1)
        wait_for("its word", lambda: home.present(["hall"]) == {"hall": 20.0})
        home.put_back({"hall": 20.0})
    device.disconnect()
    device.loop_stop()


@needs_broker
def test_what_comes_is_recorded_but_for_what_was_retained(connect, broker, tmp_path):
    other = broker.client()
    other.publish("z/old", "99", qos=1, retain=True).wait_for_publish(5)
    home = connect(record=str(tmp_path / "r.csv"))
    home.reads(["z/old", "z/hall#temperature", "z/out", "z/power", "z/on"])
    home.begin()
    wait_for("the broker", lambda: home.connected)
    time.sleep(0.2)
    for topic, text in (
        ("z/out", "3.5"), ("z/hall", '{"temperature": 20.25, "x": {}}'), ("z/hall", "no json"), ("z/on", "ON"),
        ("z/power", "1,5\n2"), ("z/power", "450"), ("z/other", "1"),
    ):  # fmt: skip
        other.publish(topic, text, qos=1).wait_for_publish(5)
    file = tmp_path / "r.csv"
    wait_for("the record", lambda: file.exists() and "450" in file.read_text())
    assert home.measurements() == file
    table = pd.read_csv(file)
    assert table[["topic", "value"]].astype(str).to_numpy().tolist() == [
        ["z/out", "3.5"], ["z/hall#temperature", "20.25"], ["z/on", "ON"], ["z/power", "450"]
    ]  # fmt: skip
    other.publish("z/old", "", qos=1, retain=True).wait_for_publish(5)
    other.disconnect()
    other.loop_stop()


@needs_broker
def test_a_record_that_is_written_to_for_months_keeps_its_days_and_what_comes_meanwhile(
    connect, broker, monkeypatch, tmp_path
):
    """It was cut to its days when a controller began, and grew until the next beginning."""
    other, now = broker.client(), [pd.Timestamp("2026-01-01 12:00", tz="UTC").to_pydatetime()]
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", lambda: now[0])
    home = connect(days=10)
    home.reads(["z/out"])
    home.begin()
    wait_for("the broker", lambda: home.connected)
    time.sleep(0.2)
    for day in range(20):
        other.publish("z/out", f"{day}", qos=1).wait_for_publish(5)
        wait_for("a record", (tmp_path / "mqtt.csv").exists)
        wait_for("the record", lambda day=day: home.measurements().read_text().endswith(f",z/out,{day}\n"))
        now[0] += pd.Timedelta("1D")
    table = pd.read_csv(home.measurements())
    first = int(table["value"].iloc[0])
    assert 5 <= first <= 10, "ten days, and a fourth of these at the most beyond"
    assert table["value"].tolist() == list(range(first, 20))
    other.disconnect()
    other.loop_stop()


@needs_broker
def test_a_disk_that_is_full_is_said_once_and_stops_no_control(connect, broker, monkeypatch, tmp_path, caplog):
    """The line that it had no room for is ended, so that no reading is lost behind it."""
    other, now = broker.client(), [pd.Timestamp("2026-01-01 12:00", tz="UTC").to_pydatetime()]
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", lambda: now[0])
    file, heard, full = tmp_path / "mqtt.csv", [], [True]
    home = connect(days=1, every_s=0)
    home.reads(["z/out"])
    home.listen({"seen": heard.append})
    home.begin()
    wait_for("the broker", lambda: home.connected)
    time.sleep(0.2)

    def say(*values):
        for value in values:
            other.publish("z/out", value, qos=1).wait_for_publish(5)
            other.publish("t0/set/seen", value, qos=1).wait_for_publish(5)
            wait_for("the message", lambda value=value: heard[-1:] == [value])

    opened = Path.open

    def no_room(path, mode="r", *args, **more):
        if full[0] and path.parent == tmp_path and mode != "rb":
            if path == file:
                with opened(path, "a") as torn:
                    torn.write("2026-01-01T12:0")
            raise OSError(errno.ENOSPC, "No space left on device")
        return opened(path, mode, *args, **more)

    say("1")
    now[0] += pd.Timedelta("2D")
    say("2")
    now[0] += pd.Timedelta("1D")
    monkeypatch.setattr(Path, "open", no_room)
    assert home.measurements() == file  # though what is old cannot be left out
    say("3", "4")
    full[0] = False
    say("5")
    lines = file.read_text().splitlines()
    assert [line.rpartition(",")[2] for line in lines[1:]] == ["1", "2", "2026-01-01T12:0" * 2, "5"]
    assert [message for message in caplog.messages if "record" in message] == [
        f"{file}: what comes is not recorded (No space left on device)", f"{file}: what comes is recorded again"
    ]  # fmt: skip
    assert any("No space left" in message and "recorded" not in message for message in caplog.messages)
    other.disconnect()
    other.loop_stop()


@needs_broker
def test_a_meter_that_speaks_each_second_is_recorded_every_ten_and_its_last_word_always(connect, broker, monkeypatch):
    """A year of it was 2 GB, read anew in each step; a switch that goes on and off again between is off."""
    other, now = broker.client(), [pd.Timestamp("2026-01-01 12:00", tz="UTC").to_pydatetime()]
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", lambda: now[0])
    home = connect()
    home.reads(["z/power", "z/on"])
    home.begin()
    wait_for("the broker", lambda: home.connected)
    time.sleep(0.2)
    seen = []
    home.listen({"seen": seen.append})
    time.sleep(0.2)
    for second in range(31):
        other.publish("z/power", f"{100 + second}", qos=1).wait_for_publish(5)
        if second in (2, 4):
            other.publish("z/on", "ON" if second == 2 else "OFF", qos=1).wait_for_publish(5)
        other.publish("t0/set/seen", str(second), qos=1).wait_for_publish(5)
        wait_for("the messages", lambda second=second: seen[-1:] == [str(second)])
        now[0] += pd.Timedelta("1s")
    table = pd.read_csv(home.measurements())
    power = table[table["topic"] == "z/power"]
    assert power["value"].tolist() == ["100", "110", "120", "130"]
    assert pd.to_datetime(power["time"]).dt.second.tolist() == [0, 10, 20, 30]
    switch = table[table["topic"] == "z/on"]
    assert switch["value"].tolist() == ["ON", "OFF"]
    assert pd.to_datetime(switch["time"]).dt.second.tolist() == [2, 4]
    with pytest.raises(ConfigError, match="every_s"):
        connect(every_s=-1)
    other.disconnect()
    other.loop_stop()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"days": -3}, r"days: -3: for how long mqtt\.csv is kept; expected 1 or more"),
        ({"days": 0}, "days: 0: for how long"),
        ({"days": 1e12}, r"days: no building has 1e\+12; expected at most 3660 days"),
        ({"port": 700000}, "port: 700000: expected 1 to 65535, or 0"),
        ({"port": -1}, "port: -1: expected"),
    ],
)
def test_numbers_that_no_record_or_broker_has_are_refused(tmp_path, monkeypatch, options, said):
    """With fewer than no days all that was recorded was left out of the record."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        build_connection("mqtt", options)


def test_a_record_reads_as_measurements(tmp_path):
    now = pd.Timestamp.now("UTC").floor("1h")
    file = tmp_path / "mqtt.csv"
    rows = [
        f"{(now - pd.Timedelta(minutes=k)).isoformat()},{topic},{value}"
        for k in range(600, -1, -1)
        for topic, value in (("hall#t", 20.0 + 0.001 * k), ("out", 3.0 + 0.002 * k), ("level", "0.4"))
    ]
    file.write_text("\n".join(["time,topic,value", *rows, "2026-11-2"]))
    rules = {
        "table": {"point": "topic", "value": "value"}, "outdoor": "out", "step": "1h", "time": {"zone": "UTC"},
        "zones": {"hall": {"temperature": "hall#t"}}, "actuators": {"a": {"level": "level"}},
    }  # fmt: skip
    measured = read_measurements(file, rules, at=now, now=now)
    assert measured.record.n_steps == 10
    assert measured.record.u[0].tolist() == pytest.approx([0.4] * 10)
    torn = measured.record
    for whole in ("\n".join(["time,topic,value", *rows, ""]), "\r\n".join(["time,topic,value", *rows, ""])):
        file.write_text(whole, newline="")
        clean = read_measurements(file, rules, at=now, now=now)  # a log in which all is whole is read at once
        assert not clean.left_out
        for signal in ("time_s", "T_zone_C", "T_out_C", "u"):
            np.testing.assert_array_equal(getattr(clean.record, signal), getattr(torn, signal))


@pytest.mark.parametrize("wrong", [0, 20])
def test_a_clock_that_is_wrong_for_a_while_does_not_cut_the_record(tmp_path, monkeypatch, wrong):
    """A year ahead, with some rows stamped so; of what is older than its days most is cut all the same."""
    file, days = tmp_path / "mqtt.csv", pd.date_range("2026-01-01", "2026-01-31 23:00", freq="1h", tz="UTC")
    late = [f"{(days[-1] + pd.Timedelta('366D')).isoformat()},t,0" for _ in range(wrong)]
    file.write_text(
        "\n".join(["time,topic,value", *(f"{at.isoformat()},t,{k}" for k, at in enumerate(days)), *late, ""])
    )
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.utc_now", lambda: days[-1] + pd.Timedelta("366D"))
    monkeypatch.setattr("paho.mqtt.client.Client.connect", lambda *_, **__: None)
    monkeypatch.setattr("paho.mqtt.client.Client.loop_start", lambda _: None)
    home = build_connection("mqtt", {"record": str(file), "days": 15})
    home.begin()
    home.drop()
    kept = pd.read_csv(file)["time"]
    assert "2026-01-05" < kept[0][:10] <= "2026-01-17"
    assert len(kept) == len(days[days.date >= pd.Timestamp(kept[0]).date()]) + wrong


@needs_broker
@pytest.mark.parametrize("begins", ["early", "late"])  # commands are learned from a first reading
def test_home_assistant_finds_one_device_and_what_people_ask_is_heard(connect, broker, begins):
    asked, mpc = [], f"house/{begins}"
    home = connect(prefix=mpc)
    asks = ("lower", "upper", "boost", "away", "mode")
    if begins == "early":
        home.begin()
        wait_for("the broker", lambda: home.connected)
    home.listen({key: lambda text, key=key: asked.append((key, text)) for key in asks})
    home.tell({"status": "solved", "why": "cheap hours first", "plan": {"next": "21 °C from 14:00", "steps": []}})
    home.begin()
    wait_for("the broker", lambda: home.connected)
    late = Listener(broker, "#")
    config = f"homeassistant/device/house_{begins}/config"
    wait_for("the device", lambda: any("climate" in text for text in late.texts(config)))
    found = json.loads(late.texts(config)[-1])
    assert found == device_message(mpc, f"house_{begins}", found["o"]["sw"], asks)
    assert {part["p"] for part in found["cmps"].values()} == {"sensor", "climate", "number", "switch", "select"}
    assert late.wait(f"{mpc}/availability") == ["online"]
    assert late.wait(f"{mpc}/why") == ["cheap hours first"]
    other = broker.client()
    other.publish(f"{mpc}/set/lower", "20.5", qos=1).wait_for_publish(5)
    other.publish(f"{mpc}/set/away", "ON", qos=1).wait_for_publish(5)
    wait_for("what was asked", lambda: len(asked) == 2)
    assert asked == [("lower", "20.5"), ("away", "ON")]
    home.close()
    assert late.wait(f"{mpc}/availability", 2)[-1] == "offline"
    other.disconnect()
    other.loop_stop()
    late.close()


@needs_broker
def test_one_that_only_writes_is_quiet(connect, broker, tmp_path):
    """As the watchdog, which is no controller: it says nothing of one, and writes to no record."""
    device = broker.client()
    device.on_message = lambda client, userdata, message: client.publish("quiet/state", message.payload, 1, True)
    subscribed(device, "quiet/set")
    heard = Listener(broker, "#")
    home = connect(actuators={"hall": {"topic": "quiet/set", "release": 20.0, "state": "quiet/state"}}, prefix="loud")
    home.write({"hall": 21.5}, 900.0)
    assert home.present(["hall"]) == {"hall": 21.5}
    device.publish("quiet/state", "24", qos=1, retain=True).wait_for_publish(5)
    heard.wait("quiet/state", 2)
    other = connect(actuators={"hall": {"topic": "quiet/set", "release": 20.0, "state": "quiet/state"}}, prefix="loud")
    assert other.present(["hall"]) == {"hall": 24.0}
    assert not any(topic.startswith(("loud", "homeassistant/device/loud")) for topic, _, _ in heard.heard)
    assert not (tmp_path / "mqtt.csv").exists()
    device.disconnect()
    device.loop_stop()
    heard.close()


@needs_broker
def test_what_a_device_held_is_put_back_without_end(connect, broker):
    """A number as it was; of a device whose own word gives it back (own, auto) that; an option by its word."""
    states = {1.0: "blocked", 2.0: "normal", 3.0: "recommended"}
    home = connect(
        actuators={
            "hall": {"topic": "back/hall", "release": 20.0, "scale": 10.0},
            "bath": {"topic": "back/bath", "release": "own"},
            "pump": {"topic": "back/pump", "release": "normal", "options": states},
        }
    )
    heard = []
    device = broker.client(on_message=lambda client, userdata, message: heard.append(message))
    subscribed(device, "back/#")
    home.write({"hall": 21.0}, 900.0)
    home.put_back({"hall": 22.5, "bath": 22.5, "pump": 3.0})
    wait_for("all of it", lambda: len(heard) == 4)
    expiry = [getattr(one.properties, "MessageExpiryInterval", None) for one in heard]
    assert expiry[0] is not None
    assert expiry[1:] == [None] * 3
    said = {one.topic: one.payload.decode() for one in heard}
    assert said == {"back/hall": "225", "back/bath": "own", "back/pump": "recommended"}
    device.disconnect()
    device.loop_stop()


@needs_broker
def test_a_connection_that_dies_says_so_by_its_last_will(connect, broker):
    with wire(broker.port) as (port, _, snap):
        home = connect(prefix="dying", port=port)
        home.begin()
        wait_for("the broker", lambda: home.connected)
        late = Listener(broker, "dying/#")
        assert late.wait("dying/availability") == ["online"]
        snap()  # as of a killed process: nothing is said
        wait_for("the last will", lambda: "offline" in late.texts("dying/availability"))
        wait_for("that it is back", lambda: late.texts("dying/availability")[-1] == "online")
        late.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"version": "4"}, "'5' or '3.1.1'"),
        ({"host": "house:word@broker"}, "leave out what is before @; give user"),
        ({"host": "mqtts://house:word@broker:8883"}, "leave out what is before @; give user"),
        ({"host": "mqtt://broker"}, "a name or address alone"),
        ({"actuators": {"a": {"topic": "a/#", "release": 1}}}, "no topic to publish to"),
        ({"actuators": {"a": {"topic": "a", "release": 1, "payload": "$valu"}}}, "payload"),
        ({"actuators": {"a": {"topic": "a"}}}, "release"),
        ({"prefix": "$SYS"}, "prefix"),
        ({"password": "x"}, "password"),
        ({"user": "u"}, "MQTT_PASSWORD"),
        ({"ca_file": "/nowhere.crt"}, "ca_file"),
    ],
)
def test_wrong_options_are_refused_with_their_key(options, said, monkeypatch):
    monkeypatch.delenv("MQTT_PASSWORD", raising=False)
    with pytest.raises(ConfigError, match=said):
        build_connection("mqtt", options)


@pytest.mark.parametrize("days", [1.0, 3000.0])
def test_a_table_of_somebody_else_is_no_record_and_stays_as_it_is(tmp_path, days):
    """The export of a logger lost its header and its old rows."""
    house = tmp_path / "house.csv"
    house.write_text("time,T living\n2025-01-12 00:00,21.0\n")
    home = build_connection("mqtt", {"port": 9, "actuators": HALL, "record": str(house), "days": days})
    with pytest.raises(ConfigError, match=r"record: .*house\.csv: is no record of this connection"):
        home.begin()
    home.close()
    assert house.read_text() == "time,T living\n2025-01-12 00:00,21.0\n"


def test_a_broker_that_is_not_there_is_said(tmp_path):
    home = build_connection("mqtt", {"port": 9, "actuators": HALL, "record": str(tmp_path / "m.csv")})
    with pytest.raises(PlantError, match=r"127.0.0.1|localhost"):
        home.write({"hall": 21.0}, 900.0)
    home.close()


def unused_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.parametrize("kind", ["mqtt", "home-assistant"])
@pytest.mark.parametrize(("host", "said"), [("127.0.0.1", "refuses the connection"), ("a.invalid", "no such host")])
def test_commissioning_says_at_once_that_nobody_is_there(tmp_path, monkeypatch, kind, host, said):
    """It waited a minute for points, as where a broker is there and a device sleeps."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "thermoforce_mpc.cli.live.commission.time", SimpleNamespace(monotonic=time.monotonic)
    )  # no sleep
    assert CliRunner().invoke(cli, ["init", ".", "--for", kind]).exit_code == 0
    port = unused_port()
    where = {"mqtt": [f"host={host}", f"port={port}"], "home-assistant": [f"url=http://{host}:{port}"]}[kind]
    words = [word for one in where for word in ("--set", f"connection.{one}")]
    secrets = {"MQTT_PASSWORD": "x", "HOME_ASSISTANT_TOKEN": "x"}
    done = CliRunner().invoke(cli, ["commission", "connection.yaml", "--dry-run", *words], env=secrets)
    assert isinstance(done.exception, NoConnection), done.output
    assert f"{host}:{port}" in str(done.exception)
    assert said in str(done.exception)
    assert "mend host and port" in str(done.exception) or "mend url" in str(done.exception)
    assert "Waits" not in done.output


def test_a_broker_that_does_not_answer_is_waited_for_as_long_as_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("thermoforce_mpc.connections.mqtt.TIMEOUT_S", 0.2)
    assert CliRunner().invoke(cli, ["init", ".", "--for", "mqtt"]).exit_code == 0
    with socket.create_server(("127.0.0.1", 0)) as deaf:  # takes the connection, and says nothing
        words = ["--set", "connection.host=127.0.0.1", "--set", f"connection.port={deaf.getsockname()[1]}"]
        done = CliRunner().invoke(
            cli, ["commission", "connection.yaml", "--dry-run", "--wait", "1.5", *words], env={"MQTT_PASSWORD": "x"}
        )
        assert isinstance(done.exception, PlantError), done.output
    assert "Waits up to 2 s for points: the connection gives no measurements" in done.output
    assert "has not answered yet" in str(done.exception)


@pytest.mark.slow
def test_recording_says_that_the_broker_is_away_and_that_nothing_came(tmp_path, monkeypatch):
    """Weeks of recording nothing must not look like recording."""
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["init", ".", "--for", "mqtt"]).exit_code == 0
    words = ["record", "--map", "map.yaml", "--connection", "connection.yaml", "--hours", "0.0001"]
    with socket.socket() as one:  # a port that nobody listens at
        one.bind(("127.0.0.1", 0))
        away = ["--set", "connection.host=127.0.0.1", "--set", f"connection.port={one.getsockname()[1]}"]
        done = CliRunner().invoke(cli, [*words, *away], env={"MQTT_PASSWORD": "x"})
    assert "refuses the connection: nothing listens there" in done.stderr
    assert isinstance(done.exception, PlantError)
    assert "nothing comes: broker 127.0.0.1" in str(done.exception)
