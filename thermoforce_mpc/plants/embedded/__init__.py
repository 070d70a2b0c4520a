"""Embedded plants: emulators that ship with the package, without further dependencies."""

from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant, PointEmulator

__all__ = ["EmbeddedPlant", "PointEmulator"]
