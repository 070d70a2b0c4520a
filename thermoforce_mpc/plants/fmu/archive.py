"""Reader of an FMU file: its signals, by FMPy, and BOPTEST's data in its resources. The FMU is not run here."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import parse_json
from thermoforce_mpc.plants.fmu.boundary_data import MOST_BYTES, BoundaryData, read_table
from thermoforce_mpc.plants.fmu.members import Members
from thermoforce_mpc.plants.fmu.process import FmuJob

_NAME, _RESOURCES = "modelDescription.xml", "resources/"
# BOPTEST's test cases of one and two zones have 4 to 13 MB; in memory ten times that.
_MOST_BYTES = 100_000_000
_MOST_JSON_BYTES, _MOST_TABLES_BYTES = 1_000_000, 400_000_000
_MOST_AREA_M2 = 1e7
_PIECE = 4096
_MOST_REFERENCE = 2**32 - 1


class FmuVariable(NamedTuple):
    """Input or output of the FMU: value reference, FMI type ('Real', 'Integer', 'Boolean'), and description."""

    reference: int
    kind: str
    point: Point


def read_description(path: Path, members: Members) -> Any:
    """Return FMPy's model description of a co-simulation FMU of FMI 2.0; raises `ConfigError`."""
    try:
        from fmpy import read_model_description
    except ImportError as error:
        raise ConfigError("an FMU needs FMPy: pip install 'thermoforce-mpc[fmu]'") from error
    if _NAME not in members.names:
        raise ConfigError(f"{path}: not an FMU (the zip file holds no {_NAME})")
    xml = members.read(_NAME, _MOST_BYTES)
    version = _root(path, xml).get("fmiVersion")
    if version != "2.0":
        raise ConfigError(f"{path}: FMI version {version!s:.20}; BOPTEST's test cases are FMI 2.0")
    alone = io.BytesIO()  # so that FMPy does not read the whole FMU again
    with zipfile.ZipFile(alone, "w") as small:
        small.writestr(_NAME, xml)
    try:
        # No schema validation: tools differ in details that are irrelevant here.
        description = read_model_description(alone, validate=False)
    except Exception as error:  # the parser raises exceptions of several libraries
        raise ConfigError(f"{path}: {_NAME} cannot be used ({error!s:.300})") from error
    if description.coSimulation is None:
        raise ConfigError(f"{path}: a model-exchange FMU; co-simulation is needed (BOPTEST compiles with target='cs')")
    return description


def read_signals(path: Path, description: Any, causality: str) -> dict[str, FmuVariable]:
    """Return the signals of one causality ('input', 'output') by name; raises `ConfigError` for one without sense."""
    signals = {}
    for variable in description.modelVariables:
        if str(variable.causality) != causality or variable.type not in ("Real", "Integer", "Boolean"):
            continue
        where = f"{path}: {_NAME}: variable {variable.name!r:.100}"
        declared = variable.declaredType
        unit = variable.unit or getattr(declared, "unit", None)
        limits = [variable.min or getattr(declared, "min", None), variable.max or getattr(declared, "max", None)]
        low, high = (None if limit is None else finite(limit, where) for limit in limits)
        reference = int(variable.valueReference)
        if not 0 <= reference <= _MOST_REFERENCE:
            raise ConfigError(f"{where}: value reference {reference:g}, expected 0 to {_MOST_REFERENCE}")
        point = Point(str(variable.name), unit, variable.description or "", low, high)
        signals[point.name] = FmuVariable(reference, str(variable.type), point)
    return signals


def finite(given: Any, where: str) -> float:
    """Return an attribute of the description as a number; raises `ConfigError` naming `where`."""
    try:
        value = float(given)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {given!r:.60} where a finite number is expected")
    return value


def _root(path: Path, xml: bytes) -> dict[str, str]:
    """Return the attributes of the first element. A document type is refused: it can name files and grow endlessly."""

    def refuse(*_: object) -> NoReturn:
        raise ConfigError(f"{path}: {_NAME} declares a document type, which no FMU has")

    elements: list[dict[str, str]] = []
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = lambda _, attributes: elements.append(attributes)
    try:
        for start in range(0, len(xml), _PIECE):
            parser.Parse(xml[start : start + _PIECE])
            if elements:
                return elements[0]
    except (expat.ExpatError, ValueError, LookupError) as error:  # the latter two: an encoding that Python lacks
        raise ConfigError(f"{path}: {_NAME} cannot be read ({error})") from error
    raise ConfigError(f"{path}: {_NAME} cannot be read (it holds no element)")


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
    inputs: Mapping[str, FmuVariable]
    outputs: Mapping[str, FmuVariable]
    kpi_signals: Mapping[str, tuple[str, ...]]
    days: Mapping[str, int]
    area_m2: float | None
    boundary: BoundaryData

    def job(self, folder: Path, recorded: tuple[str, ...]) -> FmuJob:
        """What a worker process is to run from `folder`, where the archive is unpacked, and which outputs it keeps."""
        return FmuJob(
            folder=str(folder),
            guid=self.guid,
            model_identifier=self.model_identifier,
            tolerance=self.tolerance,
            inputs={name: signal[:2] for name, signal in self.inputs.items()},
            outputs={name: signal[:2] for name, signal in self.outputs.items()},
            recorded=recorded,
        )


