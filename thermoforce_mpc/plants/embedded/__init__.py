"""Embedded plants: emulators that ship with the package, without further dependencies."""

from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant
from thermoforce_mpc.plants.embedded.point_emulator import PointEmulator, emulator_of

__all__ = ["EmbeddedPlant", "PointEmulator", "emulator_of"]
