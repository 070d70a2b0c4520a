"""Registry of providers of weather and prices by name. A new one needs one class and one entry here.

Each name stands for a function or class whose parameters are the provider's options, all with defaults, and that
returns a `Provider`. Other distributions announce theirs in the group `thermoforce_mpc.providers`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import Provider
from thermoforce_mpc.providers.prices import Awattar, EnergyZero, Entsoe, NordPool, Octopus, Tibber
from thermoforce_mpc.providers.weather import MetNorway, OpenMeteo
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.own_code import called, options_model, unfit
from thermoforce_mpc.scenario.settings import validate

REGISTRY: Registry[Callable[..., Provider]] = Registry(
    "provider",
    "providers",
    {
        "open-meteo": OpenMeteo, "met-norway": MetNorway, "entsoe": Entsoe, "awattar": Awattar, "tibber": Tibber,
        "nord-pool": NordPool, "energyzero": EnergyZero, "octopus": Octopus,
    },
    ConfigError,
    lambda entry: unfit(entry, ()),
)  # fmt: skip


def build_provider(name: str, options: Mapping[str, Any]) -> Provider:
    """A provider by name; raises `ConfigError` for an unknown name or option, or a wrong value."""
    make = REGISTRY.find(name)
    config = validate(options_model(make, ()), options, f"options of provider '{name}'")
    provider: Provider = called(make, config, {})
    return provider
