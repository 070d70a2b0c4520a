"""What results depend on besides tasks, compared between a client and the workers of a cluster."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import sys
from collections.abc import Mapping

from thermoforce_mpc.execution.keys import source_fingerprint
from thermoforce_mpc.version import VERSION

_PACKAGES = ("casadi", "distributed", "numpy", "torch")


@functools.cache
def environment() -> dict[str, str]:
    """Versions in this process, by name; `source` is the fingerprint of this package's code."""
    versions = {"thermoforce-mpc": VERSION, "source": source_fingerprint()}
    versions["python"] = f"{sys.version_info.major}.{sys.version_info.minor}"
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def threads() -> str:
    """How many threads numerical libraries of this process use, as they were told: '' where nobody said."""
    return os.environ.get("OMP_NUM_THREADS", "")


def difference(expected: Mapping[str, str], actual: Mapping[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(
        f"{name} {actual.get(name, 'unknown')} instead of {version}"
        for name, version in expected.items()
        if actual.get(name) != version
    )
