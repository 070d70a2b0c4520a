"""The connection against a real Home Assistant core: every case of `home_assistant_cases`, a restart, its watchdog.

    python tests/with_home_assistant/check.py [--folder /tmp/ha] [--record]

Needs Python 3.13 beside ours (pyenv, or HA_PYTHON) and PyPI, the first time; then about three minutes. With --record
the requests and answers are written to tests/connections/home_assistant.json, which the quick tests serve.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support" / "services"), str(Path(__file__).parent)]

import pytest  # noqa: E402
import requests  # noqa: E402
import websockets.sync.client as client  # noqa: E402
from core import VERSION, running_core  # noqa: E402
from home_assistant_cases import CASES, HALL, live_act  # noqa: E402
from recorded_core import Recorder  # noqa: E402

from benchmarks.chaos.mosquitto import PASSWORD, USER, Broker  # noqa: E402
from thermoforce_mpc.connections.registry import build_connection  # noqa: E402
from thermoforce_mpc.errors import PlantError  # noqa: E402

KEYS = ("lower", "upper", "away", "boost")
CONTRACT = ROOT / "tests" / "connections" / "home_assistant.json"


def connector(core, recorder=None):
    def connect(*, columns=(), token=None, **options):
        os.environ["HOME_ASSISTANT_TOKEN"] = token or core.token
        home = build_connection("home-assistant", {"url": core.url, **options})
        home.reads(columns)
        return home

    return connect


def recording(recorder: Recorder, token: str) -> None:
    """Have everything that a connection asks and hears kept."""
    request = requests.Session.request

    def kept(self, method, url, **words):
        answer = request(self, method, url, **words)
        if words.get("headers", {}).get("Authorization") == f"Bearer {token}":
            path = "/" + url.split("/", 3)[3]
            recorder.rest(method, path, words.get("json"), answer.status_code, answer.text)
        return answer

    requests.Session.request = kept
    open_socket = client.connect

    class Kept:
        def __init__(self, *words, **more):
            self._opening, self._asked = open_socket(*words, **more), {}

        def __enter__(self):
            self._socket = self._opening.__enter__()
            return self

        def __exit__(self, *words):
            return self._opening.__exit__(*words)

        def send(self, text):
            message = json.loads(text)
            self._asked[message.get("id")] = message
            self._socket.send(text)

        def recv(self, timeout=None):
            text = self._socket.recv(timeout=timeout)
            answer = json.loads(text)
            if answer.get("id") is not None:
                recorder.socket(self._asked[answer["id"]], answer)
            return text

    client.connect = Kept


def restarts(core) -> None:
    """While the core is away nothing can be read or set; then the states are read anew."""
    home = connector(core)(actuators=HALL, columns=["sensor.room_temperature", "climate.hall.temperature"], days=1.0)
    home.write({"hall": 22.5}, 900.0)
    before = home.measurements()
    core.stop(signal.SIGKILL)
    for ask in (home.measurements, lambda: home.write({"hall": 21.0}, 900.0)):
        with pytest.raises(PlantError, match=r"cannot be reached|refuses the connection"):
            ask()
    core.start()
    time.sleep(2.0)
    after = home.measurements()
    assert len(after) >= len(before)
    home.write({"hall": 21.0}, 900.0)
    assert core.state("climate.hall")["attributes"]["temperature"] == 21.0
    home.write({"hall": None}, 0.0)


def is_given_back_by_the_timer(core) -> None:
    """Whoever sets is gone: the automation at the end of the timer gives the set-point back."""
    home = connector(core)(actuators=HALL, watchdog="timer.tf_mpc")
    home.write({"hall": 23.0}, 3.0)
    time.sleep(1.0)
    assert core.state("climate.hall")["attributes"]["temperature"] == 23.0
    time.sleep(4.0)
    assert core.state("climate.hall")["attributes"]["temperature"] == 20.0


def finds_one_device_by_mqtt(core) -> None:
    """By a real broker: the device with its entities; what people ask is heard; it is unavailable when we end."""
    with tempfile.TemporaryDirectory() as folder:
        broker = Broker(Path(folder))
        broker.start()
        try:
            flows = f"{core.url}/api/config/config_entries/flow"
            flow = requests.post(flows, json={"handler": "mqtt"}, headers=core.headers, timeout=30).json()
            data = {"broker": "127.0.0.1", "port": broker.port, "username": USER, "password": PASSWORD}
            done = requests.post(f"{flows}/{flow['flow_id']}", json=data, headers=core.headers, timeout=60).json()
            assert done["type"] == "create_entry", done
            asked = []
            home = build_connection("mqtt", broker.options(record=str(Path(folder) / "mqtt.csv"), prefix="house"))
            home.listen({key: lambda text, key=key: asked.append((key, text)) for key in KEYS})
            home.tell({"status": "solved", "why": "cheap hours first " * 30, "level": "hall 21 °C for 60 min"})
            home.tell({"saving": {"said": "not known yet", "kWh": 0.0}})
            home.tell({"plan": {"next": "hall 21 °C", "steps": []}})
            people = {"lower_C": None, "upper_C": 23.5, "planned_lower_C": 20.0, "planned_upper_C": 23.0}
            home.tell({"people": people | {"away": False, "boost_min": 30}})
            home.begin()
            for _ in range(100):
                found = {
                    s["entity_id"]: s
                    for s in requests.get(f"{core.url}/api/states", headers=core.headers, timeout=10).json()
                    if "thermoforce" in s["entity_id"]
                }
                if len(found) == 8 and all(one["state"] not in ("unknown", "unavailable") for one in found.values()):
                    break
                time.sleep(0.2)
            by_kind = {name.partition("_mpc_")[2]: one for name, one in found.items()}
            assert set(by_kind) == {"status", "why", "set_now", "plan", "saving", "comfort", "boost", "away"}
            assert by_kind["status"]["state"] == "solved"
            assert by_kind["why"]["state"].startswith("cheap hours first")
            assert by_kind["plan"]["state"] == "hall 21 °C"
            assert float(by_kind["boost"]["state"]) == 30.0
            comfort = by_kind["comfort"]["attributes"]
            assert (comfort["target_temp_low"], comfort["target_temp_high"]) == (20.0, 23.5)
            core.call("climate.set_temperature", entity_id="climate.thermoforce_mpc_comfort",
                      target_temp_low=20.5, target_temp_high=24.0)  # fmt: skip
            core.call("switch.turn_on", entity_id="switch.thermoforce_mpc_away")
            core.call("number.set_value", entity_id="number.thermoforce_mpc_boost", value=60)
            time.sleep(1.0)
            assert sorted(asked) == [("away", "ON"), ("boost", "60"), ("lower", "20.5"), ("upper", "24.0")], asked
            home.close()
            time.sleep(1.0)
            assert core.state("sensor.thermoforce_mpc_status")["state"] == "unavailable"
        finally:
            broker.stop()


def speaks_fahrenheit(core) -> None:
    """In a house of °F set-points are converted, and what is given back is as the entity has it."""
    hall = {"hall": {"entity": "climate.hall", "release": 68.0}}
    home = connector(core)(actuators=hall)
    core.call("input_number.set_value", entity_id="input_number.room", value=20.0)
    home.write({"hall": 21.0}, 900.0)
    held = core.state("climate.hall")["attributes"]["temperature"]
    assert abs(held - 69.8) <= 0.5, held
    home.write({"hall": None}, 0.0)
    assert core.state("climate.hall")["attributes"]["temperature"] == 68.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/ha"))
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--only", help="one case")
    options = parser.parse_args()
    recorder, contract, failed = Recorder(), {}, 0
    with running_core(options.folder) as core:
        act = live_act(core)
        if options.record:
            recording(recorder, core.token)
        for case in [one for one in CASES if options.only in (None, one.__name__)]:
            recorder.exchanges, heard = [], []

            def recorded(kind, *words, heard=heard, **data):
                said = act(kind, *words, **data)
                heard.append(said)
                return said

            ended = "ok"
            try:
                case(connector(core), recorded)
            except (Exception, pytest.fail.Exception) as error:  # whatever it is, the others are tried
                traceback.print_exc()
                failed, ended = failed + 1, f"FAILED: {type(error).__name__}: {error}"
            print(f"{case.__name__}: {ended}", flush=True)
            contract[case.__name__] = {"exchanges": recorder.exchanges, "acts": heard}
        for case in (is_given_back_by_the_timer, restarts, finds_one_device_by_mqtt):
            case(core)
            print(f"{case.__name__}: ok", flush=True)
    with running_core(options.folder, "us_customary") as core:
        speaks_fahrenheit(core)
        print("speaks_fahrenheit: ok", flush=True)
    if options.record and not failed:
        text = json.dumps({"core": VERSION, "cases": contract}, indent=0, sort_keys=True)
        CONTRACT.write_text(text.replace(core.token, "TOKEN") + "\n")
        print(f"wrote {CONTRACT}")
    print(f"{len(CASES) + 4 - failed} passed, {failed} failed")
    raise SystemExit(bool(failed))


if __name__ == "__main__":
    main()
