"""Boundary conditions: weather, tariffs, scored windows and forecast errors."""
