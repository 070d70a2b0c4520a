"""Whole runs with a controller: generated houses, BOPTEST's test cases, and a trained policy beside the MPC."""
