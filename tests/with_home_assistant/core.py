"""A real Home Assistant core on loopback: installed from PyPI, onboarded by its HTTP API, restarted and ended."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import requests
from websockets.sync.client import connect

VERSION = "2025.4.4"
FRONTEND = "20250411.0"  # that of this core: it does not start without, also where nobody looks at it
PAHO = "2.1.0"  # that of its integration mqtt
PORT = 18124
CONFIGURATION = """\
homeassistant: {name: Test, latitude: 52, longitude: 13, elevation: 30, unit_system: UNITS, time_zone: Europe/Berlin,
  currency: EUR, country: DE}
http: {server_host: 127.0.0.1, server_port: 18124}
api:
websocket_api:
history:
recorder: {commit_interval: 0}
onboarding:
input_number:
  room: {min: -40, max: 120, step: 0.001, initial: 20.5, mode: box}
  outdoor: {min: -40, max: 120, step: 0.001, initial: 3, mode: box}
  power: {min: 0, max: 10000, step: 0.01, initial: 0, mode: box}
  level: {min: 0, max: 1, step: 0.0001, initial: 0, mode: box}
  offset: {min: -3, max: 3, step: 0.5, initial: 0}
input_boolean: {heater: , there: {initial: true}, contact: , sg: }
input_select: {sg_ready: {options: [blocked, normal, recommended], initial: normal}}
timer: {tf_mpc: {restore: true}}
template:
  - sensor:
      - name: Room temperature
        unique_id: room
        state: "{{ states('input_number.room') }}"
        availability: "{{ is_state('input_boolean.there', 'on') }}"
        unit_of_measurement: "°C"
        device_class: temperature
        state_class: measurement
  - number:
      - name: Curve
        unique_id: curve
        state: "{{ states('input_number.offset') }}"
        availability: "{{ is_state('input_boolean.there', 'on') }}"
        min: -3
        max: 3
        step: 0.5
        set_value:
          - {action: input_number.set_value, target: {entity_id: input_number.offset}, data: {value: "{{ value }}"}}
      - name: Deaf
        unique_id: deaf
        state: "1"
        min: 0
        max: 5
        step: 0.5
        set_value: []
climate:
  - {platform: generic_thermostat, name: Hall, unique_id: hall, heater: input_boolean.heater,
     target_sensor: sensor.room_temperature, min_temp: LEAST, max_temp: MOST, target_temp: USUAL, target_temp_step: 0.5,
     precision: 0.1, initial_hvac_mode: heat}
automation:
  - alias: Give back what nobody sets any more
    triggers: [{trigger: event, event_type: timer.finished, event_data: {entity_id: timer.tf_mpc}}]
    actions: [{action: climate.set_temperature, target: {entity_id: climate.hall}, data: {temperature: USUAL}}]
"""

TEMPERATURES = {"LEAST": (10, 50), "MOST": (26, 79), "USUAL": (20, 68)}


def environment(folder: Path) -> Path:
    """The Python of an environment with the core in `folder`, installed once."""
    python = folder / "venv" / "bin" / "python"
    if not (folder / "venv" / "bin" / "hass").exists():
        base = os.environ.get("HA_PYTHON") or next(
            (str(p) for p in sorted(Path.home().glob(".pyenv/versions/3.13*/bin/python"))), shutil.which("python3.13")
        )
        if base is None:
            raise SystemExit("Home Assistant needs Python 3.13: name one by HA_PYTHON")
        packages = [f"homeassistant=={VERSION}", f"home-assistant-frontend=={FRONTEND}", f"paho-mqtt=={PAHO}"]
        subprocess.run([base, "-m", "venv", str(folder / "venv")], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "-q", *packages], check=True)
    return python


class Core:
    """A running core: `url`, `token`, and what can be done to it."""

    def __init__(self, folder: Path, units: str = "metric") -> None:
        self.url, self.folder, self.token = f"http://127.0.0.1:{PORT}", folder, ""
        self.config = folder / f"config-{units}"
        shutil.rmtree(self.config, ignore_errors=True)
        self.config.mkdir(parents=True)
        text = CONFIGURATION.replace("UNITS", units)
        for name, values in TEMPERATURES.items():
            text = text.replace(name, str(values[units == "us_customary"]))
        (self.config / "configuration.yaml").write_text(text)
        self._process: subprocess.Popen | None = None

    def start(self) -> None:
        hass = self.folder / "venv" / "bin" / "hass"
        log = (self.config / "out.log").open("a")
        words = [str(hass), "--config", str(self.config), "--skip-pip"]
        self._process = subprocess.Popen(words, stdout=log, stderr=log)
        for _ in range(240):
            try:
                answer = requests.get(f"{self.url}/api/", headers=self.headers, timeout=2)
                if answer.status_code in (200, 401) and (not self.token or self.running()):
                    return
            except (requests.RequestException, ValueError):
                pass
            time.sleep(0.5)
        raise SystemExit(f"the core did not start: {self.config}/out.log")

    def running(self) -> bool:
        return requests.get(f"{self.url}/api/config", headers=self.headers, timeout=2).json()["state"] == "RUNNING"

    def stop(self, how: int = signal.SIGTERM) -> None:
        assert self._process is not None
        self._process.send_signal(how)
        try:
            self._process.wait(40)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}

    def onboard(self) -> None:
        client = self.url + "/"
        user = {"client_id": client, "name": "t", "username": "t", "password": "not-a-secret-1", "language": "en"}
        code = requests.post(f"{self.url}/api/onboarding/users", json=user, timeout=20).json()["auth_code"]
        asked = {"grant_type": "authorization_code", "code": code, "client_id": client}
        access = requests.post(f"{self.url}/auth/token", data=asked, timeout=20).json()["access_token"]
        with connect(f"ws://127.0.0.1:{PORT}/api/websocket", proxy=None) as socket:
            socket.recv()
            socket.send(json.dumps({"type": "auth", "access_token": access}))
            socket.recv()
            said = {"id": 1, "type": "auth/long_lived_access_token", "client_name": "tests", "lifespan": 30}
            socket.send(json.dumps(said))
            self.token = json.loads(socket.recv())["result"]

    def call(self, service: str, **data) -> int:
        """Status of a service call, as somebody else makes it."""
        domain, name = service.split(".")
        url = f"{self.url}/api/services/{domain}/{name}"
        return requests.post(url, json=data, headers=self.headers, timeout=20).status_code

    def state(self, entity: str) -> dict:
        return requests.get(f"{self.url}/api/states/{entity}", headers=self.headers, timeout=20).json()


@contextmanager
def running_core(folder: Path, units: str = "metric"):
    environment(folder)
    core = Core(folder, units)
    core.start()
    try:
        core.onboard()
        for _ in range(100):
            if core.running():
                break
            time.sleep(0.2)
        yield core
    finally:
        core.stop()


if __name__ == "__main__":
    sys.exit("run tests/with_home_assistant/check.py")
