"""ThermoForce-MPC: predictive control of buildings over a free and a forced response."""

from thermoforce_mpc.version import VERSION as __version__

__all__ = ["__version__"]
