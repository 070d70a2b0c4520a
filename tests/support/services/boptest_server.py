"""A BOPTEST service for tests: documented protocol, real socket, the embedded plant inside, faults to order."""

from __future__ import annotations

import copy
import functools
import json
import re
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Period
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP

NAME = "bestest_hydronic_heat_pump"
_FORECAST = {
    "TDryBul": ("T_out_C", 273.15),
    "HGloHor": ("solar_W_m2", 0.0),
    "Occupancy[1]": ("occupancy", 0.0),
    "LowerSetp[1]": ("lower_C", 273.15),
    "UpperSetp[1]": ("upper_C", 273.15),
    "EmissionsElectricPower": ("emission_kg_per_kWh", 0.0),
}
_PRICES = {
    "PriceElectricPowerConstant": "constant",
    "PriceElectricPowerDynamic": "dynamic",
    "PriceElectricPowerHighlyDynamic": "highly_dynamic",
}


class Bare(Exception):
    """Answered as it is, without the envelope."""

    def __init__(self, status: int, body: object) -> None:
        super().__init__(str(body))
        self.status, self.body = status, body


def rejected(message: str) -> Bare:
    return Bare(400, {"status": 400, "message": message, "payload": None})


def unit_of(name: str) -> str | None:
    if name.startswith(("reaT", "weaSta_reaWeaTDryBul")):
        return "K"
    if name.startswith(("reaP", "reaQ")):
        return "W"
    return {"weaSta_reaWeaHGloHor_y": "W/m2", "reaCO2RooAir_y": "ppm", "reaCOP_y": "1"}.get(name)


@functools.cache
def template() -> EmbeddedPlant:
    # Finding windows takes a simulated year, and their week of warm-up a tenth of a second; neither is tested here.
    days = {"peak_heat_day": 16, "typical_heat_day": 108}
    periods = {name: Period(name, day * DAY_S, warmup_s=HOUR_S) for name, day in days.items()}
    plant = EmbeddedPlant(synthetic_weather(), periods=periods)
    plant.reset(3600.0, 3600.0)  # compiled now: later it would cost a client's patience
    return plant


def new_house() -> EmbeddedPlant:
    """A plant of its own that shares what never changes (weather, constructions)."""
    plant = copy.copy(template())
    plant.reset(0.0, 0.0)
    return plant


@dataclass
class Fault:
    """What goes wrong with the next `times` requests whose path matches `pattern`."""

    pattern: str
    # "500", "drop", "truncated", "slow", "drip", "drip head", "garbage", "moved", "gone", "edited", "page", "null"
    kind: str
    times: int = 1
    after_work: bool = False  # the request is carried out, only its answer is lost
    seconds: float = 1.0  # how slow
    edit: Callable[[object], object] = lambda payload: payload  # what is answered instead ("edited")


