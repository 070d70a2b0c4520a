"""Plant that runs a BOPTEST test case from its co-simulation FMU, without a service (extra `fmu`)."""

from thermoforce_mpc.plants.fmu.plant import FmuPlant

__all__ = ["FmuPlant"]
