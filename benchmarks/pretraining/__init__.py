"""Pretraining of the shipped forecaster: synthetic series, training, evaluation."""