@dataclass
class Service:
    """State of the service: its tests, its faults, and what it was asked."""

    url: str = ""
    offers: tuple[str, ...] = (NAME,)
    tests: dict[str, Any] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    scenarios: dict[str, dict] = field(default_factory=dict)
    prices: dict[str, str] = field(default_factory=dict)
    bodies: list[tuple[str, dict]] = field(default_factory=list)
    message: str = ""
    page: str = "<html>No such page.</html>"
    faults: list[Fault] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    queued_polls: int = 1

    def count(self, prefix: str) -> int:
        return sum(path.startswith(prefix) for path in self.requests)

    def answer(self, method: str, path: str, body: dict):
        if path == "version":
            return {"version": "0.9.0-test"}
        if path == "testcases":
            raise Bare(200, [{"testcaseid": name} for name in (*self.offers, "bestest_air")])
        if match := re.fullmatch(r"testcases/(\w+)/select", path):
            if match[1] not in self.offers:
                raise Bare(404, "Not Found")
            testid = str(uuid.uuid4())
            self.tests[testid], self.steps[testid] = self._new(match[1]), 3600.0
            self.ends[testid] = np.inf
            raise Bare(200, {"testid": testid})
        verb, _, testid = path.partition("/")
        if testid not in self.tests:
            raise Bare(400, {"errors": [{"msg": f"Invalid testid: {testid}", "param": "testid"}]})
        plant = self.tests[testid]
        return getattr(self, f"_{verb}")(testid, plant, body)

    def _new(self, name):
        return new_house()

    def _status(self, testid, plant, body):
        if self.queued_polls > 0:
            self.queued_polls -= 1
            raise Bare(200, "Queued")
        raise Bare(200, "Running")

    def _name(self, testid, plant, body):
        return {"name": NAME}

    def _inputs(self, testid, plant, body):
        out = {}
        for name, low, high in HEAT_PUMP.overwrites:
            unit = "K" if name == "oveTSet" else "1"
            out[f"{name}_u"] = {"Unit": unit, "Description": name, "Minimum": low, "Maximum": high}
            out[f"{name}_activate"] = {"Unit": None, "Description": name, "Minimum": None, "Maximum": None}
        return out

    def _measurements(self, testid, plant, body):
        return {
            name: {"Unit": unit_of(name), "Description": name, "Minimum": None, "Maximum": None}
            for name in HEAT_PUMP.measurements
        }

    def _forecast_points(self, testid, plant, body):
        units = {"TDryBul": "K", "LowerSetp[1]": "K", "UpperSetp[1]": "K", "HGloHor": "W/m2"}
        return {name: {"Unit": units.get(name), "Description": name} for name in [*_FORECAST, *_PRICES]}

    def _now(self, plant):
        record = plant.recorded(plant.now_s, plant.now_s)
        points = {name: float(record[column][-1]) for name, column in HEAT_PUMP.measurements.items()}
        level = float(record["level"][-1]) if plant.now_s > plant.begin_s else 0.0
        # JSON has no NaN: the service writes null.
        points = {name: None if np.isnan(value) else value for name, value in points.items()}
        return points | {"oveHeaPumY_u": level, "time": plant.now_s}

    def _initialize(self, testid, plant, body):
        plant.reset(float(body["start_time"]), float(body["warmup_period"]), self._price(testid))
        self.ends[testid] = np.inf
        return self._now(plant)

    def _scenario(self, testid, plant, body):
        if not body:
            return self.scenarios.get(testid, {})
        if body.get("electricity_price"):
            self.prices[testid] = body["electricity_price"]
        price = self._price(testid)
        plant.use(price, None)
        self.scenarios[testid] = self.scenarios.get(testid, {}) | body
        out = dict.fromkeys(body) | {"electricity_price": price}
        if body.get("time_period"):
            if body["time_period"] not in ("peak_heat_day", "typical_heat_day"):
                raise rejected(f"Scenario parameter time_period is {body['time_period']}, but should be one of ...")
            period = plant.period(body["time_period"])
            plant.reset(period.start_s, period.warmup_s, price)
            self.ends[testid] = period.start_s + period.scored_s
            out["time_period"] = self._now(plant)
        return out

    def _price(self, testid):
        return self.prices.get(testid, "constant")

    def _step(self, testid, plant, body):
        if "step" in body:
            if not isinstance(body["step"], int | float) or body["step"] <= 0:
                raise rejected("Invalid value for parameter step")
            self.steps[testid] = float(body["step"])
        return self.steps[testid]

    def _advance(self, testid, plant, body):
        if plant.now_s >= self.ends[testid]:
            self.message = "End of test case scenario time period reached."
            return {}
        overrides = {}
        for name, low, high in HEAT_PUMP.overwrites:
            if body.get(f"{name}_activate"):
                value = float(body[f"{name}_u"])
                overrides[name] = min(max(value, low), high)
                if value != overrides[name]:
                    self.message = f"{value} is out of the limits of {name}_u, clipped"
        plant.advance_points(overrides, self.steps[testid])
        return self._now(plant)

    def _forecast(self, testid, plant, body):
        boundary = plant.forecast(float(body["horizon"]), float(body["interval"]))
        out = {"time": boundary.time_s.tolist()}
        for name in body["point_names"]:
            if name in _PRICES:
                out[name] = plant.tariff(_PRICES[name])(boundary.time_s).tolist()
            elif name in _FORECAST:
                attribute, shift = _FORECAST[name]
                out[name] = (np.atleast_2d(getattr(boundary, attribute))[0] + shift).tolist()
            else:
                raise rejected(f"Invalid forecast point: {name}")
        return out

    def _results(self, testid, plant, body):
        record = plant.recorded(body["start_time"], body["final_time"])
        if not record["time"].size:
            reason = "Traceback (most recent call last):\nIndexError: index 0 is out of bounds"
            raise Bare(500, {"status": 500, "message": "Internal BOPTEST error", "payload": reason})
        out = {"time": record["time"].tolist()}
        for name in body["point_names"]:
            if name in HEAT_PUMP.measurements:
                column = HEAT_PUMP.measurements[name]
            elif name == "oveHeaPumY_u":
                column = "level"
            elif name.startswith("ove"):
                out[name] = [0.0] * len(out["time"])
                continue
            else:
                raise rejected(f"Invalid point name {name} in parameter point_names.")
            out[name] = [None if np.isnan(v) else v for v in record[column].tolist()]
        return out

    def _kpi(self, testid, plant, body):
        return plant.kpis() | {"pgas_tot": None, "time_rat": 1e-4}

    def _stop(self, testid, plant, body):
        self.stopped.append(testid)
        del self.tests[testid]
        raise Bare(200, None)  # the bare word OK


