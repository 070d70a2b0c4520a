"""Registry of connections by name. A new connection needs one file and one entry here.

Each name stands for a function or class whose parameters are the connection's options, all with defaults, and that
returns a `Connection`. Other distributions announce theirs in the group `thermoforce_mpc.connections`, see
docs/how-to/connection.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from thermoforce_mpc.connections.files import FilesConnection
from thermoforce_mpc.connections.home_assistant import HomeAssistantConnection
from thermoforce_mpc.connections.mqtt import MqttConnection
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import Connection
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.own_code import called, options_model, unfit
from thermoforce_mpc.scenario.settings import StrictModel, check_no_folder, merge, read_yaml, validate

REGISTRY: Registry[Callable[..., Connection]] = Registry(
    "connection",
    "connections",
    {"files": FilesConnection, "home-assistant": HomeAssistantConnection, "mqtt": MqttConnection},
    ConfigError,
    lambda entry: unfit(entry, ()),
)


class ConnectionFile(StrictModel):
    """A file with the name and the options of a connection."""

    name: str
    options: dict[str, Any] = Field(default_factory=dict)


def connection_settings(named: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and options of a connection that is `named` by name or by a YAML file, `options` above those of the file.

    Raises `ConfigError` for a file that is none.
    """
    if not named.endswith((".yaml", ".yml")):
        if named not in REGISTRY:
            check_no_folder(Path(named))
        return named, dict(options)
    if not Path(named).is_file():
        raise ConfigError(f"--connection {named}: no such file; `tf-mpc init --for home-assistant` writes one")
    content = read_yaml(Path(named))
    if isinstance(content, Mapping) and "testcase" in content:
        raise ConfigError(f"{named}: is a scenario of a simulated building, no connection: tf-mpc run --config {named}")
    read = validate(ConnectionFile, content, named)
    return read.name, merge(read.options, options)


def build_connection(name: str, options: Mapping[str, Any]) -> Connection:
    """Build a connection by name.

    Raises:
        ConfigError: unknown name or option, or one with a wrong value; names the key.
    """
    make = REGISTRY.find(name)
    config = validate(options_model(make, ()), options, f"options of connection '{name}'")
    connection = called(make, config, {})
    lacking = [method for method in ("measurements", "forecast", "write", "close") if not hasattr(connection, method)]
    if lacking:
        raise ConfigError(f"connection '{name}': has no {', '.join(lacking)}; see thermoforce_mpc.protocols.Connection")
    checked: Connection = connection
    return checked
