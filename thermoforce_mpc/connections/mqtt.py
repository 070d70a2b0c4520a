"""Connection to an MQTT broker: topics are recorded as they come, commands are published so that none arrives late.

A publish of quality 1 that failed stays in the client's queue and is sent when the broker is back, an hour later and
after newer ones. So each command goes over a connection of its own, which is broken off, with what is in its buffers,
where the broker did not confirm in time; with MQTT 5 each also carries the time after which it counts no more.
"""

from __future__ import annotations

import csv
import io
import json
import logging
import math
import re
import socket
import ssl
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from string import Template
from typing import Any
from uuid import uuid4

import pandas as pd
from pydantic import Field

from thermoforce_mpc.connections.away import not_reached
from thermoforce_mpc.connections.discovery import device_message
from thermoforce_mpc.errors import ConfigError, NoConnection, NotAsTold, PlantError, StorageError
from thermoforce_mpc.files import no_secret_in, secret_from, storage_errors, written
from thermoforce_mpc.measurements.tables.raw_table import SWITCH
from thermoforce_mpc.providers.outlook import Outlook, OutlookConfig
from thermoforce_mpc.scenario.settings import StrictModel
from thermoforce_mpc.version import VERSION

_LOG = logging.getLogger(__name__)
TIMEOUT_S, _KEEPALIVE_S = 10.0, 30
# Between two attempts to connect, s; the end of a process waits for the present one.
_MOST_DELAY_S = 5
_WHERE = "host and port"
# How long a device may take to say what it was set to, s.
TAKEN_S = 10.0
_HEADER = "time,topic,value\n"
# What a device says of a set-point or valve.
_TOLD = re.compile(r"\s*([+-]?\d+)(?:[.,](\d+))?\s*(?:°?C|%)?\s*")
_MOST_PAYLOAD = 100_000
# A step of control should see some readings of what changes.
_LONGEST_EVERY_S = 300.0
_MOST_PORT = 65535
# Share of a record that a wrong clock may have stamped.
_FEW = 0.1
# How often a record that is written to for months is looked through for what is too old.
_KEEP_EVERY = timedelta(days=1)


class MqttActuator(StrictModel):
    """What is published for an actuator of the map."""

    topic: str
    release: float | str = Field(description="value that is published when the building is given back")
    payload: str = Field("$value", description="what is published; $value: the value, $until: until when it holds, UTC")
    scale: float = Field(1.0, gt=0, description="the level or command times this, and `offset` more, is published")
    offset: float = Field(0.0, description="of a set-point in °F: scale 1.8 and offset 32")
    options: dict[float, str] = Field(default_factory=dict, description="word in the place of each command")
    retain: bool = Field(False, description="whether the broker keeps it for who subscribes later")
    state: str | None = Field(None, description="topic, or topic#key, that says what the device took: it is waited for")


