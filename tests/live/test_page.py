"""The page of a running controller: what it shows, what people ask by it, and who may."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import threading
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pandas as pd
import pytest
import requests
from browser import chromium
from click.testing import CliRunner
from simple_house import simple_model
from simulated_building import RULES, SimulatedBuilding, files_of_now, mpc
from waiting import LONG_S, wait_for

from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.live.control import in_words
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.live import LiveBuilding, People, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.live.shared import shared_with
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.report.live_view import LiveRun
from thermoforce_mpc.service.live_page import SUPERVISOR, PageAccess, live_app, page_server
from thermoforce_mpc.service.page_process import TOKEN, Page, PageSettings
from thermoforce_mpc.service.server import effective_port

SECRET = "kept-in-a-drawer-0123456789"
ZONE = "Europe/Berlin"
MAP = MeasurementMap.model_validate(RULES | {"time": {"zone": ZONE}})


def controlled(folder, house, steps, mode="control", told=lambda decision: None):
    if not (folder / "given").exists():
        simple_model().save(folder / "given")
    controller, people = mpc(), People(folder / "people.json", ZONE)
    journal = LiveJournal(folder, real_run(folder, folder / "given", Path("home.yaml"), MAP, controller.config, "x"))
    building = LiveBuilding(house, MAP, 3600.0, people=people)
    shown = shared_with(house, people, told, in_words, folder, mode)
    control(building, controller, clock=house, steps=steps, journal=journal, told=shown, sets=str(folder))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    there = tmp_path_factory.mktemp("control")
    controlled(there, SimulatedBuilding(), 3)
    return there


@contextmanager
def paged(folder, listen="127.0.0.1:0", **more):
    """The address of the page of a folder, in its process."""
    said = []
    with closing(Page(PageSettings.of(listen, folder, ZONE, **more), said.append)) as page:
        wait_for("the page", lambda: said)
        yield said[0].removeprefix("Page: "), page


class Hears:
    """Hears what is asked, and refuses the key `away`."""

    def __init__(self):
        self.heard = []

    def shown(self):
        return {"asks": ["boost"]}

    def ask(self, key, text):
        if key == "away":
            raise ConfigError("away 'soon': no time")
        self.heard.append((key, text))


def client(access=None, hears=None, peer="127.0.0.1"):
    app = live_app(lambda: {"status": "solved"}, hears, access).test_client()
    app.environ_base["REMOTE_ADDR"] = peer
    return app


def test_what_people_ask_is_heard_or_refused_with_its_reason():
    hears = Hears()
    page = client(hears=hears)
    answer = page.post("/ask", json={"key": "boost", "text": "60"})
    assert (answer.status_code, answer.json) == (200, {"people": {"asks": ["boost"]}})
    assert hears.heard == [("boost", "60")]
    refused = page.post("/ask", json={"key": "away", "text": "soon"})
    assert (refused.status_code, refused.json) == (400, {"error": "away 'soon': no time"})
    assert client().post("/ask", json={"key": "boost", "text": "60"}).status_code == 404, "of `watch`: it only shows"


ASKED = {"key": "boost", "text": "60"}


@pytest.mark.parametrize(
    ("status", "request_of"),
    [
        (415, {"data": json.dumps(ASKED), "content_type": "text/plain"}),  # a form of another site sends these without
        (415, {"data": ASKED}),  # asking first
        (400, {"data": "{", "content_type": "application/json"}),
        (400, {"data": "[" * 9_000, "content_type": "application/json"}),
        (400, {"json": {"key": "boost"}}),
        (400, {"json": {"key": "boost", "text": 60}}),
        (400, {"json": [1]}),
        (413, {"json": {"key": "boost", "text": "6" * 20_000}}),
        (403, {"json": ASKED, "headers": {"Host": "evil.example"}}),
        (403, {"json": ASKED, "headers": {"Origin": "http://evil.example"}}),
        (403, {"json": ASKED, "headers": {"Origin": "null"}}),
        (403, {"json": ASKED, "headers": {"Sec-Fetch-Site": "cross-site"}}),
        (403, {"json": ASKED, "headers": {"Sec-Fetch-Site": "same-site"}}),
    ],
)  # fmt: skip
def test_what_other_pages_send_asks_for_nothing(status, request_of):
    hears = Hears()
    assert client(hears=hears).post("/ask", **request_of).status_code == status
    assert hears.heard == []


def test_a_name_that_is_not_known_is_said_with_the_option_that_adds_it():
    asked = {"headers": {"Host": "evil.example"}}
    assert "start it with --page-name" in client(PageAccess(option="--page-name")).get("/view.json", **asked).text
    assert "start it" not in client().get("/view.json", **asked).text, "`watch` has none"


def test_a_login_is_needed_for_all_that_tells_of_the_building():
    hears = Hears()
    page = client(PageAccess(SECRET), hears)
    assert page.get("/").status_code == 200, "the page itself holds nothing"
    assert SECRET not in page.get("/").text
    assert page.get("/view.json").status_code == 401
    assert page.post("/ask", json=ASKED).status_code == 401
    assert page.post("/login", json={"token": SECRET[:-1]}).status_code == 401
    assert page.get("/view.json").status_code == 401
    done = page.post("/login", json={"token": SECRET})
    cookie = done.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert SECRET not in cookie
    assert page.get("/view.json").json["status"] == "solved"
    assert page.post("/ask", json=ASKED).status_code == 200
    # Another token later: who logged in with the one before is not known any more.
    other = client(PageAccess(f"{SECRET}-2"), hears)
    other.set_cookie("tf-mpc", page.get_cookie("tf-mpc").value)
    assert other.get("/view.json").status_code == 401


@pytest.mark.parametrize("shown", ["", ".", "1.x", "99999999999.", f"{10**20}.x", "١٢٣.x", "99999999999.ümlaut"])
def test_a_cookie_that_nobody_signed_shows_nothing(shown):
    page = client(PageAccess(SECRET))
    page.set_cookie("tf-mpc", shown)
    assert page.get("/view.json").status_code == 401


def test_scripts_send_the_token_itself():
    page = client(PageAccess(SECRET))
    assert page.get("/view.json", headers={"Authorization": f"Bearer {SECRET}"}).status_code == 200
    assert page.get("/view.json", headers={"Authorization": f"Basic {SECRET}"}).status_code == 401


def test_guesses_of_the_token_are_slowed_down():
    page = client(PageAccess(SECRET))
    said = [page.post("/login", json={"token": str(n)}).status_code for n in range(6)]
    assert said[0] == 401
    assert 429 in said


def test_behind_ingress_nobody_but_home_assistant_asks():
    access = PageAccess(ingress=True)
    home = {"Host": "homeassistant.local:8123", "X-Ingress-Path": "/api/hassio_ingress/abc"}
    hears = Hears()
    page = client(access, hears, SUPERVISOR)
    assert page.get("/view.json", headers=home).status_code == 200
    assert (
        page.post("/ask", json=ASKED, headers=home | {"Origin": "http://homeassistant.local:8123"}).status_code == 200
    )
    assert page.post("/ask", json=ASKED, headers=home | {"Origin": "http://evil.example"}).status_code == 403
    assert "frame-ancestors 'self'" in page.get("/", headers=home).headers["Content-Security-Policy"]
    for peer in ("172.30.33.5", "192.168.0.7", "::ffff:172.30.32.2"):
        assert client(access, hears, peer).get("/", headers=home).status_code == 403
    assert "frame-ancestors 'none'" in client().get("/").headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    ("listen", "says"),
    [
        ("0.0.0.0:8010", f"can be reached from other machines.*{TOKEN}"),
        ("192.168.0.2:8010", "can be reached from other machines"),
        (":8010", "expected HOST:PORT"),
        ("8010", "expected HOST:PORT"),
        ("127.0.0.1", "expected HOST:PORT"),
        ("127.0.0.1:web", "expected HOST:PORT"),
        ("127.0.0.1:70000", "expected HOST:PORT"),
        ("ingress:x", "expected HOST:PORT"),
    ],
)
def test_where_the_page_may_be(listen, says, tmp_path, monkeypatch):
    monkeypatch.delenv(TOKEN, raising=False)
    with pytest.raises(ConfigError, match=says):
        PageSettings.of(listen, tmp_path, None)


def test_the_token_comes_from_the_environment_or_a_file_of_ones_own(tmp_path, monkeypatch):
    monkeypatch.setenv(TOKEN, "short")
    with pytest.raises(ConfigError, match="16 or more"):
        PageSettings.of("0.0.0.0:0", tmp_path, None)
    monkeypatch.delenv(TOKEN)
    file = tmp_path / "token"
    file.write_text(SECRET)
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600") as refused:
        PageSettings.of("0.0.0.0:0", tmp_path, None, file)
    assert SECRET not in str(refused.value)
    file.chmod(0o600)
    assert PageSettings.of("0.0.0.0:0", tmp_path, None, file).token == SECRET
    assert PageSettings.of("[::1]:8010", tmp_path, None).host == "::1"
    assert PageSettings.of("ingress", tmp_path, None).port == 8099


def test_the_command_refuses_an_open_page_before_anything_begins(tmp_path, monkeypatch):
    monkeypatch.delenv(TOKEN, raising=False)
    monkeypatch.chdir(tmp_path)
    files_of_now(tmp_path)
    words = ["control", "--model", "model", "--map", "map.yaml", "--out", "out"]
    refused = CliRunner().invoke(cli, [*words, "--page", "0.0.0.0:8010"])
    assert isinstance(refused.exception, ConfigError)
    assert not (tmp_path / "out").exists()
    assert "--page HOST:PORT, which is missing" in str(CliRunner().invoke(cli, [*words, "--page-name", "x"]).exception)


def asked(url, key, text):
    return requests.post(f"{url}ask", json={"key": key, "text": text}, timeout=LONG_S)


@pytest.mark.slow
def test_the_page_is_a_process_of_its_own_that_is_started_again(folder, monkeypatch):
    monkeypatch.setenv("MQTT_PASSWORD", SECRET)
    with paged(folder) as (url, page):
        view = requests.get(f"{url}view.json", timeout=LONG_S).json()
        assert (view["testcase"], view["zone"], view["mode"]) == ("home", ZONE, "control")
        assert view["people"]["asks"] == ["lower", "upper", "away", "boost", "mode"]
        assert view["saving"].startswith("not known yet")
        assert SECRET.encode() not in Path(f"/proc/{page.pid}/environ").read_bytes()
        assert asked(url, "away", "2020-01-01").status_code == 400
        assert asked(url, "mode", "advise").json()["people"]["mode"] == "advise"
        assert asked(url, "boost", "60").json()["people"]["boost_min"] == 60
        people = People(folder / "people.json")
        assert people.paused
        assert people.shown(pd.Timestamp.now("UTC"))["boost_min"] == 60
        os.kill(first := page.pid, signal.SIGKILL)
        wait_for("another process", lambda: page.pid not in (None, first))
    with pytest.raises(requests.ConnectionError):
        requests.get(url, timeout=LONG_S)
    (folder / "people.json").unlink()


@pytest.mark.slow
def test_a_controller_without_a_decision_yet_and_one_that_sets_nothing(tmp_path):
    with paged(tmp_path) as (url, _):
        answer = requests.get(f"{url}view.json", timeout=LONG_S)
        assert answer.status_code == 500
        assert "nothing is decided yet" in answer.json()["error"]
        assert asked(url, "boost", "60").status_code == 400, "nobody hears it"
        controlled(tmp_path, SimulatedBuilding(), 1, "shadow")
        people = requests.get(f"{url}view.json", timeout=LONG_S).json()["people"]
        assert (people["mode"], people["asks"]) == ("shadow", ["lower", "upper", "away", "boost"])
        assert asked(url, "mode", "control").status_code == 400


@pytest.mark.slow
def test_a_controller_that_stands_is_said_and_files_of_other_types_are_not_shown(folder, tmp_path):
    there = tmp_path / "stands"
    shutil.copytree(folder, there)
    *lines, last = (there / "journal.jsonl").read_text().splitlines(keepends=True)
    assert '"ended"' in last
    (there / "journal.jsonl").write_text("".join(lines))
    with paged(there) as (url, _):
        for told in ({"asks": 5, "plan": {"commands": [1]}}, [1], {"plan": [], "mode": {}}):
            (there / "now.json").write_text(json.dumps(told))
            answer = requests.get(f"{url}view.json", timeout=LONG_S)
            assert (answer.status_code, answer.json()["commands"], answer.json()["people"]["asks"]) == (200, [], [])
            assert answer.json()["late"].startswith("nothing was decided for ")


@pytest.mark.slow
def test_a_page_that_cannot_be_served_stops_no_control(tmp_path, caplog):
    """Its port is taken, and the folder is removed meanwhile from under it."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = PageSettings.of(f"127.0.0.1:{taken.getsockname()[1]}", tmp_path, ZONE)
        with closing(Page(settings)):
            house, decisions = SimulatedBuilding(), []
            controlled(tmp_path, house, 3, told=decisions.append)
            wait_for("why", lambda: "the page ended" in caplog.text)
    assert "another port in --page" in caplog.text
    assert len(decisions) == 3
    assert house.written


