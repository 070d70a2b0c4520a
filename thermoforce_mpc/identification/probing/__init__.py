"""Probing a building: which levels, when, and the closed run that applies them."""
