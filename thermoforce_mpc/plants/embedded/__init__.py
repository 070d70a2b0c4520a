"""The embedded plant: nothing to install besides."""

from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant, Snapshot
from thermoforce_mpc.plants.embedded.together import advance_together

__all__ = ["EmbeddedPlant", "Snapshot", "advance_together"]