def read_archive(path: Path) -> FmuArchive:
    """Read an FMU without running it.

    Raises `ConfigError`, which says why, for a file that is missing, not an FMU, of another FMI version or kind,
    without binaries for this machine, or whose members or resources are damaged or too large.
    """
    members = Members(path)
    description = read_description(path, members)
    identifier = str(description.coSimulation.modelIdentifier)
    _check_binaries(path, members, identifier)
    kpis, days, config = (_json(path, members, name) for name in ("kpis.json", "days.json", "config.json"))
    resources = f"{path}: {_RESOURCES}"
    excluded = _names(
        config.get("resource_file_exclusion", []), f"{resources}config.json: resource_file_exclusion", "files"
    )
    tolerance = getattr(description.defaultExperiment, "tolerance", None)
    return FmuArchive(
        path=path,
        name=str(config.get("name") or description.modelName),
        tool=str(description.generationTool or "unknown tool"),
        sha256=members.sha256,
        guid=str(description.guid),
        model_identifier=identifier,
        tolerance=None if tolerance is None else finite(tolerance, f"{path}: tolerance"),
        inputs=read_signals(path, description, "input"),
        outputs=read_signals(path, description, "output"),
        kpi_signals={
            key: _names(named, f"{resources}kpis.json: '{key:.100}'", "outputs") for key, named in kpis.items()
        },
        days=_days(path, days),
        area_m2=_area(path, config),
        boundary=_tables(path, members, excluded),
    )


def scenario_days(path: Path) -> dict[str, int]:
    """Centre day of each scenario period of an FMU; raises `ConfigError` as `read_archive` for what it reads of it."""
    return _days(path, _json(path, Members(path), "days.json"))


def unpack(archive: FmuArchive, folder: Path) -> None:
    """Unpack an FMU below `folder`; raises `ConfigError` if its file is no longer the one that was read."""
    members = Members(archive.path)
    if members.sha256 != archive.sha256:
        raise ConfigError(f"{archive.path}: was changed while it was read; try again")
    members.unpack(folder)


def _check_binaries(path: Path, members: Members, identifier: str) -> None:
    from fmpy import platform, sharedLibraryExtension

    wanted = f"binaries/{platform}/{identifier}{sharedLibraryExtension}"
    if wanted not in members.names:
        offered = sorted({name.split("/")[1] for name in members.names if name.count("/") > 1 and "binaries/" in name})
        raise ConfigError(
            f"{path}: no binaries for this machine ({wanted:.200} is missing); the FMU runs on: "
            f"{', '.join(offered)[:200] or 'no platform'}"
        )


def _json(path: Path, members: Members, name: str) -> dict[str, Any]:
    """Return one JSON object of the resources, {} if the FMU does not have it; raises `ConfigError`."""
    if _RESOURCES + name not in members.names:
        return {}
    return parse_json(members.read(_RESOURCES + name, _MOST_JSON_BYTES), f"{path}: {_RESOURCES}{name}", ConfigError)


def _tables(path: Path, members: Members, excluded: Sequence[str]) -> BoundaryData:
    data, left = BoundaryData({}), _MOST_TABLES_BYTES
    for name in sorted(members.names):
        if name.startswith(_RESOURCES) and name.endswith(".csv") and name.rsplit("/", 1)[1] not in excluded:
            content = members.read(name, min(MOST_BYTES, left))
            left -= len(content)
            data = data.with_table(read_table(content, f"{path}: {name}"), f"{path}: {name}")
    return data


def _names(names: Any, where: str, what: str) -> tuple[str, ...]:
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise ConfigError(f"{where} is {names!r:.100}, expected a list of {what}")
    return tuple(names)


def _days(path: Path, days: Mapping[str, Any]) -> dict[str, int]:
    for name, day in days.items():
        if not (isinstance(day, int) and not isinstance(day, bool) and 0 <= day < 365):
            raise ConfigError(
                f"{path}: {_RESOURCES}days.json: '{name:.100}' is {day!r:.100}, expected a day from 0 to 364"
            )
    return dict(days)


def _area(path: Path, config: Mapping[str, Any]) -> float | None:
    area = config.get("area")
    if area is None:
        return None
    if isinstance(area, bool) or not isinstance(area, int | float) or not 0 < area <= _MOST_AREA_M2:
        raise ConfigError(f"{path}: {_RESOURCES}config.json: area is {area!r:.60}, expected square metres")
    return float(area)
