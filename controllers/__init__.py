"""Controllers. Public names are imported on first use, since `ThermoForceMPC` loads CasADi."""

from __future__ import annotations

from thermoforce_mpc.registry import lazy_names

__all__ = ["MPCConfig", "NativeController", "ThermoForceMPC", "Thermostat", "build_controller"]

__getattr__ = lazy_names(
    __name__,
    {
        "MPCConfig": "controllers.mpc.config",
        "ThermoForceMPC": "controllers.mpc.controller",
        "NativeController": "controllers.rules.native",
        "Thermostat": "controllers.rules.thermostat",
        "build_controller": "controllers.registry",
    },
)
