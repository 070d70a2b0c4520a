"""ThermoForce-MPC: free response by a frozen forecaster, forced response by a monotone operator, decision by CasADi and Ipopt."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("thermoforce-mpc")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