class MqttConnection:
    """An MQTT broker: topics as columns, commands as messages that never arrive late; a device of Home Assistant"""

    def __init__(
        self,
        host: str = "localhost",
        port: int = 0,
        actuators: dict[str, MqttActuator] | None = None,
        user: str | None = None,
        password_file: Path | None = None,
        tls: bool = False,
        ca_file: Path | None = None,
        version: str = "5",
        record: Path = Path("mqtt.csv"),
        days: float = 60.0,
        every_s: float = 10.0,
        prefix: str = "thermoforce-mpc",
        discovery: str | None = "homeassistant",
        forecast: str | OutlookConfig = "tomorrow.csv",
    ) -> None:
        """Check the options and connect; what comes is recorded from then on.

        Columns of the map are topics, or values in their JSON as `zigbee2mqtt/hall#temperature`; the map has
        `table: {point: topic, value: value}`.

        Args:
            host: of the broker.
            port: 0: 1883, with tls 8883.
            actuators: what to publish, by the name in the map: `{heat_pump: {topic: hall/set, release: 20}}`.
            user: name at the broker.
            password_file: file of mode 600; without it the environment variable MQTT_PASSWORD.
            tls: whether the traffic is encrypted, and the broker's certificate checked.
            ca_file: certificate of the authority that signed it; default: those of the system.
            version: of the protocol, 5 or 3.1.1.
            record: file that what comes is appended to.
            days: how long it is kept, at least.
            every_s: what comes oftener, as from a meter that says its power each second, is recorded as often as this.
            prefix: of the topics that say what is planned.
            discovery: prefix of Home Assistant's device discovery; null: none.
            forecast: a file of weather, or services, see docs/how-to/forecasts.md.
        """
        no_secret_in(host, "connection mqtt: host", "give user, and the password in MQTT_PASSWORD or password_file")
        if "/" in host or not host.strip():
            raise ConfigError(f"connection mqtt: host: {host!r}: a name or address alone; port and tls are keys")
        if version not in ("5", "3.1.1"):
            raise ConfigError(f"connection mqtt: version: {version!r}: expected '5' or '3.1.1'")
        if not 0.0 <= every_s <= _LONGEST_EVERY_S:
            raise ConfigError(f"connection mqtt: every_s: {every_s:g}: expected 0 to {_LONGEST_EVERY_S:g} s")
        if not days >= 1.0:  # of fewer the record would be cut to nothing
            raise ConfigError(f"connection mqtt: days: {days:g}: for how long {record} is kept; expected 1 or more")
        if not 0 <= port <= _MOST_PORT:
            raise ConfigError(f"connection mqtt: port: {port}: expected 1 to {_MOST_PORT}, or 0 for the usual one")
        if discovery is not None and not _plain_topic(discovery):
            raise ConfigError(f"connection mqtt: discovery: {discovery!r} is no topic")
        if not _plain_topic(prefix):
            raise ConfigError(f"connection mqtt: prefix: {prefix!r} is no topic")
        self._actuators = actuators or {}
        for name, one in self._actuators.items():
            if not _plain_topic(one.topic):
                raise ConfigError(f"connection mqtt: actuators.{name}.topic: {one.topic!r} is no topic to publish to")
            if one.state is not None and not _plain_topic(one.state.partition("#")[0]):
                raise ConfigError(f"connection mqtt: actuators.{name}.state: {one.state!r} is no topic")
            try:
                Template(one.payload).substitute(value="", until="")
            except (KeyError, ValueError) as error:
                raise ConfigError(f"connection mqtt: actuators.{name}.payload: unknown {error}") from error
        self._host, self._port = host, port or (8883 if tls else 1883)
        self._version, self._user = version, user
        self._password = None
        if user is not None:
            self._password = secret_from(password_file, ("MQTT_PASSWORD",), "connection mqtt: password_file")
        self._context = None
        if tls or ca_file is not None:
            try:
                self._context = ssl.create_default_context(cafile=None if ca_file is None else str(ca_file))
            except OSError as error:
                raise ConfigError(f"connection mqtt: ca_file: {ca_file}: {error}") from error
        self._record, self._days, self._prefix, self._discovery = record, days, prefix, discovery
        self._every, self._recorded = timedelta(seconds=every_s), dict[str, datetime]()
        self._later: dict[str, tuple[datetime, str]] = {}
        self._outlook = Outlook(forecast)
        self._columns: tuple[str, ...] = tuple(a.state for a in self._actuators.values() if a.state is not None)
        self._heard: dict[str, str] = {}
        self._anew_said = set[str]()  # what a device said since it was last told something
        self._writing, self._kept_at = threading.Lock(), utc_now()
        self._unrecorded = False
        self._change = threading.Condition()
        self._asks: dict[str, Callable[[str], None]] = {}
        self._said: dict[str, str] = {}
        self._client: Any = None
        self._problem = f"{self._where} has not answered yet"
        self._away: NoConnection | None = None  # until it was there once: a broker that starts anew comes back

    def reads(self, columns: Iterable[str]) -> None:
        """See `Connection`: the columns of the map."""
        for column in columns:
            if not _plain_topic(column.partition("#")[0]):
                raise ConfigError(f"map: column '{column}' is no topic, as connection mqtt reads")
        self._columns = tuple(dict.fromkeys([*self._columns, *columns]))
        if self._client is not None:
            self._subscribe(self._client)

    def sets(self) -> tuple[str, ...]:
        """See `Connection`."""
        return tuple(
            sorted({f"mqtt {self._host.lower()}:{self._port} {one.topic}" for one in self._actuators.values()})
        )

    def begin(self) -> None:
        """Connect, and record what comes from now on; asked for by the first reading too."""
        if self._client is not None:
            return
        self._keep_lately()
        # The same name after each loss: the broker then says the last will of the lost connection at once, and not half
        # a minute after we are back.
        client = self._made(f"thermoforce-mpc-{uuid4().hex[:16]}")
        client.will_set(f"{self._prefix}/availability", "offline", qos=1, retain=True)
        client.on_connect, client.on_message = self._on_connect, self._on_message
        client.on_disconnect = self._on_disconnect
        client.reconnect_delay_set(1, _MOST_DELAY_S)
        self._client = client
        try:
            client.connect(self._host, self._port, keepalive=_KEEPALIVE_S, **self._anew())
        except (OSError, ValueError) as error:
            self._not_taken_in(not_reached(self._where, _WHERE, error))
            client.connect_async(self._host, self._port, keepalive=_KEEPALIVE_S, **self._anew())
        client.loop_start()

    @property
    def _where(self) -> str:
        return f"broker {self._host}:{self._port}"

    def _not_taken_in(self, error: PlantError) -> None:
        """Note what keeps the broker away, or us."""
        self._problem, self._away = str(error), error if isinstance(error, NoConnection) else None

    @property
    def connected(self) -> bool:
        """Whether the broker is there."""
        return self._client is not None and bool(self._client.is_connected())

    @property
    def problem(self) -> str:
        """Why nothing comes: what keeps the broker away; '' where it is there."""
        return "" if self.connected else self._problem

    def measurements(self) -> Path:
        """See `Connection.measurements`; raises `PlantError` where the broker is away, at once by `NoConnection`."""
        self.begin()
        until = time.monotonic() + TIMEOUT_S
        while problem := self.problem:
            if self._away is not None:
                raise self._away
            if time.monotonic() > until:
                raise PlantError(problem)
            time.sleep(0.05)
        if utc_now() - self._kept_at > _KEEP_EVERY:
            try:
                self._keep_lately()
            except StorageError as error:  # a disk that is full: what was recorded can be read, and is kept longer
                self._kept_at = utc_now()
                _LOG.warning("%s", error)
        self._append({}, all_of_it=True)
        if not self._record.exists():
            raise PlantError(f"nothing was recorded in {self._record} yet of {', '.join(self._columns)}")
        return self._record

    def forecast(self) -> pd.DataFrame | str:
        """See `Connection.forecast`."""
        return self._outlook.now()

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`; raises `PlantError` where the broker or a device did not take one in time."""
        if unknown := [name for name in levels if name not in self._actuators]:
            raise ConfigError(f"connection mqtt: actuators: none is given for '{unknown[0]}'")
        until = utc_now() + timedelta(seconds=seconds)
        # What is given back stays given back: it has no end.
        self._set(
            {
                name: (_text(self._actuators[name], level), None if level is None else max(1, math.ceil(seconds)))
                for name, level in levels.items()
            },
            until,
        )

    def put_back(self, held: Mapping[str, float]) -> None:
        """See `Connection`: with no end; where `release` is a word of its own (own, auto), that one."""
        texts = {}
        for name, value in held.items():
            one = self._actuators[name]
            own_word = isinstance(one.release, str) and one.release not in one.options.values()
            texts[name] = (_text(one, None if own_word else value), None)
        self._set(texts, utc_now())

    def _set(self, texts: Mapping[str, tuple[str, int | None]], until: datetime) -> None:
        """Publish values with the time after which each counts no more, s, and wait until devices say them."""
        messages, awaited = [], {}
        for name, (value, expires) in texts.items():
            one = self._actuators[name]
            text = Template(one.payload).substitute(value=value, until=until.isoformat(timespec="seconds"))
            messages.append((one.topic, text, one.retain, expires))
            if one.state is not None:
                awaited[one.state] = value
        with self._hearing(awaited):
            with self._change:
                self._anew_said -= awaited.keys()
            self._publish(messages)
            self._await(awaited)

    def present(self, names: Iterable[str]) -> dict[str, float]:
        """See `Connection`: of devices with a `state` that they keep at the broker, or said lately."""
        states = {name: state for name in names if (state := self._actuators[name].state) is not None}
        deadline, held = time.monotonic() + TIMEOUT_S, {}
        with self._hearing(states.values()), self._change:
            while not set(states.values()) <= set(self._heard) and (left_s := deadline - time.monotonic()) > 0.0:
                self._change.wait(left_s)
            heard = dict(self._heard)
        for name, state in states.items():
            one, said = self._actuators[name], heard.get(state, "")
            by_option = {text: level for level, text in one.options.items()}
            value = by_option.get(said, SWITCH.get(said.lower()))
            if value is None:
                try:
                    value = (_number(said) - one.offset) / one.scale
                except ValueError:
                    continue
            held[name] = value
        return held

    @contextmanager
    def _hearing(self, states: Collection[str]) -> Iterator[None]:
        """Hear what devices say while the block lasts. Where nothing is recorded yet (the watchdog gives a building
        back) that is by a quiet client: it neither says that a controller is there, nor writes to the record.
        """
        if self._client is not None or not states:
            yield
            return
        client, topics = self._made(""), sorted({state.partition("#")[0] for state in states})

        def on_connect(_c: Any, _u: Any, _f: Any, _reason: Any, _p: Any = None) -> None:
            client.subscribe([(topic, 1) for topic in topics])

        def on_message(_c: Any, _u: Any, message: Any) -> None:
            self._hear(message.topic, message.payload[:_MOST_PAYLOAD].decode("utf-8", "replace").strip())

        client.on_connect, client.on_message = on_connect, on_message
        try:
            client.connect(self._host, self._port, keepalive=_KEEPALIVE_S, **self._anew())
            client.loop_start()
            yield
        except (OSError, ValueError) as error:
            raise not_reached(self._where, _WHERE, error) from error
        finally:
            client.disconnect()
            client.loop_stop()

    def _hear(self, topic: str, text: str) -> None:
        """Keep what a device says that it took."""
        with self._change:
            for state in {one.state for one in self._actuators.values() if one.state is not None}:
                of, _, key = state.partition("#")
                if of == topic and (value := _value(text, key)) is not None:
                    self._heard[state] = value
                    self._anew_said.add(state)
            self._change.notify_all()

    def _await(self, awaited: Mapping[str, str]) -> None:
        """Wait until devices say what they were set to; raises `PlantError` where one does not in time, `NotAsTold`
        where all of these say another value instead.
        """
        deadline = time.monotonic() + TAKEN_S
        with self._change:
            while wrong := {key: v for key, v in awaited.items() if not _alike(self._heard.get(key), v)}:
                if not self._change.wait(max(deadline - time.monotonic(), 0.0)) and time.monotonic() >= deadline:
                    told = ", ".join(f"{key} says {self._heard.get(key)}, not {value}" for key, value in wrong.items())
                    if wrong.keys() & self._anew_said:
                        told += ": does it round, or have limits? See resolution, minimum and maximum in the map"
                    for key in wrong.keys() - self._anew_said:  # what it held before may not be what it holds
                        self._heard.pop(key, None)
                    if wrong.keys() <= self._anew_said:
                        raise NotAsTold(
                            f"not taken: {told}", [name for name, one in self._actuators.items() if one.state in wrong]
                        )
                    raise PlantError(f"not taken: {told}")

    def tell(self, said: Mapping[str, Any]) -> None:
        """Publish what was decided, retained, as states of the device: `status`, `why`, `notes`, `plan` and others."""
        for key, value in said.items():
            text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
            self._said[f"{self._prefix}/{key}"] = text
            if self.connected:
                # Of quality 0: what is not sent now is sent with all that is known on the next connection.
                self._client.publish(f"{self._prefix}/{key}", text, qos=0, retain=True)

    def listen(self, asks: Mapping[str, Callable[[str], None]]) -> None:
        """Call one of `asks`, by the last part of a topic `PREFIX/set/KEY`, with what people publish there.

        A retained message is no wish of now, and not taken as one.
        """
        self._asks = dict(asks)
        if self._client is not None and self._client.is_connected():
            self._subscribe(self._client)
            self._describe(self._client)

    def close(self) -> None:
        """See `Connection.close`: says that nobody controls any more, and disconnects."""
        self._append({}, all_of_it=True)
        client, self._client = self._client, None
        if client is None:
            return
        if client.is_connected():
            with suppress(Exception):
                client.publish(f"{self._prefix}/availability", "offline", qos=1, retain=True).wait_for_publish(2.0)
        client.disconnect()
        client.loop_stop()

    def drop(self) -> None:
        """End without a word, as where the process is gone: the broker sends the last will."""
        client, self._client = self._client, None
        if client is not None:
            client.loop_stop()
            _break_off(client)

    def _made(self, name: str) -> Any:
        try:
            import paho.mqtt.client as paho
        except ModuleNotFoundError as error:
            raise ConfigError(
                "connection mqtt needs paho-mqtt, which is not installed: pip install 'thermoforce-mpc[mqtt]'"
            ) from error
        protocol = paho.MQTTv5 if self._version == "5" else paho.MQTTv311
        more: dict[str, Any] = {} if self._version == "5" else {"clean_session": True}
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id=name, protocol=protocol, **more)
        client.connect_timeout = TIMEOUT_S
        if self._user is not None:
            client.username_pw_set(self._user, self._password)
        if self._context is not None:
            client.tls_set_context(self._context)
        return client

    def _anew(self) -> dict[str, Any]:
        return {"clean_start": True} if self._version == "5" else {}

    def _publish(self, messages: Iterable[tuple[str, str, bool, int | None]]) -> None:
        """Publish over a connection of its own, confirmed by the broker, or break it off; raises `PlantError`."""
        client, refused = self._made(""), list[str]()
        ready = threading.Event()

        def on_connect(_c: Any, _u: Any, _f: Any, reason: Any, _p: Any = None) -> None:
            if getattr(reason, "is_failure", reason != 0):
                refused.append(str(reason))
            ready.set()

        def on_publish(_c: Any, _u: Any, _m: Any, reason: Any = None, _p: Any = None) -> None:
            if getattr(reason, "is_failure", False):
                refused.append(str(reason))

        client.on_connect, client.on_publish = on_connect, on_publish
        where, done = self._where, False
        try:
            client.connect(self._host, self._port, keepalive=_KEEPALIVE_S, **self._anew())
            client.loop_start()
            if not ready.wait(TIMEOUT_S) or refused:
                raise PlantError(f"{where}: {refused[0] if refused else 'no answer'}: nothing was set")
            deadline = time.monotonic() + TIMEOUT_S
            waiting = [
                client.publish(topic, text, qos=1, retain=retain, properties=self._expiring(expires))
                for topic, text, retain, expires in messages
            ]
            for info in waiting:
                info.wait_for_publish(max(deadline - time.monotonic(), 0.01))
                if not info.is_published() or refused:
                    raise PlantError(f"{where}: {refused[0] if refused else 'not confirmed in time'}: withdrawn")
            done = True
        except (OSError, ValueError, RuntimeError) as error:
            raise PlantError(f"{not_reached(where, _WHERE, error)}: nothing was set") from error
        finally:
            if not done:
                _break_off(client)
            client.disconnect()
            client.loop_stop()

    def _expiring(self, seconds: int | None) -> Any:
        if self._version != "5" or seconds is None:
            return None
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties = Properties(PacketTypes.PUBLISH)
        properties.MessageExpiryInterval = seconds
        return properties

    def _on_connect(self, client: Any, _userdata: Any, _flags: Any, reason: Any, _properties: Any = None) -> None:
        if getattr(reason, "is_failure", reason != 0):
            self._not_taken_in(NoConnection(f"{self._where} does not take us in ({reason}): see user and password"))
            return
        self._problem, self._away = "", None
        self._subscribe(client)
        self._describe(client)
        for topic, text in dict(self._said).items():
            client.publish(topic, text, qos=0, retain=True)
        client.publish(f"{self._prefix}/availability", "online", qos=1, retain=True)

    def _describe(self, client: Any) -> None:
        """Tell Home Assistant of the device, with what may be asked of it as far as that is known yet."""
        if self._discovery is None:
            return
        node = self._prefix.replace("/", "_")
        text = json.dumps(device_message(self._prefix, node, VERSION, tuple(self._asks)))
        client.publish(f"{self._discovery}/device/{node}/config", text, qos=1, retain=True)

    def _on_disconnect(self, _client: Any, _userdata: Any, _flags: Any, reason: Any, _properties: Any = None) -> None:
        if self._away is None:
            self._problem = f"{self._where}: lost ({reason})"
        with self._change:  # what devices said meanwhile is not known
            self._heard.clear()
        if self._client is not None:
            _LOG.warning("%s", self._problem)

    def _subscribe(self, client: Any) -> None:
        topics = {column.partition("#")[0] for column in self._columns}
        topics |= {f"{self._prefix}/set/{key}" for key in self._asks}
        if topics and client.is_connected():
            client.subscribe([(topic, 1) for topic in sorted(topics)])

    def _on_message(self, _client: Any, _userdata: Any, message: Any) -> None:
        if len(message.payload) > _MOST_PAYLOAD:
            return
        text, asked = message.payload.decode("utf-8", "replace").strip(), f"{self._prefix}/set/"
        if message.topic.startswith(asked):
            ask = self._asks.get(message.topic.removeprefix(asked))
            if ask is not None and not message.retain:
                try:
                    ask(text)
                except Exception as error:  # whatever people publish ends no control
                    _LOG.warning("%s: %r: %s", message.topic, text[:100], error)
            return
        self._hear(message.topic, text)
        states, came = {one.state for one in self._actuators.values()}, dict[str, str]()
        for column in self._columns:
            topic, _, key = column.partition("#")
            if topic != message.topic or (value := _value(text, key)) is None:
                continue
            # When a retained reading was taken nobody knows; what was set holds until it is set anew.
            if not message.retain or column in states:
                came[column] = value
        if came:
            self._append(came)

    def _keep_lately(self) -> None:
        with self._writing:
            _keep_lately(self._record, self._days)
        self._kept_at = utc_now()

    def _append(self, came: Mapping[str, str], *, all_of_it: bool = False) -> None:
        """Record what `came` by column. What comes too often waits, the latest of it, until it is time, or a reader
        wants `all_of_it`: a state that lasts is never lost.
        """
        with self._writing:
            now, lines = utc_now(), io.StringIO()
            self._later |= {column: (now, value) for column, value in came.items()}
            due = [
                column
                for column in self._later
                if all_of_it
                or column not in self._recorded
                or not timedelta() <= now - self._recorded[column] < self._every  # also where the clock was set back
            ]
            rows = sorted((*self._later.pop(column), column) for column in due)
            self._recorded |= dict.fromkeys(due, now)
            csv.writer(lines, lineterminator="\n").writerows(
                (at.isoformat(timespec="milliseconds"), column, value) for at, value, column in rows
            )
            if not rows:
                return
            try:
                begin = _begin_of_line(self._record) if self._unrecorded or not self._record.exists() else ""
                with self._record.open("a", encoding="utf-8") as file:
                    file.write(begin + lines.getvalue())
            except OSError as error:
                if not self._unrecorded:  # of a disk that is full once, and not with each message
                    _LOG.warning("%s: what comes is not recorded (%s)", self._record, error.strerror or error)
                self._unrecorded = True
                return
            if self._unrecorded:
                _LOG.warning("%s: what comes is recorded again", self._record)
            self._unrecorded = False


def utc_now() -> datetime:
    """The clock of commands and records."""
    return datetime.now(UTC)


def _plain_topic(text: str) -> bool:
    return bool(text) and not any(mark in text for mark in "+#\x00") and len(text) < 1000 and not text.startswith("$")


def _text(one: MqttActuator, level: float | None) -> str:
    """The value as text; raises `PlantError` for one that is none."""
    if level is None:
        return one.release if isinstance(one.release, str) else f"{one.release:.10g}"
    if one.options:
        if float(level) not in one.options:
            raise PlantError(f"{one.topic} has no option for {level:g}: see key options")
        return one.options[float(level)]
    if not math.isfinite(level):
        raise PlantError(f"{one.topic}: {level} is no value")
    return f"{round(level * one.scale + one.offset, 9):.10g}"


def _value(text: str, key: str) -> str | None:
    """What a payload says, of JSON what stands at `key` (a.b for nested ones); None where it says nothing."""
    found: Any = text
    if key:
        try:
            found = json.loads(text)
            for part in key.split("."):
                found = found[part]
        except (ValueError, KeyError, TypeError):
            return None
    if isinstance(found, bool):
        return "1" if found else "0"
    if found is None or isinstance(found, dict | list):
        return None
    said = str(found).strip()
    return said[:200] if said and "\n" not in said else None


def _number(text: str) -> float:
    """A payload as a number, with a decimal comma too and the unit behind it; raises `ValueError` for what is none."""
    told = _TOLD.fullmatch(text)
    return float(text if told is None else f"{told[1]}.{told[2] or 0}")


def _alike(heard: str | None, wanted: str) -> bool:
    """Whether a device says what it was told, as a number or word."""
    if heard is None:
        return False
    numbers = []
    for text in (heard, wanted):
        word = SWITCH.get(text.lower())
        try:
            numbers.append(_number(text) if word is None else word)
        except ValueError:
            return heard == wanted
    return abs(numbers[0] - numbers[1]) <= 0.05


def _begin_of_line(record: Path) -> str:
    """What comes before the next line of a record: its header, or the end of a line that the disk had no room for."""
    if not record.exists() or not record.stat().st_size:
        return _HEADER
    with record.open("rb") as file:
        file.seek(-1, 2)
        return "" if file.read() == b"\n" else "\n"


def _break_off(client: Any) -> None:
    """Close the connection with a reset, so that nothing in the system's buffers is delivered later."""
    connection = client.socket()
    if connection is None:
        return
    with suppress(OSError, ValueError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    with suppress(OSError, ValueError):
        connection.close()


def _since(of_days: Mapping[bytes, int], days: float) -> bytes:
    """From which day on lines are kept, by how many there are `of_days`: `days` before the last of which more than a
    few lines are, since those may be from before the clock was set back, and before today, for it may be wrong too.
    """
    few = _FEW * sum(of_days.values())
    last = utc_now().date()
    for day in sorted(of_days, reverse=True):
        few -= of_days[day]
        if few < 0.0:
            with suppress(ValueError):
                last = min(last, date.fromisoformat(day.decode("ascii", "replace")))
                break
    return (last - timedelta(days=days)).isoformat().encode()


def _keep_lately(record: Path, days: float) -> None:
    """Leave out of the record what is older than `days`, where that is a good part of it; and end a torn line."""
    if not record.exists():
        with storage_errors(record.parent):
            record.parent.mkdir(parents=True, exist_ok=True)
        return
    of_days = Counter[bytes]()
    with storage_errors(record), record.open("rb") as file:  # line by line: it may be of a hundred million bytes
        last = file.readline()
        # Another table, an export say, would be cut and added to.
        if not _HEADER.encode().startswith(last.rstrip(b"\r\n")):
            raise ConfigError(
                f"connection mqtt: record: {record}: is no record of this connection, whose first line is "
                f"'{_HEADER.strip()}': name another file; a model takes both (--data {record} --data …)"
            )
        for last in file:
            of_days[last[:10]] += 1
    since = _since(of_days, days)
    old = sum(n for day, n in of_days.items() if day < since)
    if last.endswith(b"\n") and old <= 0.2 * of_days.total():
        return
    with written(record) as aside, record.open("rb") as file, aside.open("wb") as kept:
        file.readline()
        kept.write(_HEADER.encode())
        kept.writelines(line.rstrip(b"\r\n") + b"\n" for line in file if line[:10] >= since)
