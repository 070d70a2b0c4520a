"""What a page in a browser may do at a service on the same machine: nothing, unless it is the service's own."""

from __future__ import annotations

import pytest
import requests
from emulator_service import running_emulator_service
from waiting import LONG_S
from werkzeug.datastructures import Headers

from thermoforce_mpc.service.access import HostNames, Refusal

NAME = "bestest_hydronic_heat_pump"
SELECT = f"testcases/{NAME}/select"


@pytest.fixture(scope="module")
def url():
    with running_emulator_service(most_tests=3, names=("boptest.example",)) as address:
        yield address


def ask(url, method, path, headers, **content):
    return requests.request(method, f"{url}/{path}", headers=headers, timeout=LONG_S, **content)


def startable(url):
    """How many tests may still be started; those started here are stopped."""
    started = []
    while (answer := requests.post(f"{url}/{SELECT}", timeout=LONG_S)).ok:
        started.append(answer.json()["testid"])
    for testid in started:
        requests.put(f"{url}/stop/{testid}", timeout=LONG_S)
    return len(started)


@pytest.mark.slow
@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:3000", "Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site"},  # an image, which states no origin
        {"Host": "evil.example", "Origin": "http://evil.example"},  # its name was made to lead here
        {"Host": "evil.example"},
        {"Host": "localhost.evil.example:8000"},
        {"Host": "[evil"},
    ],
)
@pytest.mark.parametrize(("method", "path"), [("POST", SELECT), ("POST", "advance"), ("GET", "name")])
def test_a_page_of_elsewhere_starts_no_test_and_learns_nothing(url, headers, method, path):
    answer = ask(url, method, path, headers, data={"oveHeaPumY_u": "1"} if method == "POST" else None)
    assert answer.status_code == 403
    assert answer.json()["payload"] is None
    assert "Access-Control-Allow-Origin" not in answer.headers
    assert startable(url) == 3


@pytest.mark.parametrize(
    "host", ["localhost", "127.0.0.1:8000", "192.168.0.2:80", "[::1]:8000", "boptest.example", "BOPTEST.example:80"]
)
def test_an_address_and_a_name_of_the_service_are_asked(url, host):
    assert ask(url, "GET", "version", {"Host": host}).ok
    own = {"Host": host, "Origin": f"https://{host}", "Sec-Fetch-Site": "same-origin"}
    assert ask(url, "GET", "version", own).ok


@pytest.mark.parametrize("headers", [{"Origin": "http://[evil"}, {"Origin": "http://a", "Host": ""}])
def test_a_broken_origin_is_one_of_elsewhere(headers):
    with pytest.raises(Refusal, match="another site"):
        HostNames().check(Headers(headers))


@pytest.mark.parametrize("kind", ["text/plain", "", "application/xml", "application/json-seq"])
def test_a_body_of_another_type_is_none_as_at_the_real_service_and_a_page_of_elsewhere_sends_none(url, kind, caplog):
    testid = ask(url, "POST", SELECT, {"Content-Type": kind}, data=b"{}").json()["testid"]
    assert ask(url, "PUT", f"step/{testid}", {"Content-Type": kind}, data=b'{"step": 60}').status_code == 400
    full = b'{"oveHeaPumY_u": 1, "oveHeaPumY_activate": 1}'
    answer = ask(url, "POST", f"advance/{testid}", {"Content-Type": kind}, data=full)
    assert answer.json()["payload"]["oveHeaPumY_activate"] == 0
    assert "is ignored; send application/json" in caplog.text
    page = {"Content-Type": kind, "Origin": "http://evil.example"}
    assert ask(url, "POST", f"advance/{testid}", page, data=full).status_code == 403
    requests.put(f"{url}/stop/{testid}", timeout=LONG_S)


@pytest.mark.slow
def test_no_address_starts_more_than_its_share():
    with running_emulator_service(most_tests=3, tests_each=2) as url:
        first, _ = (requests.post(f"{url}/{SELECT}", timeout=LONG_S).json()["testid"] for _ in range(2))
        refused = requests.post(f"{url}/{SELECT}", timeout=LONG_S)
        assert refused.status_code == 429
        assert "127.0.0.1 runs 2 tests" in refused.json()["message"]
        assert requests.get(f"{url}/name", timeout=LONG_S).status_code == 429, "the test of clients without test ids"
        requests.put(f"{url}/stop/{first}", timeout=LONG_S)
        assert requests.post(f"{url}/{SELECT}", timeout=LONG_S).ok


@pytest.mark.slow
def test_where_other_machines_can_ask_one_address_has_half():
    token = "kept-in-a-drawer-0123456789"
    with running_emulator_service(most_tests=3, token=token, host="0.0.0.0") as url:
        asked = [ask(url, "POST", SELECT, {"Authorization": f"Bearer {token}"}).status_code for _ in range(3)]
    assert asked == [200, 200, 429]
