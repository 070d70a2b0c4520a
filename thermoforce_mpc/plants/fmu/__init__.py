"""A BOPTEST test case as a co-simulation FMU, without a service (needs the extra `fmu`)."""

from thermoforce_mpc.plants.fmu.plant import FmuPlant

__all__ = ["FmuPlant"]
