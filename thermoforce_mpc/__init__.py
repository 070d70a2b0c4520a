"""ThermoForce-MPC: predictive control of buildings over a free and a forced response.

The public names below are loaded on first use, so that `import thermoforce_mpc` is quick.
`docs/reference/python.md` shows them at work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermoforce_mpc.dependencies import report_nothing
from thermoforce_mpc.registry import lazy_names
from thermoforce_mpc.version import VERSION as __version__

if TYPE_CHECKING:
    from controllers.many.portfolio import Portfolio, plan_many
    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from thermoforce_mpc.data import Boundary, Observation, Plan, Record
    from thermoforce_mpc.errors import ThermoForceError
    from thermoforce_mpc.experiment.run import run
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.pipeline import identify
    from thermoforce_mpc.measurements.forecast import read_forecast
    from thermoforce_mpc.measurements.load import read_measurements
    from thermoforce_mpc.model.exported import modulation_function, rollout_function, step_function
    from thermoforce_mpc.model.thermal_model import ThermalModel, load_model
    from thermoforce_mpc.whatif.counterfactual import counterfactual
    from thermoforce_mpc.whatif.saving import verified_saving

report_nothing()  # before any module of ours imports a dependency

__all__ = [
    "Boundary", "IdentificationConfig", "MPCConfig", "Observation", "Plan", "Portfolio", "Record", "ThermalModel",
    "ThermoForceError", "ThermoForceMPC", "__version__", "counterfactual", "identify", "load_model",
    "modulation_function", "plan_many", "read_forecast", "read_measurements", "rollout_function", "run",
    "step_function", "verified_saving",
]  # fmt: skip

_NAMES = {
    "controllers.many.portfolio": ("Portfolio", "plan_many"),
    "controllers.mpc.config": ("MPCConfig",),
    "controllers.mpc.controller": ("ThermoForceMPC",),
    "thermoforce_mpc.data": ("Boundary", "Observation", "Plan", "Record"),
    "thermoforce_mpc.errors": ("ThermoForceError",),
    "thermoforce_mpc.identification.config": ("IdentificationConfig",),
    "thermoforce_mpc.identification.pipeline": ("identify",),
    "thermoforce_mpc.measurements.forecast": ("read_forecast",),
    "thermoforce_mpc.measurements.load": ("read_measurements",),
    "thermoforce_mpc.model.exported": ("modulation_function", "rollout_function", "step_function"),
    "thermoforce_mpc.model.thermal_model": ("ThermalModel", "load_model"),
    "thermoforce_mpc.experiment.run": ("run",),
    "thermoforce_mpc.whatif.counterfactual": ("counterfactual",),
    "thermoforce_mpc.whatif.saving": ("verified_saving",),
}

__getattr__ = lazy_names(__name__, {name: home for home, names in _NAMES.items() for name in names})


def __dir__() -> list[str]:
    return list(__all__)
