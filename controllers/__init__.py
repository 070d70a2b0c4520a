"""Controllers. Public names are imported on first use, since `ThermoForceMPC` loads CasADi."""

from __future__ import annotations

from typing import Any

__all__ = ["MPCConfig", "NativeController", "ThermoForceMPC", "Thermostat", "build_controller"]

_WHERE = {
    "MPCConfig": "controllers.mpc.config",
    "ThermoForceMPC": "controllers.mpc.controller",
    "NativeController": "controllers.rules.native",
    "Thermostat": "controllers.rules.thermostat",
    "build_controller": "controllers.registry",
}


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'controllers' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_WHERE[name]), name)
