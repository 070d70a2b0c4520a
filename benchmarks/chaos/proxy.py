"""Proxy between a client and a BOPTEST service that makes troubles on purpose, and notes what really happened."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from benchmarks.chaos.troubles import (
    AWAY,
    BROKEN,
    INSIDE,
    NO_FORECAST,
    NOT_ITSELF,
    READINGS,
    REFUSALS,
    RESTART,
    SILENT,
    UNITS,
    WRONG_CLOCK,
    Trouble,
)

# A client may take a request that is refused (400) three consecutive times for a wrong one.
_MOST_400_ON_END = 2
_ABSURD: tuple[Any, ...] = (
    [],
    "yes",
    {"payload": 7},
    {"status": 200, "message": "", "payload": {"time": "noon"}},
    {"detail": None},
)


@dataclass
class Seen:
    """What a proxy saw: inputs of every step as sent, ends of every step that was simulated, how often what was made.

    `stopped`: whether the service was told to stop the test and did; `kpis`: those of the service just before.
    """

    inputs: list[dict[str, Any]] = field(default_factory=list)
    step_ends_s: list[float] = field(default_factory=list)
    made: dict[str, int] = field(default_factory=dict)
    restarted: bool = False
    stopped: bool = False
    kpis: dict[str, float] = field(default_factory=dict)


class Proxy:
    """State of a proxy for one test; troubles begin when the test was initialised at `start_s`."""

    def __init__(self, upstream: str, troubles: Sequence[Trouble], seed: int, silent_s: float, zone_point: str) -> None:
        """Args: address of the service; troubles and their seed; how long it is silent, s; point of the zone sensor."""
        self.seen, self.slept_s = Seen(), 0.0
        self._upstream, self._rng = upstream, np.random.default_rng(seed)
        self._troubles = [trouble for trouble in troubles if trouble.kind not in (*INSIDE, *UNITS)]
        self._units = [trouble.kind for trouble in troubles if trouble.kind in UNITS]
        self._silent_s, self._zone_point = silent_s, zone_point
        self._lock = threading.Lock()
        self._start_s: float | None = None
        self._now_s = 0.0
        self._made: dict[Trouble, int] = {}
        self._back_at_s = -1.0
        self._back_how = ""
        self._stuck: float | None = None
        self._refused_on_end = 0
        self._before: dict[str, tuple[int, bytes]] = {}
        self._late: tuple[str, str, bytes] | None = None

    def sleep(self, seconds: float) -> None:
        """The client's pauses: they pass at once, and count for how long the service is away."""
        self.slept_s += seconds

    def request(self, method: str, path: str, body: bytes) -> tuple[int, bytes] | None:
        """Status and body to answer with; None to break the connection."""
        verb = path.strip("/").partition("/")[0]
        with self._lock:
            if verb == "advance":
                self.seen.inputs.append(_mapping(body))
            trouble = self._trouble(verb)
            if self.slept_s < self._back_at_s:
                return None if self._back_how == "refusing" else _refusal(503)
        if trouble is None or (trouble.kind == "400" and self._refused_on_end >= _MOST_400_ON_END):
            self._refused_on_end = 0
            return self._forwarded(method, path, body, verb)
        kind = trouble.kind
        if kind in AWAY:
            self._back_at_s, self._back_how = self.slept_s + trouble.seconds, kind
            return None if kind == "refusing" else _refusal(503)
        if kind == RESTART:
            self.seen.restarted = True
            self._ask("PUT", f"/stop/{path.strip('/').partition('/')[2]}", b"{}")
            return None
        if kind in SILENT or kind == "late":
            self._silent(kind, method, path, body, verb)
            return None
        if kind == NO_FORECAST:
            return _refusal(500)
        self._refused_on_end = self._refused_on_end + 1 if kind == "400" else 0
        if kind in REFUSALS:
            if kind.endswith("after"):
                self._forwarded(method, path, body, verb)
            return _refusal(int(kind[:3]))
        if kind == "doubled":
            self._forwarded(method, path, body, verb)
            return self._forwarded(method, path, body, verb)
        if kind in NOT_ITSELF:
            return self._another(kind, method, path, body, verb)
        if kind in READINGS:
            return self._misread(kind, self._forwarded(method, path, body, verb))
        if kind in WRONG_CLOCK:
            return _shifted(WRONG_CLOCK[kind], self._forwarded(method, path, body, verb))
        return self._broken(kind, method, path, body, verb)

    def _silent(self, kind: str, method: str, path: str, body: bytes, verb: str) -> None:
        """Say nothing until the client has given up; what is late arrives behind the next step."""
        if kind == "silent after":
            self._forwarded(method, path, body, verb)
        if kind == "late":
            self._late = (method, path, body)
        time.sleep(self._silent_s)

    def _another(self, kind: str, method: str, path: str, body: bytes, verb: str) -> tuple[int, bytes]:
        """The answer of something else in the service's place, or an old one."""
        if kind == "cached":
            return self._before.get(verb) or self._forwarded(method, path, body, verb)
        if kind.endswith("after"):
            self._forwarded(method, path, body, verb)
        page = b"<html><body>No such page.\x1b[31m</body></html>"
        answers = {"redirect": (302, page), "page": (404, page), "null": (200, b'{"message": "", "payload": null}')}
        return answers[kind.removesuffix(" after")]

    def _broken(self, kind: str, method: str, path: str, body: bytes, verb: str) -> tuple[int, bytes] | None:
        if kind not in BROKEN:
            raise ValueError(f"unknown trouble {kind!r}")
        if kind == "reset before":
            return None
        status, answer = self._forwarded(method, path, body, verb)
        if kind == "reset after":
            return None
        if kind == "html":
            return 200, b"<html><body>Please log in</body></html>"
        if kind == "empty":
            return 200, b""
        if kind == "other json":
            return 200, json.dumps(_ABSURD[int(self._rng.integers(len(_ABSURD)))]).encode()
        return -status, answer  # half of it: the server sends its length and breaks off

    def _trouble(self, verb: str) -> Trouble | None:
        """The first trouble that this request meets; the stop is spared, it has ten seconds only."""
        if self._start_s is None or verb in ("stop", "initialize"):
            return None
        after_s = self._now_s - self._start_s
        for trouble in self._troubles:
            made = self._made.get(trouble, 0)
            if trouble.at not in ("", verb) or not trouble.from_s <= after_s < trouble.to_s or made >= trouble.most:
                continue
            if self._rng.random() < trouble.share:
                self._made[trouble] = made + 1
                self.seen.made[trouble.kind] = self.seen.made.get(trouble.kind, 0) + 1
                return trouble
        return None

    def _forwarded(self, method: str, path: str, body: bytes, verb: str) -> tuple[int, bytes]:
        """Hand the request on, and note what came of it."""
        if verb == "stop":
            _, told = self._ask("GET", path.replace("stop", "kpi", 1), b"")
            self.seen.kpis = {k: v for k, v in (_payload(told) or {}).items() if v is not None}
        status, answer = self._in_other_units(*self._ask(method, path, body))
        self._before[verb] = status, answer
        with self._lock:
            payload = _payload(answer) if status == 200 else None
            if verb in ("initialize", "advance") and isinstance(payload, dict) and "time" in payload:
                self._now_s = float(payload["time"])
                if verb == "initialize":
                    self._start_s, self.seen.step_ends_s = self._now_s, []
                else:
                    self.seen.step_ends_s.append(self._now_s)
            self.seen.stopped |= verb == "stop" and status == 200
            late, self._late = (self._late, None) if verb == "advance" else (None, self._late)
        if late:
            self._forwarded(*late, verb)
        return status, answer

    def _in_other_units(self, status: int, answer: bytes) -> tuple[int, bytes]:
        """The answer with points in other units, where it has some."""
        content, payload = _mapping(answer), _payload(answer)
        if not (self._units and status == 200 and isinstance(payload, dict)):
            return status, answer
        for kind in self._units:
            begin, factor, _ = UNITS[kind]
            for name in [name for name in payload if name.startswith(begin) and not isinstance(payload[name], dict)]:
                payload[name] = _times(factor, payload[name])
                self.seen.made[kind] = self.seen.made.get(kind, 0) + 1
        return status, json.dumps(content | {"payload": payload}).encode()

    def _misread(self, kind: str, answered: tuple[int, bytes]) -> tuple[int, bytes]:
        status, answer = answered
        content, payload = _mapping(answer), _payload(answer)
        if status != 200 or not isinstance(payload, dict):
            return answered
        sensors = sorted(name for name in payload if name.startswith("rea"))
        name = self._zone_point if self._rng.random() < 0.5 else str(self._rng.choice(sensors))
        if kind == "in °C":
            payload[self._zone_point] -= 273.15
        elif kind == "stuck":
            self._stuck = payload[self._zone_point] if self._stuck is None else self._stuck
            payload[self._zone_point] = self._stuck
        elif kind == "nan":
            payload[name] = None
        else:
            payload.pop(name, None)
        return status, json.dumps(content | {"payload": payload}).encode()

    def _ask(self, method: str, path: str, body: bytes) -> tuple[int, bytes]:
        parts = urlsplit(self._upstream)
        connection = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=120)
        try:
            connection.request(method, path, body, {"Content-Type": "application/json"} if body else {})
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()


