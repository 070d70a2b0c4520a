"""How the shipped forecaster is made: series, training, checkpoint."""
