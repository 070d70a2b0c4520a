"""Exceptions of this package, and messages of any. A failed solve is not an exception but a status of the `Plan`."""

from __future__ import annotations

from thermoforce_mpc.errors import ConfigError, ThermoForceError


class ControllerConfigError(ConfigError):
    """The options or the model do not fit the controller."""


def said(error: Exception) -> str:
    """Message of an error, with the class name if it is not an exception of this package."""
    return str(error) if isinstance(error, ThermoForceError) else f"{type(error).__name__}: {error}"
