"""Benches, interventional suite, baselines and pretraining. Not needed to run a controller."""