@contextmanager
def serving(proxy: Proxy) -> Iterator[str]:
    """Address of the proxy, on a free loopback port until the block ends."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *args: object) -> None:
            """Say nothing."""

        def _serve(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            answer = proxy.request(self.command, self.path, body)
            self.close_connection = True
            if answer is None:
                return
            status, content = answer
            try:
                self.send_response(abs(status))
                self.send_header("Content-Type", "text/html" if content[:1] == b"<" else "application/json")
                if abs(status) == 302:
                    self.send_header("Location", "https://elsewhere.example/")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Connection", "close")
                self.end_headers()
                self.wfile.write(content if status > 0 else content[: len(content) // 2])
            except OSError:
                return  # the client gave up waiting

        do_GET = do_PUT = do_POST = _serve

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join(timeout=5)


def _refusal(status: int) -> tuple[int, bytes]:
    return status, json.dumps({"status": status, "message": "made by chaos", "payload": None}).encode()


def _times(factor: float, value: Any) -> Any:
    if isinstance(value, list):
        return [_times(factor, item) for item in value]
    return value if value is None else value * factor


def _shifted(seconds: float, answered: tuple[int, bytes]) -> tuple[int, bytes]:
    """The answer with another clock, where it has one."""
    content, payload = _mapping(answered[1]), _payload(answered[1])
    if not (isinstance(payload, dict) and "time" in payload):
        return answered
    times = payload["time"]
    payload["time"] = [time_s + seconds for time_s in times] if isinstance(times, list) else times + seconds
    return answered[0], json.dumps(content | {"payload": payload}).encode()


def _mapping(text: bytes) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _payload(text: bytes) -> Any:
    return _mapping(text).get("payload")
