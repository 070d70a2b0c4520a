"""How the shipped forecaster is made: series, training, checkpoint (`python -m thermoforce_mpc.pretraining`)."""
