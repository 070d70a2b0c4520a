"""Files to start a real building from, with comments: connection, map, and what gives the building back without us."""

from __future__ import annotations

_MAP = """\
# Which signal is what, in which unit: docs/reference/map.md. Replace the names; `tf-mpc validate map.yaml`
# checks the rest.
time: {{zone: Europe/Berlin}}        # of schedules and of stamps without an offset
step: 15min
{table}outdoor: {outdoor}
zones:
  hall:
    temperature: {temperature}
    floor_area_m2: 100
comfort: "weekdays 6:00-22:00 20.5-23, else 19-24"   # °C; holidays: [2026-12-25] counts them as Sundays
actuators:
  heat_pump:
    level: {level}
    command:
      kind: setpoint
      column: {setpoint}
      resolution: 0.5
      minimum: 17
      maximum: 24
      hold_min: 30
machines:
  heat_pump: {{power: {power}}}      # W; unit: kW, or Wh counter, …
# Columns of the forecast that connection.yaml asks for:
forecast: {{outdoor: temperature_C, sun: solar_W_m2, price: price_per_kWh}}
"""
_FORECAST = """\
  forecast:                            # nobody is asked but who is named here: docs/how-to/forecasts.md
    weather: {name: open-meteo, options: {latitude: 52.5, longitude: 13.4}}
    prices: {name: awattar, factor: 1.19, add_per_kWh: 0.15}   # or a price in the map
"""
_HOME_ASSISTANT = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections home-assistant`.
# The token (profile page, long-lived access token) stands in HOME_ASSISTANT_TOKEN, or in a file of mode 600:
name: home-assistant
options:
  url: http://homeassistant.local:8123   # in an add-on http://supervisor/core
  # token_file: token
  watchdog: timer.tf_mpc                 # of package.yaml: gives the house back when nothing comes any more
  actuators:                             # names as in map.yaml
    heat_pump: {entity: climate.hall, release: 20}   # release: set-point when it is given back
    # curve: {entity: number.curve_offset, release: 0}
    # pump: {entity: select.sg_ready, release: normal, options: {1: blocked, 2: normal, 3: recommended}}
"""
_PACKAGE = """\
# For Home Assistant: /config/packages/tf_mpc.yaml, with `homeassistant: {packages: !include_dir_named packages}`.
# Each command starts the timer anew, for as long as it holds. Where none comes any more (this program, its machine or
# the network is gone) the timer ends, and the automation gives the house back; the same after a restart.
timer:
  tf_mpc: {restore: true}
automation:
  - alias: Give the heating back
    triggers:
      - {trigger: event, event_type: timer.finished, event_data: {entity_id: timer.tf_mpc}}
    actions:
      - {action: climate.set_temperature, target: {entity_id: climate.hall}, data: {temperature: 20}}
"""
_MQTT = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections mqtt`.
# The password stands in MQTT_PASSWORD, or in a file of mode 600:
name: mqtt
options:
  host: localhost
  user: house
  # password_file: password
  # tls: true                            # and ca_file, where the broker's certificate is of an authority of your own
  version: "5"                           # or "3.1.1", without expiry of commands
  record: mqtt.csv                       # what comes is appended: `tf-mpc record` begins it some weeks before
  actuators:                             # names as in map.yaml
    heat_pump:
      topic: zigbee2mqtt/hall/set
      payload: '{"occupied_heating_setpoint": $value}'
      release: 20                        # set-point when it is given back
      state: zigbee2mqtt/hall#occupied_heating_setpoint   # what the device says that it took
"""
_FILES = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections files`.
name: files
options:
  measurements: house.csv                # which something appends to; or a pattern, as data/*.csv
  levels: levels.json                    # which something sets the machine by; null or past `until`: its own control
"""
_NAMES = {
    "home-assistant": {
        "table": "", "outdoor": "sensor.outdoor_temperature", "temperature": "climate.hall.current_temperature",
        "level": '{column: sensor.heat_pump_speed, unit: "%"}', "setpoint": "climate.hall.temperature",
        "power": "sensor.heat_pump_power",
    },
    "mqtt": {
        "table": "table: {point: topic, value: value}   # of mqtt.csv\n", "outdoor": "weather/outdoor",
        "temperature": '"zigbee2mqtt/hall#local_temperature"', "level": "heatpump/level",
        "setpoint": '"zigbee2mqtt/hall#occupied_heating_setpoint"', "power": "heatpump/power",
    },
    "files": {
        "table": "", "outdoor": "outdoor_C", "temperature": "hall_C", "level": "heat_pump_level",
        "setpoint": "hall_setpoint_C", "power": "heat_pump_W",
    },
}  # fmt: skip
_SERVICE = """\
# For systemd: copy it to /etc/systemd/system/tf-mpc.service, then `systemctl enable --now tf-mpc`.
# A secret stands in /etc/tf-mpc.env (mode 600), as HOME_ASSISTANT_TOKEN=… or MQTT_PASSWORD=…
[Unit]
Description=ThermoForce MPC
Wants=network-online.target
After=network-online.target time-sync.target

[Service]
User=tf-mpc
WorkingDirectory=/var/lib/tf-mpc
StateDirectory=tf-mpc
EnvironmentFile=-/etc/tf-mpc.env
ExecStart=/opt/tf-mpc/bin/tf-mpc control --model my_house --map map.yaml --connection connection.yaml
# With --page 127.0.0.1:8010 it has a page (extra serve); 0.0.0.0:8010 with TF_MPC_PAGE_TOKEN=… in that file.
# SIGTERM gives the building back, in up to five attempts.
TimeoutStopSec=90
Restart=always
RestartSec=60
# Wrong files and options do not get better by themselves.
RestartPreventExitStatus=2
MemoryMax=1G
NoNewPrivileges=true
ProtectSystem=strict
ProtectHome=true
PrivateTmp=true
PrivateDevices=true
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX

[Install]
WantedBy=multi-user.target
"""
KINDS = ("home-assistant", "mqtt", "files", "boptest")
"""What `tf-mpc init --for` knows; boptest is a scenario."""


def home_files(kind: str, map_text: str | None) -> dict[str, str]:
    """Texts by name of file of a real building behind `kind`; `map_text`: in the place of the example's map."""
    connection = {"home-assistant": _HOME_ASSISTANT, "mqtt": _MQTT, "files": _FILES}[kind]
    files = {
        "map.yaml": _MAP.format(**_NAMES[kind]) if map_text is None else map_text,
        "connection.yaml": connection + _FORECAST,
        "tf-mpc.service": _SERVICE,
    }
    if kind == "home-assistant":
        files["package.yaml"] = _PACKAGE
    return files
