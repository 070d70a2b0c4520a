"""The embedded plant: nothing to install besides."""

from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant, Snapshot

__all__ = ["EmbeddedPlant", "Snapshot"]
