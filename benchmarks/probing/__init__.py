"""Informative probing against random probing, wrong priors, and online adaptation."""
