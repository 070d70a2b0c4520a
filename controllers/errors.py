"""The exceptions of this package. A failed solve is not among them: it is a status on the `Plan`."""

from __future__ import annotations

from thermoforce_mpc.errors import ConfigError


class ControllerConfigError(ConfigError):
    """A controller cannot work with the options or the model it was given."""
