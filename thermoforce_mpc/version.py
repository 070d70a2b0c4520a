"""Versions of this package and of others, as they are installed."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version


def installed(packages: Iterable[str], absent: str = "not installed") -> dict[str, str]:
    """The version of each package, by name; `absent` where there is none."""
    versions = {}
    for name in packages:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = absent
    return versions


# Unknown in a source tree that was never installed.
VERSION = installed(["thermoforce-mpc"], "0+unknown")["thermoforce-mpc"]
