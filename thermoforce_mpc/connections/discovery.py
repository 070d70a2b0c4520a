"""The device that Home Assistant finds by MQTT: one retained message with all its entities.

Layout: https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload (core 2024.11 and newer).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

DEVICE = "ThermoForce MPC"
MODES = ("control", "advise")
"""Between which a controller that acts is switched; the second one gives the building back, and plans on."""
_SENSORS = {
    "status": ("Status", {}),
    "why": ("Why", {}),
    "level": ("Set now", {"icon": "mdi:radiator"}),
    "plan": ("Plan", {"icon": "mdi:chart-line", "json_attributes_topic": "PREFIX/plan"}),
    "saving": ("Saving", {"icon": "mdi:piggy-bank", "json_attributes_topic": "PREFIX/saving"}),
}


def device_message(prefix: str, node: str, version: str, asks: Collection[str]) -> dict[str, Any]:
    """The message for `PREFIX/device/NODE/config`; entities that set something only for what is in `asks`."""
    parts: dict[str, dict[str, Any]] = {}
    for key, (name, more) in _SENSORS.items():
        part = {"p": "sensor", "name": name, "state_topic": f"{prefix}/{key}"}
        part |= {k: v.replace("PREFIX", prefix) for k, v in more.items()}
        # A state has 255 characters at most: of long ones the beginning, of the plan its next hours in words.
        said = {"plan": "{{ value_json.next }}", "saving": "{{ value_json.said[:250] }}"}
        part["value_template"] = said.get(key, "{{ value[:250] }}")
        parts[key] = part
    if {"lower", "upper"} <= set(asks):
        parts["comfort"] = {
            "p": "climate", "name": "Comfort", "modes": ["auto"], "min_temp": 5, "max_temp": 35, "temp_step": 0.5,
            "temperature_unit": "C", "mode_state_topic": f"{prefix}/people",
            "mode_state_template": "auto",
            "temperature_low_state_topic": f"{prefix}/people",
            "temperature_low_state_template": "{{ value_json.lower_C or value_json.planned_lower_C }}",
            "temperature_low_command_topic": f"{prefix}/set/lower",
            "temperature_high_state_topic": f"{prefix}/people",
            "temperature_high_state_template": "{{ value_json.upper_C or value_json.planned_upper_C }}",
            "temperature_high_command_topic": f"{prefix}/set/upper",
        }  # fmt: skip
    if "mode" in asks:
        parts["mode"] = {
            "p": "select", "name": "Mode", "options": list(MODES), "state_topic": f"{prefix}/people",
            "value_template": "{{ value_json.mode }}", "command_topic": f"{prefix}/set/mode",
        }  # fmt: skip
    if "boost" in asks:
        parts["boost"] = {
            "p": "number", "name": "Boost", "min": 0, "max": 480, "step": 15, "unit_of_measurement": "min",
            "state_topic": f"{prefix}/people", "value_template": "{{ value_json.boost_min }}",
            "command_topic": f"{prefix}/set/boost",
        }  # fmt: skip
    if "away" in asks:
        parts["away"] = {
            "p": "switch", "name": "Away", "state_topic": f"{prefix}/people", "command_topic": f"{prefix}/set/away",
            "value_template": "{{ 'ON' if value_json.away else 'OFF' }}",
        }  # fmt: skip
    for key, part in parts.items():
        part["unique_id"] = f"{node}_{key}"
    return {
        "dev": {"ids": node, "name": DEVICE, "mf": "thermoforce-mpc", "sw": version},
        "o": {"name": "thermoforce-mpc", "sw": version},
        "cmps": parts,
        "availability": [{"topic": f"{prefix}/availability"}],
    }
