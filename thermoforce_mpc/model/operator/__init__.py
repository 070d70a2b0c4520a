"""Forced-response operator: the effect of an action on the zone temperature. Imports neither torch nor casadi."""
