"""Embedded plant: the emulator that ships with the package, without further dependencies."""

from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant

__all__ = ["EmbeddedPlant"]
