"""Informative probing against random probing."""
