"""Exceptions of this package. A failed solve is not an exception but a status of the `Plan`."""

from __future__ import annotations

from thermoforce_mpc.errors import ConfigError


class ControllerConfigError(ConfigError):
    """The options or the model do not fit the controller."""
