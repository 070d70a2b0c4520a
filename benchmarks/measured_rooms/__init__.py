"""Temperatures of measured buildings, predicted by the package's models under what acted there. Read `score`."""
