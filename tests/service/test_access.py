"""Who may ask the service, how much and how often; what slow, greedy and confused clients get."""

from __future__ import annotations

import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import requests
from click.testing import CliRunner
from emulator_service import running_emulator_service
from waiting import LONG_S

from boptest_client import BoptestClient, RequestRejected, TransportConfig
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.cli.live.serve import serve as command
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import is_loopback
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.service import server
from thermoforce_mpc.service.access import Rate, Refusal
from thermoforce_mpc.service.server import build_server, serve_on
from thermoforce_mpc.service.sessions import Sessions, UnknownTestid

NAME = "bestest_hydronic_heat_pump"
SOON_S = LONG_S
TOKEN = "kept-in-a-drawer-0123456789"
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def url():
    with running_emulator_service(most_tests=4) as address:
        yield address


@pytest.fixture(scope="module")
def guarded():
    with running_emulator_service(token=TOKEN, host="0.0.0.0") as address:
        yield address


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.8.9.1"])
def test_the_loopback_is_known(host):
    assert is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.0.2", "example.org", "localhost.example.org"])
def test_any_other_address_needs_a_token(host):
    assert not is_loopback(host)
    with pytest.raises(ConfigError, match=r"can be reached from other machines.*BOPTEST_TOKEN"):
        build_server(synthetic_weather(), host=host, port=0)


@pytest.mark.parametrize("token", ["short", "with spaces in between", "new\nline-0123456789", "ümlaut-0123456789"])
def test_a_token_that_is_weak_or_cannot_be_sent_is_refused(token):
    with pytest.raises(ConfigError, match="16 or more printable ASCII characters"):
        build_server(synthetic_weather(), port=0, token=token)


def test_the_command_says_who_can_reach_it_and_takes_no_address_without_token(monkeypatch):
    monkeypatch.delenv("BOPTEST_TOKEN", raising=False)
    with pytest.raises(ConfigError, match="needs a token"):
        CliRunner().invoke(command, ["--host", "0.0.0.0"], catch_exceptions=False, standalone_mode=False)
    served = {}
    monkeypatch.setattr(server, "serve", lambda year, **options: served.update(options))
    monkeypatch.setenv("BOPTEST_TOKEN", TOKEN)
    said = CliRunner().invoke(command, ["--host", "0.0.0.0"], catch_exceptions=False, standalone_mode=False)
    assert "can be reached from other machines" in said.stderr
    assert "not encrypted" in " ".join(said.stderr.split())
    assert TOKEN not in said.output
    assert served["token"] == TOKEN


@pytest.mark.slow
@pytest.mark.parametrize(
    "header", [None, "", "Bearer", "Bearer ", f"Basic {TOKEN}", f"Bearer {TOKEN[:-1]}", f"Bearer {TOKEN}x", TOKEN]
)
@pytest.mark.parametrize(
    ("method", "path"), [("GET", "/version"), ("POST", f"/testcases/{NAME}/select"), ("GET", "/nowhere")]
)
def test_without_the_token_nothing_is_told(guarded, header, method, path):
    headers = {} if header is None else {"Authorization": header}
    answer = requests.request(method, guarded + path, headers=headers, timeout=SOON_S)
    assert answer.status_code == 401
    assert answer.headers["WWW-Authenticate"] == "Bearer"
    assert "Authorization: Bearer" in answer.json()["message"]
    assert TOKEN not in answer.text


@pytest.mark.slow
def test_our_client_sends_the_token_of_its_environment(guarded, monkeypatch):
    quick = TransportConfig(connect_timeout_s=1.0, read_timeout_s=SOON_S)
    monkeypatch.setenv("BOPTEST_TOKEN", TOKEN)
    with BoptestClient(guarded, NAME, config=quick) as test:
        assert test.advance()["time"] == 3600
    monkeypatch.delenv("BOPTEST_TOKEN")
    with pytest.raises(RequestRejected, match="Authorization: Bearer TOKEN"):
        BoptestClient(guarded, NAME, config=quick)


def test_the_document_names_the_token_where_one_is_needed(guarded, url):
    asked = requests.get(f"{guarded}/openapi.json", headers={"Authorization": f"bearer {TOKEN}"}, timeout=SOON_S).json()
    assert asked["components"]["securitySchemes"]["token"]["scheme"] == "bearer"
    assert "401" in asked["paths"]["/version"]["get"]["responses"]
    assert "security" not in requests.get(f"{url}/openapi.json", timeout=SOON_S).json()


@pytest.mark.slow
def test_more_requests_than_the_rate_get_429_and_when_to_come_again(monkeypatch):
    with running_emulator_service(per_second=5.0) as address, requests.Session() as client:
        monkeypatch.setattr(time, "monotonic", lambda: 1e6)  # so that it is the same second, on any machine
        answers = [client.get(f"{address}/version", timeout=SOON_S) for _ in range(40)]
        refused = [answer for answer in answers if answer.status_code == 429]
        assert all(answer.ok for answer in answers[:10])
        assert refused
        assert refused[0].headers["Retry-After"] == "1"
        assert "5 requests a second" in refused[0].json()["message"]
        monkeypatch.setattr(time, "monotonic", lambda: 1e6 + 0.5)
        assert client.get(f"{address}/version", timeout=SOON_S).ok


