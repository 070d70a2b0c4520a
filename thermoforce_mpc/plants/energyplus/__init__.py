"""EnergyPlus plants: generated models, run in worker processes through the engine's runtime API."""
