"""Benches, interventional suite and pretraining. A user of the product need not enter."""