@contextmanager
def ingress(url):
    """Home Assistant's way to the page: below a path of its own, under its own name."""
    prefix = "/api/hassio_ingress/token/"

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self._pass_on(None)

        def do_POST(self):
            self._pass_on(self.rfile.read(int(self.headers["Content-Length"])))

        def _pass_on(self, body):
            if not self.path.startswith(prefix):
                self.send_error(404)
                return
            headers = dict(self.headers) | {"X-Ingress-Path": prefix[:-1]}
            there = requests.request(
                self.command, url + self.path.removeprefix(prefix), headers=headers, data=body, timeout=LONG_S
            )
            self.send_response(there.status_code)
            for name in ("Content-Type", "Content-Security-Policy"):
                self.send_header(name, there.headers[name])
            self.send_header("Content-Length", str(len(there.content)))
            self.end_headers()
            self.wfile.write(there.content)

        def log_message(self, *words):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}{prefix}"
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def looked_at(browser, url, scheme="light", width=375):
    page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    page.set_default_timeout(1e3 * LONG_S)
    wrong = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text))
    page.goto(url)
    yield page
    page.close()
    assert [text for text in wrong if "status of 40" not in text] == [], "but for what was refused"


@pytest.mark.slow
def test_on_a_phone_it_shows_and_asks(folder, monkeypatch):
    with chromium() as browser:
        with paged(folder) as (url, _), looked_at(browser, url) as page:
            page.wait_for_selector("svg path")
            assert page.evaluate("document.documentElement.scrollWidth") <= 375
            assert page.locator("button:visible").evaluate_all("all => Math.min(...all.map(b => b.offsetHeight))") >= 44
            assert "°C" in page.inner_text("#tiles")
            assert "comfort 20 to 24 °C" in page.inner_text("#tiles")
            assert " %" in page.inner_text("#commands")
            assert "Sun 12" not in page.inner_text("#commands"), "its hours are those of the house, not of UTC"
            page.click("text=1 h")
            page.wait_for_selector("text=boost 60: counts")
            assert "60 min left" in page.inner_text("#people")
            page.fill("#until", "2020-01-01T10:00")
            page.click("[data-from=until]")
            page.wait_for_selector("#answer.bad")
            assert "a time in the next year" in page.inner_text("#answer")
            page.fill("#lower", "21.5")
            page.click("[data-from=lower]")
            page.wait_for_selector("text=at least 21.5 °C until")
            page.click("text=advise only")
            page.wait_for_selector("text=the building's own control acts")
        people = People(folder / "people.json")
        assert people.paused
        assert people.wishes().lower_C == 21.5
        (folder / "people.json").unlink()
        monkeypatch.setenv(TOKEN, SECRET)
        with (
            paged(folder, "0.0.0.0:0") as (url, _),
            looked_at(browser, url.replace("0.0.0.0", "127.1"), "dark") as page,
        ):
            page.wait_for_selector("#login:not([hidden])")
            assert page.locator("#tiles").is_hidden()
            page.fill("#token", "wrong")
            page.click("text=Log in")
            page.wait_for_selector("text=needs the header")
            page.fill("#token", SECRET)
            page.click("text=Log in")
            page.wait_for_selector("svg path")
            assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
        monkeypatch.delenv(TOKEN)
        with paged(folder) as (url, _), ingress(url) as home, looked_at(browser, home) as page:
            page.wait_for_selector("svg path")
            page.click("text=2 h")
            page.wait_for_selector("text=boost 120: counts")
        (folder / "people.json").unlink()


