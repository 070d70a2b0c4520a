"""Thermal model of a building: operator, machine models and free responses."""
