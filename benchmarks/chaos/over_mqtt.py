"""Houses behind a real MQTT broker for days, at speed: commissioned, shadowed, controlled, with what fails around them.

A drawn house whose heat pump stands behind its own controller (`benchmarks.commands`) is a device on a mosquitto of its
own: it publishes its readings, takes its command (set-points, curve offset, SG-Ready) with the time until which that
holds, says what it took, and is left to itself after. The same days are lived three times from the same instant: in
process, behind the broker, and behind the broker while things fail. Time is the house's; the broker's is the machine's.
"""

from __future__ import annotations

import copy
import json
import math
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.chaos.mosquitto import Broker, Listener, missing, wire
from benchmarks.commands.bench import ROOMS, USUAL_KINDS, Home, price_per_kWh
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.connections import mqtt
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.data import DAY_S, HOUR_S, energy_kWh
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.live import Decision, KeptState, LiveBuilding, control
from thermoforce_mpc.live.commissioning import read_house
from thermoforce_mpc.live.trial import planned_trials, tried
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.points import read_points
from thermoforce_mpc.model.thermal_model import ThermalModel

Row = dict[str, Any]

_ORIGIN = pd.Timestamp("2026-01-01", tz="UTC")
_ROW_S, _STEP_S = 900.0, HOUR_S
_HORIZON_H, _SHADOW_H = 24.0, 24
# Days of the record that a controller finds, trials in the last three: as a log of 37,000 lines the month that a model
# is made of took half of a step's time.
_KEPT_D = 14
# With `quick`: hours of shadow and of control.
_QUICK_H = (1, 2)
# The client's patience at speed, s: of the house's time an hour passes in less.
_PATIENCE_S, _TAKEN_S, _RECORDED_S = 1.0, 5.0, 3.0
FAULTS = "broker, faults"
"""The way in which things fail."""
# When what fails, as a share of the hours of control, and for how long, h.
_FAULTS = {
    "broker restarted": (0.12, 0.0), "network cut": (0.25, 1.0), "unavailable": (0.4, 1.0), "torn": (0.52, 0.0),
    "clock stepped back": (0.64, 0.0), "killed": (0.78, 1.6),
}  # fmt: skip
# In these nothing reaches the house: it is left to its own control once what holds has ended, so long after a step, h.
_UNREACHED, _ENDED_H = ("network cut", "killed"), 0.1
# Plans act again so long after a fault, h: from the next step on.
_RECOVERED_H = 1.5
_PLANNED = ("solved", "bridged")
# Costs within, and K·h outside the bounds in all rooms within.
_DEARER, _MORE_KH = 0.02, 0.2
_COMMANDS: Mapping[str, Mapping[str, Any]] = {
    "set-points": {"kind": "setpoint", "resolution": 0.5, "minimum": 16, "maximum": 26},
    "curve offset": {"kind": "curve_offset", "usual": 0},
    "SG-Ready": {"kind": "sg_ready", "usual": 2},
}


class Killed(BaseException):
    """Nothing after it runs, as after SIGKILL."""


