"""The exceptions of this package: one base, one branch per exit code of `tf-mpc`.

A message says what was wrong, where (file, key, endpoint), and what to do about it.
A failed *solve* is never an exception: it is a status on the `Plan`.
"""

from __future__ import annotations


class ThermoForceError(Exception):
    """Base of everything this package raises on purpose."""


class InputError(ThermoForceError):
    """Something the user gave cannot be used (exit code 2)."""


class ConfigError(InputError):
    """A YAML file, an option or a `--set` value is wrong; names the file, the key and what is allowed."""


class WeatherError(InputError):
    """A weather file is missing, truncated, malformed, or does not cover the time asked for."""


class DataError(InputError):
    """Data given for identification or forecasting cannot be used (too short, no excitation, wrong shape)."""


class ArtifactError(InputError):
    """A saved model is missing, damaged, of another version, or fails its own check."""


class BackboneError(InputError):
    """A forecaster cannot be loaded from the name or directory given."""


class PlantError(ThermoForceError):
    """The plant or the service behind it failed (exit code 3)."""
