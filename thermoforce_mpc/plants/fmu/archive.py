"""Reader of an FMU file: its signals, and BOPTEST's data in its resources. The FMU is not run here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import parse_json
from thermoforce_mpc.plants.fmu.boundary_data import MOST_BYTES, BoundaryData, read_table
from thermoforce_mpc.plants.fmu.description import Signal, finite, read_description, read_signals
from thermoforce_mpc.plants.fmu.members import Members
from thermoforce_mpc.plants.fmu.messages import Job

_RESOURCES = "resources/"
_MOST_JSON_BYTES = 1_000_000
_MOST_TABLES_BYTES = 400_000_000
_MOST_AREA_M2 = 1e7


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

    def job(self, folder: Path, recorded: tuple[str, ...]) -> Job:
        """What a worker process is to run from `folder`, where the archive is unpacked, and which outputs it keeps."""
        return Job(
            folder=str(folder),
            guid=self.guid,
            model_identifier=self.model_identifier,
            tolerance=self.tolerance,
            inputs={name: (signal.reference, signal.kind) for name, signal in self.inputs.items()},
            outputs={name: (signal.reference, signal.kind) for name, signal in self.outputs.items()},
            recorded=recorded,
        )

    def points(self, signals: Mapping[str, Signal]) -> dict[str, Point]:
        """Return the description of each of `signals`, by name."""
        return {name: signal.point for name, signal in signals.items()}


def read_archive(path: Path) -> FmuArchive:
    """Read an FMU without running it.

    Raises:
        ConfigError: the file is missing, not an FMU, of another FMI version or kind, has no binaries for this machine,
            or its members or resources are damaged or too large; the message says which.
    """
    members = Members(path)
    description = read_description(path, members)
    identifier = str(description.coSimulation.modelIdentifier)
    _check_binaries(path, members, identifier)
    kpis, days, config = (_json(path, members, name) for name in ("kpis.json", "days.json", "config.json"))
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
        kpi_signals=_kpi_signals(path, kpis),
        days=_days(path, days),
        area_m2=_area(path, config),
        boundary=_tables(path, members, _excluded(path, config)),
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


def _tables(path: Path, members: Members, excluded: list[str]) -> BoundaryData:
    data, left = BoundaryData({}), _MOST_TABLES_BYTES
    for name in sorted(members.names):
        if name.startswith(_RESOURCES) and name.endswith(".csv") and name.rsplit("/", 1)[1] not in excluded:
            content = members.read(name, min(MOST_BYTES, left))
            left -= len(content)
            data = data.with_table(read_table(content, f"{path}: {name}"), f"{path}: {name}")
    return data


def _excluded(path: Path, config: Mapping[str, Any]) -> list[str]:
    names = config.get("resource_file_exclusion", [])
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise ConfigError(
            f"{path}: {_RESOURCES}config.json: resource_file_exclusion is {names!r:.100}, expected a list of files"
        )
    return names


def _kpi_signals(path: Path, kpis: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    for category, names in kpis.items():
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise ConfigError(
                f"{path}: {_RESOURCES}kpis.json: '{category:.100}' is {names!r:.100}, expected a list of outputs"
            )
    return {category: tuple(names) for category, names in kpis.items()}


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
