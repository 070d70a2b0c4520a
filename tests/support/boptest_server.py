"""A BOPTEST service for tests: documented protocol, real socket, the embedded plant inside, faults to order."""

from __future__ import annotations

import json
import re
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.emulator import OVERWRITES
from thermoforce_mpc.plants.embedded.kernel import RECORD, STEP_S
from thermoforce_mpc.types import DAY_S
from thermoforce_mpc.weather import synthetic_weather

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


class Rejected(Exception):
    """Answered with 400."""


@dataclass
class Fault:
    """What goes wrong with the next `times` requests whose path matches `pattern`."""

    pattern: str
    kind: str  # "500", "drop", "slow", "garbage", "gone"
    times: int = 1
    after_work: bool = False  # the request is carried out, only its answer is lost


@dataclass
class Service:
    """State of the service: its tests, its faults, and what it was asked."""

    url: str = ""
    tests: dict[str, EmbeddedPlant] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    queued_polls: int = 1

    def count(self, prefix: str) -> int:
        return sum(path.startswith(prefix) for path in self.requests)

    def answer(self, method: str, path: str, body: dict):
        if path == "version":
            return {"version": "0.9.0-test"}
        if match := re.fullmatch(r"testcases/(\w+)/select", path):
            if match[1] != NAME:
                raise Rejected(f"Invalid testcase name: {match[1]}")
            testid = str(uuid.uuid4())
            self.tests[testid], self.steps[testid] = EmbeddedPlant(synthetic_weather()), 3600.0
            self.ends[testid] = np.inf
            return {"testid": testid}
        verb, _, testid = path.partition("/")
        if testid not in self.tests:
            raise Rejected(f"Invalid testid: {testid}")
        plant = self.tests[testid]
        return getattr(self, f"_{verb}")(testid, plant, body)

    def _status(self, testid, plant, body):
        if self.queued_polls > 0:
            self.queued_polls -= 1
            return "Queued"
        return "Running"

    def _name(self, testid, plant, body):
        return {"name": NAME}

    def _inputs(self, testid, plant, body):
        names = [f"{name}{ending}" for name, _, _ in OVERWRITES for ending in ("_u", "_activate")]
        return {name: {"Unit": "1", "Description": name, "Minimum": 0, "Maximum": 1} for name in names}

    def _measurements(self, testid, plant, body):
        return {
            name: {"Unit": None, "Description": name, "Minimum": None, "Maximum": None} for name in self._now(plant)
        }

    def _forecast_points(self, testid, plant, body):
        return {name: {"Unit": "1", "Description": name} for name in [*_FORECAST, *_PRICES]}

    def _now(self, plant):
        return dict(plant._measurement(np.empty((0, len(RECORD)))).points) | {"time": plant._now_s}

    def _initialize(self, testid, plant, body):
        plant.reset(float(body["start_time"]), float(body["warmup_period"]), plant._price)
        self.ends[testid] = np.inf
        return self._now(plant)

    def _scenario(self, testid, plant, body):
        if body.get("electricity_price"):
            plant._price = body["electricity_price"]
        out = {key: None for key in ("electricity_price", "time_period")} | {"electricity_price": plant._price}
        if body.get("time_period"):
            period = plant.period(body["time_period"])
            plant.reset(period.start_s, period.warmup_s, plant._price)
            self.ends[testid] = period.start_s + period.scored_s
            out["time_period"] = self._now(plant)
        return out

    def _step(self, testid, plant, body):
        if "step" in body:
            if not isinstance(body["step"], int | float) or body["step"] <= 0:
                raise Rejected("Invalid value for parameter step")
            self.steps[testid] = float(body["step"])
        return self.steps[testid]

    def _advance(self, testid, plant, body):
        if plant._now_s >= self.ends[testid]:
            return {}
        overrides = {}
        for name, low, high in OVERWRITES:
            if body.get(f"{name}_activate"):
                overrides[name] = min(max(float(body[f"{name}_u"]), low), high)
        plant.advance_points(overrides, self.steps[testid])
        return self._now(plant)

    def _forecast(self, testid, plant, body):
        boundary = plant.forecast(float(body["horizon"]), float(body["interval"]))
        out = {"time": boundary.time_s.tolist()}
        for name in body["point_names"]:
            if name in _PRICES:
                out[name] = plant._tariffs[_PRICES[name]](boundary.time_s).tolist()
            elif name in _FORECAST:
                attribute, shift = _FORECAST[name]
                out[name] = (getattr(boundary, attribute) + shift).tolist()
            else:
                raise Rejected(f"Invalid forecast point: {name}")
        return out

    def _results(self, testid, plant, body):
        from thermoforce_mpc.plants.embedded.emulator import _MEASUREMENTS

        rows = np.vstack([plant._first, *plant._record])
        time_s = plant._begin_s + np.arange(rows.shape[0]) * STEP_S
        inside = (time_s >= body["start_time"]) & (time_s <= body["final_time"])
        out = {"time": time_s[inside].tolist()}
        for name in body["point_names"]:
            out[name] = rows[inside, RECORD.index(_MEASUREMENTS[name])].tolist()
        return out

    def _kpi(self, testid, plant, body):
        return plant.kpis() | {"pgas_tot": None, "time_rat": 1e-4}

    def _stop(self, testid, plant, body):
        self.stopped.append(testid)
        del self.tests[testid]


@contextmanager
def running_service(days: float = 14.0) -> Iterator[Service]:
    """A service on a free loopback port, until the block ends."""
    service = Service()
    lock = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *args):
            pass

        def _serve(self):
            path = self.path.strip("/")
            length = int(self.headers.get("Content-Length") or 0)
            body = json.loads(self.rfile.read(length) or b"{}")
            with lock:
                service.requests.append(path)
                fault = next((f for f in service.faults if f.times > 0 and re.match(f.pattern, path)), None)
                if fault:
                    fault.times -= 1
                if fault and fault.kind == "gone":
                    service.tests.clear()
                status, message, payload = 200, "Success", None
                if not fault or fault.after_work or fault.kind in ("slow", "gone"):
                    try:
                        payload = service.answer(self.command, path, body)
                    except Rejected as error:
                        status, message = 400, str(error)
            kind = fault.kind if fault else ""
            if kind == "slow":
                time.sleep(1.0)
            if kind == "drop":
                self.connection.close()
                return
            if kind == "500":
                status, message, payload = 500, "Internal error in the simulation", None
            text = (
                "<html>not json</html>"
                if kind == "garbage"
                else json.dumps({"status": status, "message": message, "payload": payload})
            )
            try:
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(text)))
                self.end_headers()
                self.wfile.write(text.encode())
            except OSError:
                pass  # the client gave up waiting

        do_GET = do_PUT = do_POST = _serve

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    service.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield service
    finally:
        server.shutdown()
        server.server_close()
        thread.join(timeout=5)


__all__ = ["DAY_S", "NAME", "Fault", "Service", "running_service"]