@pytest.mark.slow
def test_it_shows_a_tank_of_hot_water(folder):
    view = LiveRun(folder).now()
    ends = [point.time_s for point in view.plan]
    points = [{"time_s": at, "T_C": 45.0 + k, "low_C": 43.0, "lower_C": 42.0} for k, at in enumerate(ends)]
    now = {"time_s": view.time_s, "T_C": 46.7, "low_C": None, "lower_C": None}
    tank = {"T_C": 46.7, "told": 48.0, "said": "Hot water: 46.7 °C now", "past": [now], "plan": points}
    server = page_server(lambda: view.to_json() | {"hot_water": tank}, 0)
    threading.Thread(target=server.run, daemon=True).start()
    with (
        closing(server),
        chromium() as browser,
        looked_at(browser, f"http://127.0.0.1:{effective_port(server)}/") as page,
    ):
        page.wait_for_selector("text=hot water, °C")
        assert "46.7 °C" in page.inner_text("#tiles")
        assert "set to 48" in page.inner_text("#tiles")
        assert page.inner_text("#tank") == "Hot water: 46.7 °C now"
        drawn = page.locator("section:has(h2:text('hot water')) path").evaluate_all(
            "all => all.map(one => one.getAttribute('d'))"
        )
        assert sum(d.count("L") for d in drawn) >= len(ends) - 1
        assert not any("NaN" in d for d in drawn)
