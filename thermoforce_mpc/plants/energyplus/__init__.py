"""EnergyPlus as a building: models written by our code, run in worker processes through the engine's runtime API."""
