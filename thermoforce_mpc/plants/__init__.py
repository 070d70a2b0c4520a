"""Plants: buildings that can be run. Each implements `thermoforce_mpc.protocols.Plant`."""
