"""Whatever a service answers, the client returns checked values or raises an error of its own."""

from __future__ import annotations

import io
import json
import tracemalloc
import zlib
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest
import requests
from fuzzing import VALUES, fuzz, mutated, result_or_error, tampered
from hypothesis import given
from hypothesis import strategies as st

from boptest_client import (
    AdvanceInterrupted,
    BoptestClient,
    BoptestError,
    ProtocolError,
    ServiceScenario,
    TransportConfig,
)

HASTY = TransportConfig(connect_timeout_s=0.01, read_timeout_s=5.0, patience_s=0.0, backoff_s=0.0)
POINT = {"Unit": "K", "Description": "room", "Minimum": 278.15, "Maximum": 308.15}
STATE = {"time": 3600, "reaTRoo_y": 294.1, "oveTSet_u": None}
SERIES = {"time": [0, 3600], "TDryBul": [280.0, None]}
CALLS = {
    "inputs": (lambda c: c.inputs(), {"oveTSet_u": POINT, "oveTSet_activate": {}}),
    "measurements": (lambda c: c.measurements(), {"reaTRoo_y": POINT}),
    "name": (lambda c: c.name(), {"name": "bestest_air"}),
    "version": (lambda c: c.version(), {"version": "0.8.0"}),
    "step": (lambda c: c.step(), 3600),
    "scenario": (lambda c: c.scenario(), {"electricity_price": "dynamic", "time_period": None, "seed": 1}),
    "set_scenario": (lambda c: c.set_scenario(ServiceScenario(time_period="peak_heat_day")), {"time_period": STATE}),
    "initialize": (lambda c: c.initialize(3600.0, 0.0), STATE),
    "advance": (lambda c: c.advance({"oveTSet_u": 294.0}), STATE),
    "forecast": (lambda c: c.forecast(["TDryBul"], 3600.0, 3600.0), SERIES),
    "results": (lambda c: c.results(["TDryBul"], 0.0, 3600.0), SERIES),
    "kpi": (lambda c: c.kpi(), {"cost_tot": 0.5, "tdis_tot": None}),
}


class Service:
    """In place of a connection: answers each request with what it was told to."""

    def __init__(self) -> None:
        self.status, self.content = 200, b""

    def request(self, *_: object, **__: object) -> requests.Response:
        return _answer(self.content, self.status)


@pytest.fixture
def service(monkeypatch):
    found = Service()
    monkeypatch.setattr(requests.Session, "request", lambda _, *args, **kwargs: found.request(*args, **kwargs))
    return found


@pytest.fixture
def client(service):
    return _selected(service, HASTY)


def _selected(service, config):
    service.content = b'{"testid": "1"}'
    selecting = {"POST": b'{"testid": "1"}', "GET": b'{"status": 200, "message": "", "payload": "Running"}'}
    service.request = lambda method, *_, **__: _answer(selecting[method])
    made = BoptestClient("http://127.0.0.1:9", "bestest_air", config=config)
    del service.request
    return made


def _answer(content: bytes, status: int = 200) -> requests.Response:
    answer = requests.Response()
    answer.status_code, answer.raw = status, io.BytesIO(content)
    return answer


def enveloped(payload: object) -> bytes:
    return json.dumps({"status": 200, "message": "done", "payload": payload}).encode("utf-8", "surrogatepass")


@pytest.mark.parametrize("name", CALLS)
def test_the_plain_answer_is_understood(service, client, name):
    call, plain = CALLS[name]
    service.content = enveloped(plain)
    assert call(client)


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_values_that_were_changed(service, client, name):
    call, plain = CALLS[name]

    @fuzz(60)
    @given(payload=tampered(plain) | VALUES, status=st.sampled_from([200, 200, 200, 400, 404, 500]))
    def check(payload, status):
        try:
            service.content = enveloped(payload)
        except ValueError:
            return  # an integer of more digits than Python writes
        service.status = status
        result_or_error(BoptestError, lambda: call(client), names="http://127.0.0.1:9", most=3000)

    check()


@pytest.mark.slow
@fuzz(150)
@given(
    content=mutated(enveloped(STATE)) | st.binary(max_size=50),
    name=st.sampled_from(sorted(CALLS)),
    status=st.sampled_from([200, 200, 204, 302, 400, 503]),
)
def test_bytes_of_any_kind(content, name, status):
    with pytest.MonkeyPatch.context() as patch:
        service = Service()
        patch.setattr(requests.Session, "request", lambda _, *args, **kwargs: service.request(*args, **kwargs))
        selecting = iter([b'{"version": "1"}', b'{"testid": "1"}', b'"Running"'])
        service.request = lambda *_, **__: _answer(next(selecting))
        client = BoptestClient("http://127.0.0.1:9", "bestest_air", config=HASTY)
        del service.request
        service.content, service.status = content, status
        result_or_error(BoptestError, lambda: CALLS[name][0](client), names="http://127.0.0.1:9", most=3000)


@pytest.mark.slow
def test_an_answer_that_unpacks_to_no_end_is_read_no_further_than_its_bound():
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    bomb = b"".join(packer.compress(b" " * 10_000_000) for _ in range(25)) + packer.flush()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.send_header("Content-Encoding", "gzip")
            self.send_header("Content-Length", str(len(bomb)))
            self.end_headers()
            self.wfile.write(bomb)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        thread = Thread(target=http.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        tracemalloc.start()
        try:
            patient = TransportConfig(connect_timeout_s=1.0, read_timeout_s=60.0, patience_s=0.0)
            with pytest.raises(ProtocolError, match="the answer is longer than 200,000,000 bytes"):
                BoptestClient(f"http://127.0.0.1:{http.server_port}", "bestest_air", config=patient)
            assert tracemalloc.get_traced_memory()[1] < 450e6
        finally:
            tracemalloc.stop()
            http.shutdown()
            thread.join()


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("step", 10**400),
        ("kpi", {"cost_tot": 10**400}),
        ("advance", STATE | {"time": 10**400}),
        ("advance", STATE | {"time": float("inf")}),
        ("results", SERIES | {"time": [0, 10**400]}),
        ("results", SERIES | {"time": [0, float("inf")]}),
    ],
)
def test_numbers_beyond_all_bounds(service, name, payload):
    # A nonsensical answer is asked for again until this has passed; one takes a hundredth of a second where work is.
    client = _selected(service, replace(HASTY, connect_timeout_s=0.1))
    service.content = enveloped(payload)
    # What came of an advance is looked for in the record, which is nonsense here as well.
    with pytest.raises(AdvanceInterrupted if name == "advance" else ProtocolError, match=f"/{name}/1"):
        CALLS[name][0](client)
