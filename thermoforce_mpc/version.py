"""The version of the package that is installed."""

from importlib.metadata import PackageNotFoundError, version

try:
    VERSION = version("thermoforce-mpc")
except PackageNotFoundError:  # a source tree that was never installed
    VERSION = "0+unknown"