def test_the_rate_is_each_addresss_own_and_recovers(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    rate = Rate(2.0)
    for _ in range(4):
        rate.admit("a")
    with pytest.raises(Refusal):
        rate.admit("a")
    rate.admit("b")
    clock[0] += 0.5
    rate.admit("a")
    with pytest.raises(Refusal):
        rate.admit("a")


def test_a_test_ends_with_its_lifetime_even_if_used(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    sessions = Sessions(object, most=2, idle_s=100.0, lifetime_s=250.0)
    testid, lone = sessions.select(), sessions.lone()
    for clock[0] in (90.0, 180.0, 249.0):
        sessions.check(testid)
    clock[0] = 251.0
    with pytest.raises(UnknownTestid):
        sessions.check(testid)
    assert sessions.lone() == lone, "a client without test ids could not see that its test was replaced"
    assert sessions.select() != testid


@pytest.mark.parametrize("limit", ["most_tests", "idle_s", "lifetime_s", "most_bytes", "per_second"])
def test_a_limit_of_nothing_is_refused(limit):
    with pytest.raises(ConfigError, match=f"{limit} is 0"):
        build_server(synthetic_weather(), port=0, **{limit: 0})


def test_a_body_longer_than_the_limit_gets_413():
    with running_emulator_service(most_bytes=2000) as address:
        answer = requests.put(f"{address}/step", data=b" " * 2001, headers=JSON, timeout=SOON_S)
        assert answer.status_code == 413
        assert answer.json()["payload"] is None
        assert requests.put(f"{address}/step", data=b'{"step": 900}' + b" " * 1900, headers=JSON, timeout=SOON_S).ok


@pytest.mark.parametrize(
    "path",
    [
        "/testcases/../../etc/passwd",
        "/testcases/%2e%2e%2f%2e%2e%2fetc%2fpasswd/select",
        "//evil.example/version",
        "/status/..%2f..%2fversion",
        "/" + "a" * 5000,
        "/step/%00",
        "/static/app.py",
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "DELETE", "PATCH", "TRACE", "PROPFIND"])
def test_paths_that_lead_elsewhere_lead_nowhere(url, method, path):
    host, port = url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=SOON_S) as connection:  # `requests` would tidy the path
        connection.sendall(
            f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode()
        )
        answer = b""
        while part := connection.recv(65536):
            answer += part
    assert answer.split()[1] in (b"400", b"404", b"405"), answer
    assert len(answer) < 1000


@pytest.mark.parametrize("body", ["[" * 200_000, '{"step":' * 100_000, '{"step": ' + "[" * 12 + "]" * 12 + "}"])
def test_deep_json_is_refused(url, body):
    answer = requests.put(f"{url}/step", data=body, headers=JSON, timeout=SOON_S)
    assert answer.status_code == 400
    assert len(answer.text) < 1000


def test_a_refusal_repeats_only_part_of_what_was_wrong(url):
    names = ["x" * 100_000, *(f"y{i}" for i in range(10_000))]
    body = {"point_names": names, "horizon": 0, "interval": 1}
    answer = requests.put(f"{url}/forecast", json=body, timeout=SOON_S)
    assert answer.status_code == 400
    assert len(answer.text) < 1000


def test_two_advances_at_once_are_two_steps_one_after_the_other(url):
    testid = requests.post(f"{url}/testcases/{NAME}/select", timeout=SOON_S).json()["testid"]
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(lambda _: requests.post(f"{url}/advance/{testid}", timeout=SOON_S), range(2)))
    assert sorted(answer.json()["payload"]["time"] for answer in both) == [3600, 7200]
    requests.put(f"{url}/stop/{testid}", timeout=SOON_S)


def test_a_test_stopped_in_a_step_ends_the_step_and_is_gone(url, monkeypatch):
    begun, finish = threading.Event(), threading.Event()
    advance = EmbeddedPlant.advance_points

    def take_long(plant, *arguments):
        begun.set()
        finish.wait(SOON_S)
        return advance(plant, *arguments)

    testid = requests.post(f"{url}/testcases/{NAME}/select", timeout=SOON_S).json()["testid"]
    monkeypatch.setattr(EmbeddedPlant, "advance_points", take_long)
    with ThreadPoolExecutor(1) as pool:
        step = pool.submit(requests.post, f"{url}/advance/{testid}", timeout=SOON_S)
        assert begun.wait(SOON_S)
        assert requests.put(f"{url}/stop/{testid}", timeout=SOON_S).text == "OK"
        assert requests.put(f"{url}/stop/{testid}", timeout=SOON_S).status_code == 400
        finish.set()
        assert step.result().json()["payload"]["time"] == 3600
    assert "Invalid testid" in requests.post(f"{url}/advance/{testid}", timeout=SOON_S).text


def test_clients_that_do_not_read_their_answers_keep_no_one_out():
    """As many as there are threads, each with an answer longer than any buffer of the system."""
    long = b"x" * 30_000_000

    def app(environ, start_response):
        body = long if environ["PATH_INFO"] == "/long" else b"short"
        start_response("200 OK", [("Content-Length", str(len(body)))])
        return [body]

    server = serve_on(socket.create_server(("127.0.0.1", 0)), app, threads=2, most_bytes=1000)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    address = ("127.0.0.1", int(server.effective_port))
    deaf = []
    try:
        for _ in range(2):
            deaf.append(socket.create_connection(address, timeout=SOON_S))
            deaf[-1].sendall(b"GET /long HTTP/1.1\r\nHost: x\r\n\r\n")
        assert requests.get(f"http://127.0.0.1:{address[1]}/short", timeout=SOON_S).text == "short"
    finally:
        for connection in deaf:
            connection.close()
        server.close()
        thread.join(SOON_S)
