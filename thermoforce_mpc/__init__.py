"""ThermoForce-MPC: predictive control of buildings over a free and a forced response."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("thermoforce-mpc")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
