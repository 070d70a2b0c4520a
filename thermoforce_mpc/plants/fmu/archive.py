"""Reader of an FMU file: its signals, and BOPTEST's data in its resources. The FMU is not run here."""

from __future__ import annotations

import hashlib
import io
import json
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.fmu.boundary_data import BoundaryData, read_table

_RESOURCES = "resources/"


@dataclass(frozen=True)
class Signal:
    """Input or output of the FMU: value reference, FMI type ('Real', 'Integer', 'Boolean'), and description."""

    reference: int
    kind: str
    point: Point


@dataclass(frozen=True)
class FmuArchive:
    """Content of an FMU that was read and checked.

    `kpi_signals`: outputs of each KPI category of BOPTEST ('ElectricPower', 'OperativeZoneTemperature[1]', ...), empty
    without a kpis.json. `days`: centre day of each scenario period. `area_m2`: floor area, None if not given.
    `tolerance`: that of the FMU's default experiment.
    """

    path: Path
    name: str
    tool: str
    sha256: str
    guid: str
    model_identifier: str
    tolerance: float | None
    inputs: Mapping[str, Signal]
    outputs: Mapping[str, Signal]
    kpi_signals: Mapping[str, tuple[str, ...]]
    days: Mapping[str, int]
    area_m2: float | None
    boundary: BoundaryData

    def points(self, signals: Mapping[str, Signal]) -> dict[str, Point]:
        """Return the description of each of `signals`, by name."""
        return {name: signal.point for name, signal in signals.items()}


def read_archive(path: Path) -> FmuArchive:
    """Read an FMU without running it.

    Raises:
        ConfigError: the file is missing, not an FMU, of another FMI version or kind, has no binaries for this machine,
            or its resources are missing or damaged; the message says which.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            description = _describe(path, file)
            _check_binaries(path, file, description.coSimulation.modelIdentifier)
            kpis, days, config = (_json(path, file, name) for name in ("kpis.json", "days.json", "config.json"))
            tables = _tables(path, file, config.get("resource_file_exclusion", []))
    except zipfile.BadZipFile as error:
        raise ConfigError(f"{path}: not an FMU ({error}); an FMU is a zip file, BOPTEST's is wrapped.fmu") from error
    tolerance = getattr(description.defaultExperiment, "tolerance", None)
    return FmuArchive(
        path=path,
        name=str(config.get("name") or description.modelName),
        tool=str(description.generationTool or "unknown tool"),
        sha256=hashlib.sha256(content).hexdigest(),
        guid=str(description.guid),
        model_identifier=str(description.coSimulation.modelIdentifier),
        tolerance=None if tolerance is None else float(tolerance),
        inputs=_signals(description, "input"),
        outputs=_signals(description, "output"),
        kpi_signals=_kpi_signals(path, kpis),
        days=_days(path, days),
        area_m2=_area(path, config),
        boundary=tables,
    )


def _describe(path: Path, file: zipfile.ZipFile) -> Any:
    """Return FMPy's model description of a co-simulation FMU of FMI 2.0; raises `ConfigError`."""
    try:
        from fmpy import read_model_description
    except ImportError as error:
        raise ConfigError("an FMU needs FMPy: pip install 'thermoforce-mpc[fmu]'") from error
    if "modelDescription.xml" not in file.namelist():
        raise ConfigError(f"{path}: not an FMU (the zip file holds no modelDescription.xml)")
    try:
        with file.open("modelDescription.xml") as xml:
            _, root = next(ElementTree.iterparse(xml, events=("start",)))
        version = root.get("fmiVersion")
    except (ElementTree.ParseError, StopIteration) as error:
        raise ConfigError(f"{path}: modelDescription.xml cannot be read ({error})") from error
    if version != "2.0":
        raise ConfigError(f"{path}: FMI version {version}; BOPTEST's test cases are FMI 2.0")
    try:
        # No schema validation: tools differ in details that are irrelevant here.
        description = read_model_description(io.BytesIO(_content(file)), validate=False)
    except Exception as error:  # the parser raises exceptions of several libraries
        raise ConfigError(f"{path}: modelDescription.xml cannot be used ({error})") from error
    if description.coSimulation is None:
        raise ConfigError(f"{path}: a model-exchange FMU; co-simulation is needed (BOPTEST compiles with target='cs')")
    return description


def _content(file: zipfile.ZipFile) -> bytes:
    """Return a zip file with only the model description, so that FMPy does not read the whole FMU again."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as small:
        small.writestr("modelDescription.xml", file.read("modelDescription.xml"))
    return buffer.getvalue()


def _check_binaries(path: Path, file: zipfile.ZipFile, identifier: str) -> None:
    from fmpy import platform, sharedLibraryExtension

    wanted = f"binaries/{platform}/{identifier}{sharedLibraryExtension}"
    if wanted not in file.namelist():
        offered = sorted(
            {name.split("/")[1] for name in file.namelist() if name.count("/") > 1 and "binaries/" in name}
        )
        raise ConfigError(
            f"{path}: no binaries for this machine ({wanted} is missing); the FMU runs on: "
            f"{', '.join(offered) or 'no platform'}"
        )


def _json(path: Path, file: zipfile.ZipFile, name: str) -> dict[str, Any]:
    """Return one JSON object of the resources, {} if the FMU does not have it; raises `ConfigError`."""
    if _RESOURCES + name not in file.namelist():
        return {}
    try:
        data = json.loads(file.read(_RESOURCES + name))
    except ValueError as error:
        raise ConfigError(f"{path}: {_RESOURCES}{name} is not JSON ({error})") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: {_RESOURCES}{name} holds a {type(data).__name__}, expected an object")
    return data


def _tables(path: Path, file: zipfile.ZipFile, excluded: list[str]) -> BoundaryData:
    data = BoundaryData({})
    for name in sorted(file.namelist()):
        if name.startswith(_RESOURCES) and name.endswith(".csv") and name.rsplit("/", 1)[1] not in excluded:
            data = data.with_table(read_table(file.read(name), f"{path}: {name}"), f"{path}: {name}")
    return data


def _signals(description: Any, causality: str) -> dict[str, Signal]:
    signals = {}
    for variable in description.modelVariables:
        if str(variable.causality) != causality or variable.type not in ("Real", "Integer", "Boolean"):
            continue
        declared = variable.declaredType
        unit = variable.unit or getattr(declared, "unit", None)
        limits = [variable.min or getattr(declared, "min", None), variable.max or getattr(declared, "max", None)]
        low, high = (None if limit is None else float(limit) for limit in limits)
        point = Point(variable.name, unit, variable.description or "", low, high)
        signals[variable.name] = Signal(int(variable.valueReference), str(variable.type), point)
    return signals


def _kpi_signals(path: Path, kpis: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    for category, names in kpis.items():
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise ConfigError(f"{path}: {_RESOURCES}kpis.json: '{category}' is {names!r}, expected a list of outputs")
    return {category: tuple(names) for category, names in kpis.items()}


def _days(path: Path, days: Mapping[str, Any]) -> dict[str, int]:
    for name, day in days.items():
        if not (isinstance(day, int) and 0 <= day < 365):
            raise ConfigError(f"{path}: {_RESOURCES}days.json: '{name}' is {day!r}, expected a day from 0 to 364")
    return dict(days)


def _area(path: Path, config: Mapping[str, Any]) -> float | None:
    area = config.get("area")
    if area is None:
        return None
    if not (isinstance(area, int | float) and area > 0):
        raise ConfigError(f"{path}: {_RESOURCES}config.json: area is {area!r}, expected square metres")
    return float(area)