class EmulatedHouse:
    """A house as `Connection` and `Clock`: a row a quarter of an hour; what was set holds until its time is over."""

    def __init__(self, seed: int, kind: str) -> None:
        self.kind, self.home = kind, Home(seed, kind)
        self.zones = self.home.plant.zones
        self.keys = self.home.plant.actuators if kind == "set-points" else ("heat_pump",)
        lived = self.home.live(seed)
        self._now_s = self._begin_s = float(self.home.plant.forecast(_STEP_S, _STEP_S).time_s[0])
        self.rows = self._last_rows(np.repeat(lived, round(HOUR_S / _ROW_S), axis=1))
        self.written: list[tuple[pd.Timestamp, str, float | None]] = []
        self.on_row: Callable[[Row], None] = _ignored
        self.events: dict[float, Callable[[], None]] = {}
        self.is_dead = False
        self.own_at_h: list[tuple[float, bool]] = []
        self.stamp: pd.Timestamp | None = None
        self._told: dict[str, float] = {}
        self._ends_s, self.behind_s = math.inf, 0.0

    @property
    def hour(self) -> float:
        """Hours since it was handed over."""
        return (self._now_s - self._begin_s) / HOUR_S

    @property
    def true_now(self) -> pd.Timestamp:
        """The house's time, whatever the controller's clock says."""
        return _ORIGIN + pd.Timedelta(seconds=self._now_s)

    @property
    def told(self) -> Mapping[str, float]:
        """What is set now; what is missing is the house's own."""
        return dict(self._told)

    def now(self) -> pd.Timestamp:
        """See `Clock.now`."""
        return self.true_now - pd.Timedelta(seconds=self.behind_s)

    def clock(self) -> Any:
        """The clock of a connection: that of a reading, `stamp`, while it is published."""
        return (self.now() if self.stamp is None else self.stamp).to_pydatetime()

    def step_clock_back(self) -> None:
        """The controller's clock is a minute behind from now on."""
        self.behind_s = 60.0

    def wait_until(self, at: pd.Timestamp) -> None:
        """See `Clock.wait_until`: the house lives."""
        until_s = (at - _ORIGIN).total_seconds() + self.behind_s
        while self._now_s < until_s - 1e-6:
            if self.is_dead:
                raise Killed
            row_s = (math.floor(self._now_s / _ROW_S + 1e-9) + 1.0) * _ROW_S
            if self._ends_s <= self._now_s + 1e-6:
                self._told, self._ends_s = {}, math.inf
            part_s = min(row_s, until_s, self._ends_s) - self._now_s
            told = self._commands()
            self.home.advance(told, part_s)
            self._now_s += part_s
            if abs(self._now_s - row_s) < 1e-6:
                self.own_at_h.append((self.hour, not self._told))
                own = self.home.usual(np.array([self._now_s - _ROW_S]))[:, 0]
                set_to = [usual if one is None else one for one, usual in zip(told, own, strict=True)]
                self.rows += self._last_rows(np.array(set_to)[:, None])
                while self.events and next(iter(self.events)) <= self.hour:
                    self.events.pop(next(iter(self.events)))()
                self.on_row(self.rows[-1])

    def _commands(self) -> tuple[float | None, ...]:
        if self.kind == "set-points":
            return tuple(self._told.get(name) for name in self.keys)
        return (self._told.get("heat_pump"),) * ROOMS

    def _last_rows(self, set_to: Any) -> list[Row]:
        """The last steps of the record, of which `set_to` (Z, n) was set, as rows that are stamped at their ends."""
        record = self.home.record(_ROW_S).last(set_to.shape[1])
        bounds = self.home.plant.forecast(_STEP_S, _STEP_S)
        table: dict[str, Any] = {
            "time": _ORIGIN + pd.to_timedelta(record.time_s[1:], unit="s"),
            "out": record.T_out_C[1:], "sun": record.solar_W_m2[1:], "P": record.power_W[0],
        }  # fmt: skip
        for z, zone in enumerate(self.zones):
            table |= {f"T_{zone}": record.T_zone_C[z, 1:], f"u_{zone}": record.u[z]}
            table |= {f"low_{zone}": bounds.lower_C[z, 0], f"high_{zone}": bounds.upper_C[z, 0]}
            if self.kind == "set-points":
                table[f"set_{zone}"] = set_to[z]
        if self.kind != "set-points":
            table["set"] = set_to[0]
        frame = pd.DataFrame(table)
        return [dict(zip(table, row, strict=True)) for row in frame.itertuples(index=False)]

    def map_of(self, prefix: str = "", **more: Any) -> dict[str, Any]:
        """The map of its table, whose columns are named with `prefix`."""
        plant, shared = self.home.plant, self.kind != "set-points"
        rooms = {room.name: room for room in plant.house.rooms}
        zones, actuators = {}, dict[str, Any]()
        for zone, name in zip(self.zones, plant.actuators, strict=True):
            room = rooms[zone]
            zones[zone] = {
                "temperature": f"{prefix}T_{zone}", "lower": f"{prefix}low_{zone}", "upper": f"{prefix}high_{zone}",
                "floor_area_m2": float(room.area_m2),
            }  # fmt: skip
            share = min(room.emitter_W / plant.house.heat_pump.capacity_W, 1.0)
            actuators[name] = {"zone": zone, "level": f"{prefix}u_{zone}", "share": float(share)}
            if not shared:
                actuators[name]["command"] = {**_COMMANDS[self.kind], "column": f"{prefix}set_{zone}"}
        machine: dict[str, Any] = {"power": f"{prefix}P", "price": 0.25}
        if shared:
            machine["command"] = {**_COMMANDS[self.kind], "column": f"{prefix}set"}
        ahead = {"outdoor": "out", "sun": "sun", "price": "price", "time": {"zone": "UTC"}}
        return {
            "time": {"zone": "UTC", "marks": "end"}, "step": "1h", "outdoor": f"{prefix}out", "sun": f"{prefix}sun",
            "zones": zones, "actuators": actuators, "machines": {"heat_pump": machine}, "forecast": ahead,
        } | more  # fmt: skip

    def measurements(self) -> pd.DataFrame:
        """See `Connection.measurements`."""
        return pd.DataFrame(self.rows)

    def forecast(self) -> pd.DataFrame:
        """See `Connection.forecast`."""
        ahead = self.home.plant.forecast((_HORIZON_H + 2.0) * HOUR_S, _STEP_S)
        index = pd.DatetimeIndex(_ORIGIN + pd.to_timedelta(ahead.time_s, unit="s"), name="time")
        columns: dict[str, Any] = {"out": ahead.T_out_C, "sun": ahead.solar_W_m2, "price": price_per_kWh(ahead.time_s)}
        for z, zone in enumerate(self.zones):
            columns |= {f"low_{zone}": ahead.lower_C[z], f"high_{zone}": ahead.upper_C[z]}
        return pd.DataFrame(columns, index=index)

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`."""
        for key, value in levels.items():
            self.take(key, value, self.true_now + pd.Timedelta(seconds=seconds))

    def take(self, key: str, value: float | None, until: pd.Timestamp) -> None:
        """Be told a command, which holds until then."""
        self.written.append((self.true_now, key, value))
        if value is None:
            self._told.pop(key, None)
        else:
            self._told[key], self._ends_s = value, (until - _ORIGIN).total_seconds()

    def close(self) -> None:
        """Nothing is open."""

    def hour_of(self, instant: pd.Timestamp) -> float:
        """Hours from when it was handed over to an instant."""
        return ((instant - _ORIGIN).total_seconds() - self._begin_s) / HOUR_S

    def scores(self, begin_h: float, hours: int) -> tuple[float, float]:
        """Cost, and K·h outside the bounds of all rooms, of so many hours from an hour on."""
        since_h = (begin_h + 1e-6, begin_h + hours + 1e-6)
        rows = pd.DataFrame([row for row in self.rows if since_h[0] < self.hour_of(row["time"]) <= since_h[1]])
        at_s = np.asarray((rows["time"] - _ORIGIN).dt.total_seconds(), dtype=np.float64) - _ROW_S
        cost = float((energy_kWh(rows["P"].to_numpy(), _ROW_S) * price_per_kWh(at_s // HOUR_S * HOUR_S)).sum())
        outside = 0.0
        for zone in self.zones:
            T_C, lower_C, upper_C = (rows[f"{of}_{zone}"].to_numpy(np.float64) for of in ("T", "low", "high"))
            outside += float(np.nansum(excess(T_C, lower_C, upper_C)))
        return cost, outside * _ROW_S / HOUR_S


def _ignored(row: Row) -> None:
    """Nobody looks at a row."""


class MqttHouse:
    """The house as a device on a broker, and the connection to it over a wire, port `port`, that can be cut."""

    def __init__(self, house: EmulatedHouse, broker: Broker, port: int, folder: Path) -> None:
        self.house, self._broker, self._port = house, broker, port
        self.is_unavailable = False
        self.record = folder / "mqtt.csv"
        self.columns = [key for key in house.rows[0] if key != "time"]
        lines = ["time,topic,value"]
        for row in house.rows:
            lines += [f"{row['time'].isoformat()},home/{name},{row[name]:.6f}" for name in self.columns]
        self.record.write_text("\n".join(lines) + "\n")
        # What was sent and confirmed, and what came: no more of anything may come.
        self.sent, self.came = Counter[tuple[str, float]](), Counter[tuple[str, float]]()
        self.late = self._subscriptions = 0
        self.connection: Any = None
        self.device = broker.client(
            on_message=self._told, on_connect=self._connected, on_subscribe=self._subscribed
        )  # fmt: skip
        self.wait_for(lambda: self._subscriptions > 0)
        house.on_row = self.publish

    def connect(self) -> None:
        """A connection, as a process that is started makes one."""
        payload = '{"v": "$value", "until": "$until"}'
        actuators = {
            key: {"topic": f"home/{key}/set", "release": "own", "payload": payload, "state": f"home/{key}/state"}
            for key in self.house.keys
        }
        options = self._broker.options(actuators=actuators, record=str(self.record), prefix="mpc", port=self._port)
        self.connection = connection = build_connection("mqtt", options)
        recorded, write = connection.measurements, connection.write

        def forecast() -> pd.DataFrame:
            ahead = self.house.forecast()
            return ahead.rename(columns={name: f"home/{name}" for name in self.columns if name not in ("out", "sun")})

        def measurements() -> Any:
            self._alive()
            return recorded()

        def written(levels: Mapping[str, float | None], seconds: float) -> None:
            self._alive()
            write(levels, seconds)
            self.sent.update((key, value) for key, value in levels.items() if value is not None)

        connection.forecast = forecast  # type: ignore[method-assign]
        connection.measurements, connection.write = measurements, written  # type: ignore[method-assign]
        connection.reads([f"home/{one}" for one in self.columns])  # type: ignore[attr-defined]
        connection.begin()  # type: ignore[attr-defined]
        self.wait_for(lambda: self.is_reached)

    @property
    def is_reached(self) -> bool:
        """Whether the connection has its broker."""
        return self.connection is not None and bool(self.connection.connected)

    def _alive(self) -> None:
        if self.house.is_dead:
            raise Killed

    def wait_for(self, holds: Callable[[], bool], seconds: float = 30.0) -> None:
        """Wait until something holds; raises `PlantError` where it does not in time."""
        until = time.monotonic() + seconds
        while not holds():
            if time.monotonic() > until:
                raise PlantError(f"the broker and its clients did not do within {seconds:g} s what is waited for")
            time.sleep(0.002)

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any = None) -> None:
        client.subscribe("home/+/set", 1)

    def _subscribed(self, client: Any, userdata: Any, number: int, reasons: Any, properties: Any = None) -> None:
        self._subscriptions += 1

    def _told(self, client: Any, userdata: Any, message: Any) -> None:
        key, text = message.topic.split("/")[1], message.payload.decode()
        said = json.loads(text)
        until = pd.Timestamp(said["until"]) + pd.Timedelta(seconds=self.house.behind_s)
        if said["v"] != "own" and until <= self.house.true_now:
            self.late += 1
            return
        value = None if said["v"] == "own" else float(said["v"])
        if value is not None:
            self.came[key, value] += 1
        self.house.take(key, value, until)
        client.publish(f"home/{key}/state", said["v"], qos=1, retain=True)

    def publish(self, row: Row) -> None:
        """Readings of a time, until the last of them stands in the record."""
        for key in self.house.keys:  # what ended by itself
            if key not in self.house.told:
                self.device.publish(f"home/{key}/state", "own", qos=1, retain=True)
        if not self.is_reached:
            return
        self.house.stamp, last = row["time"] - pd.Timedelta(seconds=self.house.behind_s), b""
        for name in self.columns:
            if not (self.is_unavailable and name.startswith(("T_", "u_", "set"))):
                text = f"{row[name]:.6f}"
                self.device.publish(f"home/{name}", text, qos=1)
                last = f"{self.house.clock().isoformat(timespec='milliseconds')},home/{name},{text}\n".encode()
        until = time.monotonic() + _RECORDED_S
        while last not in self._tail() and self.is_reached and time.monotonic() < until:
            time.sleep(0.0005)
        self.house.stamp = None

    def _tail(self) -> bytes:
        with self.record.open("rb") as file:
            file.seek(max(self.record.stat().st_size - 4096, 0))
            return file.read()

    def restart_broker(self, snap: Callable[[], None]) -> None:
        """The broker ends and is started again; both clients come back by themselves."""
        subscriptions = self._subscriptions
        self._broker.stop()
        snap()
        self.wait_for(lambda: not self.is_reached and not self.device.is_connected())
        self._broker.start()
        self.wait_for(lambda: self.is_reached and self._subscriptions > subscriptions)

    def join_again(self, cut: threading.Event, snap: Callable[[], None]) -> None:
        """The cut network is back: what was open is dead."""
        snap()
        self.wait_for(lambda: not self.is_reached)
        cut.clear()
        self.wait_for(lambda: self.is_reached)

    def kill(self, snap: Callable[[], None]) -> None:
        """The process with the connection is gone, and says nothing more: the broker sees its wire end."""
        connection, self.connection = self.connection, None
        connection.drop()
        snap()

    def tear(self) -> None:
        """A power failure leaves half a line and NUL."""
        with self.record.open("ab") as file:
            file.write(b"2026-02-0\x00\x00\x00,home")

    def close(self) -> None:
        """End the connection, if there is one, and the device."""
        if self.connection is not None:
            self.connection.close()
        self.device.disconnect()
        self.device.loop_stop()


@dataclass
class Lived:
    """What a run came to: decisions of control, what was tried and shadowed, and scores of the days under control.

    `begun`: how many commands were written before these days.
    """

    house: EmulatedHouse
    trials: list[str] = field(default_factory=list)
    shadowed: int = 0
    decisions: list[Decision] = field(default_factory=list)
    begun: int = 0
    cost: float = math.nan
    outside_Kh: float = math.nan


class _Course:
    """Commissioning, a day's shadow, then control, by a connection."""

    def __init__(
        self, house: EmulatedHouse, connection: Any, rules: Mapping[str, Any], model: ThermalModel, folder: Path
    ):
        self.house, self.folder, self.model = house, folder, model
        self.connection, self.rules = connection, MeasurementMap.model_validate(rules)
        self.lived = Lived(house)

    def building(self) -> LiveBuilding:
        """The building, by the connection that there is."""
        return LiveBuilding(self.connection, self.rules, _STEP_S)

    def controller(self) -> ThermoForceMPC:
        """The controller, with commands learned of what was measured until now."""
        measured = read_measurements(self.building().table(), self.rules, step_s=_STEP_S, now=self.house.now()).served()
        config = MPCConfig.model_validate({"step_s": _STEP_S, "horizon_h": _HORIZON_H, "gate": {"enabled": False}})
        return ThermoForceMPC(self.model, config, commands=learned_commands(measured))

    def commission(self) -> None:
        """Points read, and one trial of each command."""
        building = self.building()
        found = read_house(building, self.rules, self.house.now())
        if found.problems:
            raise ConfigError(f"commissioning: {'; '.join(found.problems)}")
        for plan in planned_trials(building, found.points, found.bounds_C, {}):
            outcome = tried(
                building, plan, read=lambda now: read_points(building.table(), self.rules, now), clock=self.house,
                sets=str(self.folder),
            )  # fmt: skip
            self.lived.trials.append(outcome.status)
        self.house.wait_until(self.house.now().ceil("1h"))

    def control(self, steps: int, acts: bool = True) -> None:
        """So many hours of control, or of its shadow."""
        told: list[Decision] = []
        kept = KeptState(self.folder / "state.npz", "over mqtt") if acts else None
        try:
            control(
                self.building(), self.controller(), clock=self.house, steps=steps, delay_s=0.0, told=told.append,
                kept=kept, acts=acts, sets=str(self.folder),
            )  # fmt: skip
        finally:
            if acts:
                self.lived.decisions += told
            else:
                self.lived.shadowed = len(told)


def run_over_mqtt(
    *,
    kinds: Sequence[str] = USUAL_KINDS,
    seed: int = 100,
    days: int = 14,
    quick: bool = False,
    only_faults: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """`days` of a house of each kind, of which one in shadow; `quick`: some hours of the first kind without faults.

    `only_faults`: without the days behind a broker at which nothing fails.

    Raises:
        ConfigError: no broker is installed.
    """
    if why := missing():
        raise ConfigError(f"{why}: the house stands behind a real broker")
    rows: list[Row] = []
    ways = ("broker",) if quick else (FAULTS,) if only_faults else ("broker", FAULTS)
    shadow_h, hours = _QUICK_H if quick else (_SHADOW_H, days * 24 - _SHADOW_H)
    for kind in kinds[:1] if quick else kinds:
        rows += _run_kind(kind, seed, (shadow_h, hours), progress, ways)
    return results_json("mqtt", rows, _targets(rows))


def _run_kind(
    kind: str, seed: int, hours: tuple[int, int], progress: Callable[[str], None], ways: Sequence[str]
) -> list[Row]:
    begun = EmulatedHouse(seed, kind)
    step = "15min" if FAULTS in ways else "1h"  # identified in a quarter of the time
    measured = read_measurements(pd.DataFrame(begun.rows), begun.map_of(step=step), now=begun.now()).served()
    model = identify(measured.record, config=IdentificationConfig(), layout=measured.layout)
    progress(f"{kind}: {begun.home.plant.house.name} identified")
    begun.rows = begun.rows[-round(_KEPT_D * DAY_S / _ROW_S) :]
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        usual = _in_process(copy.deepcopy(begun), model, folder, hours)
        rows.append(_row(kind, "in process", usual, usual))
        progress(f"{kind} in process: {rows[-1]}")
        for name in ways:
            run = folder / name.replace(", ", "-")
            run.mkdir()
            rows.append(_behind(kind, name, copy.deepcopy(begun), model, run, hours, usual))
            progress(f"{kind} by {name}: {rows[-1]}")
    return rows


def _in_process(house: EmulatedHouse, model: ThermalModel, folder: Path, hours: tuple[int, int]) -> Lived:
    course = _Course(house, house, house.map_of(), model, folder)
    course.commission()
    course.control(hours[0], acts=False)
    begin_h, course.lived.begun = house.hour, len(house.written)
    course.control(hours[1])
    course.lived.cost, course.lived.outside_Kh = house.scores(begin_h, hours[1])
    return course.lived


@contextmanager
def _patience(house: EmulatedHouse) -> Iterator[None]:
    """The connection's clock is that of the house, and its patience that of loopback."""
    kept = mqtt.utc_now, mqtt.TIMEOUT_S, mqtt.TAKEN_S
    mqtt.utc_now, mqtt.TIMEOUT_S, mqtt.TAKEN_S = house.clock, _PATIENCE_S, _TAKEN_S
    try:
        yield
    finally:
        mqtt.utc_now, mqtt.TIMEOUT_S, mqtt.TAKEN_S = kept


def _behind(
    kind: str, name: str, house: EmulatedHouse, model: ThermalModel, folder: Path, hours: tuple[int, int], usual: Lived
) -> Row:
    """The days behind a broker; with faults where `name` is FAULTS."""
    with ExitStack() as ends:
        broker = Broker(folder)
        ends.callback(broker.stop)
        broker.start()
        ends.enter_context(_patience(house))
        port, cut, snap = ends.enter_context(wire(broker.port))
        home = MqttHouse(house, broker, port, folder)
        ends.callback(home.close)
        home.connect()
        rules = house.map_of("home/", table={"point": "topic", "value": "value"})
        course = _Course(house, home.connection, rules, model, folder)
        course.commission()
        course.control(hours[0], acts=False)
        begin_h, course.lived.begun = house.hour, len(house.written)
        faults = _faults(begin_h, hours[1]) if name == FAULTS else {}
        house.events = _events(home, faults, cut, snap)
        try:
            course.control(hours[1])
        except (Killed, PlantError):  # a dead process gives nothing back
            if not house.is_dead:
                raise
        if house.is_dead:  # somebody starts it again
            home.kill(snap)
            house.is_dead = False
            begin, end = faults["killed"]
            house.wait_until(house.now() + pd.Timedelta(hours=end - begin))
            home.connect()
            course.connection = home.connection
            course.control(max(1, hours[1] - math.floor(house.hour - begin_h - house.behind_s / HOUR_S + 1e-6)))
        commands = {course.building().key(one): course.building().command_of(one) for one in course.building().names}
        home.connection.close()
        course.lived.cost, course.lived.outside_Kh = house.scores(begin_h, hours[1])
        row = _row(kind, name, course.lived, usual)
        told = [(key, value) for _, key, value in house.written[course.lived.begun :] if value is not None]
        wrong = [] if told and all(_allowed(commands[key], value) for key, value in told) else ["out of range, or none"]
        wrong += _wrong_at_device(home, course.lived) + _wrong_in_faults(house, course.lived, faults)
        return row | {"wrong": "; ".join(wrong + _wrong_at_broker(broker, house.keys))}


def _allowed(command: Any, value: float) -> bool:
    return math.isfinite(value) and bool(command.allows(value))


def _faults(begin_h: float, hours: int) -> dict[str, tuple[float, float]]:
    """Begin and end of what fails, hours of the house, at ends of rows."""
    row_h = _ROW_S / HOUR_S
    begins = {name: begin_h + math.ceil(share * hours / row_h) * row_h for name, (share, _) in _FAULTS.items()}
    return {name: (begins[name], begins[name] + _FAULTS[name][1]) for name in _FAULTS}


def _events(
    home: MqttHouse, faults: Mapping[str, tuple[float, float]], cut: threading.Event, snap: Callable[[], None]
) -> dict[float, Callable[[], None]]:
    """What happens at which hour of the house."""
    if not faults:
        return {}
    at = {name: begin - 1e-6 for name, (begin, _) in faults.items()}
    ends = {name: end - 1e-6 for name, (_, end) in faults.items()}
    events: dict[float, Callable[[], None]] = {
        at["broker restarted"]: lambda: home.restart_broker(snap),
        at["network cut"]: cut.set,
        ends["network cut"]: lambda: home.join_again(cut, snap),
        at["unavailable"]: lambda: setattr(home, "is_unavailable", True),
        ends["unavailable"]: lambda: setattr(home, "is_unavailable", False),
        at["torn"]: home.tear,
        at["clock stepped back"]: home.house.step_clock_back,
        at["killed"]: lambda: setattr(home.house, "is_dead", True),
    }
    return dict(sorted(events.items()))


def _row(kind: str, name: str, lived: Lived, usual: Lived) -> Row:
    told = sorted({value for _, _, value in lived.house.written[lived.begun :] if value is not None})
    planned = sum(one.plan.status in _PLANNED for one in lived.decisions)
    return {
        "by": kind, "way": name, "trials": ", ".join(lived.trials), "shadowed": lived.shadowed,
        "decisions": len(lived.decisions), "planned": planned,
        "told": ", ".join(f"{value:g}" for value in told), "cost": round(lived.cost, 3),
        "outside_Kh": round(lived.outside_Kh, 2), "dearer": round(lived.cost / usual.cost - 1.0, 5),
        "more_Kh": round(lived.outside_Kh - usual.outside_Kh, 3), "wrong": "",
    }  # fmt: skip


def _wrong_at_device(home: MqttHouse, lived: Lived) -> list[str]:
    """What must not be of what the device was told."""
    wrong = []
    if more := home.came - home.sent:
        wrong.append(f"a command twice, or one that was withdrawn: {dict(more)}")
    if home.late:
        wrong.append("a command too late")
    if home.house.told:
        wrong.append("not given back")
    if any(one.plan.status not in _PLANNED for one in lived.decisions[-3:]):
        wrong.append("not planned at the end")
    return wrong


def _wrong_in_faults(
    house: EmulatedHouse, lived: Lived, faults: Mapping[str, tuple[float, float]]
) -> list[str]:  # fmt: skip
    """Faults without the house's own control where nothing reached it, or without a plan soon after."""
    wrong = []
    for name, (begin_h, end_h) in faults.items():
        alone_h = (math.ceil(begin_h) + _ENDED_H, end_h)
        own = [is_own for hour, is_own in house.own_at_h if alone_h[0] < hour <= alone_h[1]]
        if name in _UNREACHED and not (own and all(own)):
            wrong.append(f"{name}: {sum(own)} of {len(own)} rows by the house's own control")
        planned_h = [house.hour_of(one.instant) for one in lived.decisions if one.plan.status in _PLANNED]
        if not any(end_h - 1.0 < hour <= end_h + _RECOVERED_H for hour in planned_h if hour >= begin_h):
            wrong.append(f"{name}: no plan within {_RECOVERED_H:g} h after")
    return wrong


def _wrong_at_broker(broker: Broker, keys: Sequence[str]) -> list[str]:
    """What must not be of what the broker keeps at the end."""
    wrong, late = [], Listener(broker, "#")
    for key in keys:
        if late.wait(f"home/{key}/state")[-1:] != ["own"]:
            wrong.append(f"the broker keeps {late.texts(f'home/{key}/state')} of {key}")
    if late.wait("mpc/availability")[-1:] != ["offline"]:
        wrong.append("the broker says that the controller is there")
    if any(topic.endswith("/set") for topic, _, kept in late.heard if kept):
        wrong.append("the broker keeps a command")
    late.close()
    return wrong


def _targets(rows: Sequence[Row]) -> list[Target]:
    """Calm, either way; with faults, what they cost."""
    calm, faults = ([row for row in rows if row["way"] == way] for way in ("broker", FAULTS))
    targets = []
    if calm:
        targets = [
            Target("other cost behind a broker, share", max(abs(row["dearer"]) for row in calm), _DEARER),
            Target("other K·h outside behind a broker", max(abs(row["more_Kh"]) for row in calm), _MORE_KH),
        ]
    if faults:
        targets += [
            Target("dearer with faults, share", max(row["dearer"] for row in faults), _DEARER),
            Target("more K·h outside with faults", max(row["more_Kh"] for row in faults), _MORE_KH),
        ]
    return [*targets, Target("runs in which something was wrong", float(sum(bool(row["wrong"]) for row in rows)), 0.0)]
