"""Location and versions of the EnergyPlus engine, its weather files and its reference buildings.

The wheel `pyenergyplus-lbnl` (extra `[energyplus]`) contains the shared library, the Python API, TMY3 weather files and
DOE reference buildings.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from functools import cache
from pathlib import Path

from thermoforce_mpc.errors import PlantError, WeatherError
from thermoforce_mpc.files import file_sha256

PACKAGE = "pyenergyplus-lbnl"


def is_available() -> bool:
    """Return whether the engine's package is installed."""
    return importlib.util.find_spec("pyenergyplus") is not None


def engine_folder() -> Path:
    """Return the folder of the engine's Python API; raises `PlantError` if it is not installed."""
    spec = importlib.util.find_spec("pyenergyplus")
    if spec is None or spec.origin is None:
        raise PlantError(f"EnergyPlus is not installed: pip install 'thermoforce-mpc[energyplus]' (package {PACKAGE})")
    return Path(spec.origin).parent


def engine_version() -> str:
    """Return the version of the engine's wheel, which is that of the engine."""
    engine_folder()
    return importlib.metadata.version(PACKAGE)


def weather_file(name: str) -> Path:
    """Return the TMY3 file whose name contains `name`; raises `WeatherError`, listing the files, if not exactly one."""
    folder = engine_folder() / "data" / "weather"
    paths = sorted(folder.glob(f"*{name}*.epw"))
    if len(paths) != 1:
        there = ", ".join(sorted(path.stem for path in folder.glob("*.epw")))
        raise WeatherError(
            f"EnergyPlus weather '{name}': {len(paths)} files of that name in {folder}; there are {there}"
        )
    return paths[0]


def reference_building(name: str) -> Path:
    """Return the IDF of a DOE reference building shipped with the engine, as 'RefBldgSmallOfficeNew2004_Chicago'.

    Raises:
        PlantError: there is no building of that name.
    """
    path = engine_folder() / "data" / "model" / f"{name}.idf"
    if not path.is_file():
        raise PlantError(f"EnergyPlus: no reference building '{name}' in {path.parent}")
    return path


file_hash = cache(file_sha256)
