"""Probing of a building: design of the excitation and the closed-loop run that applies it."""
