"""Plants: simulated buildings that implement `thermoforce_mpc.protocols.Plant`."""
