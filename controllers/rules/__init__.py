"""Controllers without a model: thermostat, PI, and the plant's own control."""
