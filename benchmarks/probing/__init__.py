"""Informative probing against random probing, and online adaptation."""
