"""The service where clients are many, slow, silent or send nonsense: everyone else must still be answered."""

from __future__ import annotations

import socket
import threading
from concurrent.futures import ThreadPoolExecutor, as_completed

import pytest
import requests
from emulator_service import running_emulator_service
from waiting import LONG_S

from thermoforce_mpc.plants.embedded import EmbeddedPlant

NAME = "bestest_hydronic_heat_pump"
SOON_S = LONG_S


@pytest.fixture(scope="module")
def url():
    with running_emulator_service(most_tests=3) as address:
        yield address


@pytest.fixture
def testid(url):
    testid = select(url)
    yield testid
    requests.put(f"{url}/stop/{testid}", timeout=SOON_S)


def select(url: str) -> str:
    return requests.post(f"{url}/testcases/{NAME}/select", timeout=SOON_S).json()["testid"]


def clock(url: str, testid: str) -> float:
    """Where the record of a test ends, s."""
    body = {"point_names": ["reaTZon_y"], "start_time": 0, "final_time": 1e9}
    return requests.put(f"{url}/results/{testid}", json=body, timeout=SOON_S).json()["payload"]["time"][-1]


@pytest.mark.parametrize(
    ("method", "verb", "body"),
    [
        ("put", "step", {"step": 10**400}),
        ("put", "initialize", {"start_time": 10**400, "warmup_period": 0}),
        ("put", "initialize", {"start_time": 0, "warmup_period": -(10**400)}),
        ("post", "advance", {"oveHeaPumY_u": 10**400, "oveHeaPumY_activate": 1}),
        ("post", "advance", {"oveHeaPumY_u": 1, "oveHeaPumY_activate": 10**400}),
        ("put", "forecast", {"point_names": ["TDryBul"], "horizon": 10**400, "interval": 3600}),
        ("put", "results", {"point_names": ["reaTZon_y"], "start_time": 0, "final_time": 10**400}),
        ("put", "scenario", {"temperature_uncertainty": 10**400}),
    ],
)
def test_a_number_too_large_is_refused(url, testid, method, verb, body):
    answer = requests.request(method, f"{url}/{verb}/{testid}", json=body, timeout=SOON_S)
    assert answer.status_code == 400, answer.text
    assert answer.json()["message"]
    assert len(answer.text) < 1000
    assert clock(url, testid) == 0.0


MULTIPART = "multipart/form-data; boundary=cut"
PART = b'--cut\r\nContent-Disposition: form-data; name="oveHeaPumY_u"\r\n\r\n0.5\r\n'
FILE = b'--cut\r\nContent-Disposition: form-data; name="oveHeaPumY_u"; filename="u.txt"\r\n\r\n0.5\r\n'


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("multipart/form-data", PART + b"--cut--\r\n"),
        (MULTIPART, b"no part at all"),
        (MULTIPART, PART),
        (MULTIPART, PART[:30]),
        (MULTIPART, FILE + b"--cut--\r\n"),
        ("multipart/form-data; boundary=other", PART + b"--cut--\r\n"),
        ("application/x-www-form-urlencoded", b"&&&"),
        ("application/json", b'{"oveHeaPumY_u": 0.5'),
        ("application/json", b"\xff\xfe"),
    ],
    ids=["no boundary", "no part", "no end", "cut off", "a file", "another boundary", "no field", "half JSON", "bytes"],
)
def test_a_body_that_cannot_be_read_does_not_advance(url, testid, kind, body):
    answer = requests.post(f"{url}/advance/{testid}", data=body, headers={"Content-Type": kind}, timeout=SOON_S)
    assert answer.status_code == 400, answer.text
    assert "body" in answer.json()["message"]
    assert clock(url, testid) == 0.0


def test_a_whole_multipart_form_is_understood(url, testid):
    fields = {"oveHeaPumY_u": (None, "0.5"), "oveHeaPumY_activate": (None, "1")}
    answer = requests.post(f"{url}/advance/{testid}", files=fields, timeout=SOON_S)
    assert answer.json()["payload"]["oveHeaPumY_u"] == 0.5


@pytest.mark.parametrize(
    "sent",
    [b"", b"POST /advance HTTP/1.1\r\nContent-Le", b'PUT /step HTTP/1.1\r\nContent-Length: 99\r\n\r\n{"step":'],
    ids=["nothing", "half a request", "half a body"],
)
def test_connections_that_say_nothing_keep_no_one_out(url, sent):
    host, port = url.removeprefix("http://").split(":")
    silent = []
    try:
        for _ in range(250):
            silent.append(socket.create_connection((host, int(port)), timeout=SOON_S))
            silent[-1].sendall(sent)
        assert requests.get(f"{url}/version", timeout=SOON_S).ok
        with requests.Session() as client:
            testid = client.post(f"{url}/testcases/{NAME}/select", timeout=SOON_S).json()["testid"]
            assert client.post(f"{url}/advance/{testid}", timeout=SOON_S).ok
            assert client.put(f"{url}/stop/{testid}", timeout=SOON_S).ok
    finally:
        for connection in silent:
            connection.close()


@pytest.mark.slow
def test_steps_that_take_long_leave_the_others_their_answers(monkeypatch):
    """Every test but one simulates something long, and is asked once more meanwhile."""
    finish = threading.Event()
    begun = threading.Semaphore(0)
    advance = EmbeddedPlant.advance_points

    def take_long(plant, *arguments):
        begun.release()
        finish.wait(6 * SOON_S)
        return advance(plant, *arguments)

    most = 6
    with running_emulator_service(most_tests=most) as url, ThreadPoolExecutor(2 * most) as clients:
        tests = [select(url) for _ in range(most)]
        free, *busy = tests
        monkeypatch.setattr(EmbeddedPlant, "advance_points", take_long)
        try:
            steps = [clients.submit(ask, "post", f"{url}/advance/{testid}") for testid in busy]
            for _ in busy:
                assert begun.acquire(timeout=SOON_S)
            waiting = [clients.submit(ask, "get", f"{url}/kpi/{testid}") for testid in busy[1:]]
            assert requests.get(f"{url}/version", timeout=SOON_S).ok
            assert requests.get(f"{url}/measurements/{free}", timeout=SOON_S).ok
            for testid in busy:
                assert requests.get(f"{url}/status/{testid}", timeout=SOON_S).json() == "Running"
            # Who asks a busy test over and over is told so, but for one who waits.
            over_and_over = [clients.submit(ask, "get", f"{url}/step/{busy[0]}") for _ in range(3)]
            answered = as_completed(over_and_over, timeout=SOON_S)
            for status, said in (next(answered).result(), next(answered).result()):
                assert status == 429
                assert "busy" in said
            # A test that is stopped in the midst of a step still takes its part of the machine.
            assert requests.put(f"{url}/stop/{busy[-1]}", timeout=SOON_S).ok
            assert requests.post(f"{url}/testcases/{NAME}/select", timeout=SOON_S).status_code == 429
        finally:
            finish.set()
        assert {answer.result()[0] for answer in steps + waiting} == {200}
        assert sorted(answer.result()[0] for answer in over_and_over) == [200, 429, 429]
        assert ask("get", f"{url}/step/{busy[0]}")[0] == 200
        assert ask("post", f"{url}/testcases/{NAME}/select")[0] == 200


def ask(method: str, address: str) -> tuple[int, str]:
    """Status and text: an answer kept whole keeps its connection open."""
    answer = requests.request(method, address, timeout=6 * SOON_S)
    return answer.status_code, answer.text
