"""Plant that runs a BOPTEST test case from its co-simulation FMU, without a service (extra `fmu`)."""

from typing import TYPE_CHECKING

from thermoforce_mpc.registry import lazy_names

if TYPE_CHECKING:
    from thermoforce_mpc.plants.fmu.plant import FmuPlant

__all__ = ["FmuPlant"]

# The process of an FMU imports a module of this package, and needs nothing of what a plant does.
__getattr__ = lazy_names(__name__, {"FmuPlant": "thermoforce_mpc.plants.fmu.plant"})