@contextmanager
def running_service(service: Service | None = None) -> Iterator[Any]:
    """A service on a free loopback port, until the block ends; by default one with the embedded plant inside."""
    if service is None:
        template()
        service = Service()
    lock = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *args):
            pass

        def _drip(self, content):
            """Never silent for long, never done."""
            for i in range(len(content)):
                self.wfile.write(content[i : i + 1])
                self.wfile.flush()
                time.sleep(0.1)

        def _serve(self):
            path = self.path.strip("/")
            length = int(self.headers.get("Content-Length") or 0)
            body = json.loads(self.rfile.read(length) or b"{}")
            with lock:
                service.requests.append(path)
                service.bodies.append((path, body))
                service.message = "Advanced simulation successfully." if path.startswith("advance/") else "Success"
                fault = next((f for f in service.faults if f.times > 0 and re.match(f.pattern, path)), None)
                if fault:
                    fault.times -= 1
                kind = fault.kind if fault else ""
                if kind == "gone":
                    service.tests.clear()
                status, answer = 200, None
                if not fault or fault.after_work or kind in ("slow", "gone", "drip", "drip head", "edited"):
                    try:
                        payload = service.answer(self.command, path, body)
                        if kind == "edited":
                            payload = fault.edit(payload)
                        answer = {"status": status, "message": service.message, "payload": payload}
                    except Bare as bare:
                        status, answer = bare.status, bare.body
            if kind == "slow":
                time.sleep(fault.seconds)
            if kind == "drop":
                self.connection.close()
                return
            if kind == "500":
                status, answer = 500, {"status": 500, "message": "Internal error in the simulation", "payload": None}
            text = "OK" if path.startswith("stop/") and status == 200 else json.dumps(answer)
            if kind == "garbage":
                text = "<html>not json</html>"
            if kind == "moved":
                status = 302
            if kind == "null":
                text = json.dumps({"status": 200, "message": "", "payload": None})
            if kind == "page":
                status, text = 404, service.page
            try:
                if kind == "drip head":
                    self.wfile.write(b"HTTP/1.0 200 OK\r\nX-Slowly: ")
                    self._drip(b"x" * 10_000)
                self.send_response(status)
                self.send_header("Content-Type", "text/html" if kind == "page" else "application/json")
                self.send_header("Content-Length", str(len(text.encode())))
                if kind == "moved":
                    self.send_header("Location", "https://elsewhere.example/")
                self.end_headers()
                if kind == "drip":
                    self._drip(text.encode())
                    return
                self.wfile.write(text.encode()[: len(text) // 2] if kind == "truncated" else text.encode())
                if kind == "truncated":
                    self.connection.close()
            except OSError:
                pass  # the client gave up waiting

        do_GET = do_PUT = do_POST = _serve

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    service.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.005}, daemon=True)
    thread.start()
    try:
        yield service
    finally:
        server.shutdown()
        server.server_close()
        thread.join(timeout=5)


__all__ = ["DAY_S", "NAME", "Fault", "Service", "running_service"]
