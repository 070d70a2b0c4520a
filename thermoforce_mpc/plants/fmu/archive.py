"""Reader of an FMU file: its signals, by FMPy, and BOPTEST's boundary data in its resources. The FMU is not run here.

Members of its zip file are read within bounds and never written outside of their folder: an FMU is a program, and
whoever runs one trusts its author; reading one, to see what it is, must not need that trust. Boundary data are time
series over the year, in CSV files with a `time` column.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import shutil
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

import numpy as np
import pandas as pd

from boptest_client import Point
from thermoforce_mpc.data import DAY_S, YEAR_S, Array
from thermoforce_mpc.errors import ConfigError, WeatherError
from thermoforce_mpc.files import parse_json, read_bounded, read_pieces
from thermoforce_mpc.plants.fmu.process import FmuJob

# BOPTEST interpolates these series linearly and holds all others (prices, set-points, occupancy).
_WEATHER = (
    "HDifHor", "HDirNor", "HGloHor", "HHorIR", "TBlaSky", "TDewPoi", "TDryBul", "TWetBul", "ceiHei", "cloTim", "lat",
    "lon", "nOpa", "nTot", "pAtm", "relHum", "solAlt", "solDec", "solHouAng", "solTim", "solZen", "winDir", "winSpe",
)  # fmt: skip
# A year of weather every 15 minutes has 12 MB.
MOST_BYTES = 100_000_000
_MOST_ROWS = 2 * 365 * 1440 + 2
_MOST_LINE_BYTES = 20_000
_PART_ROWS = 20_000
_LARGEST = 1e12
_UNITS = {"TDryBul": "K", "TDewPoi": "K", "TWetBul": "K", "TBlaSky": "K", "HGloHor": "W/m2", "HDirNor": "W/m2"}
_UNITS |= {"HDifHor": "W/m2", "HHorIR": "W/m2"}


@dataclass(frozen=True)
class Series:
    """Time series: values (n,) at increasing times (n,), s since 1 January, and its source file."""

    time_s: Array
    values: Array
    source: str


@dataclass(frozen=True)
class BoundaryData:
    """Series by BOPTEST name, in BOPTEST's units."""

    series: Mapping[str, Series]

    def with_table(self, table: Mapping[str, Series], source: str) -> BoundaryData:
        """Return these series plus those of `table`; raises `ConfigError` for duplicate names."""
        for name in table:
            if name in self.series:
                raise ConfigError(f"{source}: column '{name}' is already in {self.series[name].source}")
        return BoundaryData({**self.series, **table})

    def unit(self, name: str) -> str | None:
        """Return the unit of a weather series or comfort bound; None for others, whose unit no file gives."""
        return "K" if name.startswith(("LowerSetp", "UpperSetp")) else _UNITS.get(name)

    def at(self, name: str, time_s: Array) -> Array:
        """Return the series `name` at times (n,), s since 1 January: weather interpolated linearly, others held.

        A series that covers the year repeats, as in BOPTEST. For times that begin before New Year its last value is
        that of midnight, followed by the first of the new year; times that begin at New Year take the first. Raises
        `ConfigError` for an unknown series, `WeatherError` for a time outside the file's range.
        """
        if name not in self.series:
            raise ConfigError(f"the FMU's resources have no series '{name}'; known: {', '.join(sorted(self.series))}")
        one = self.series[name]
        time_s = np.asarray(time_s, dtype=np.float64)
        until_s = float(2.0 * one.time_s[-1] - one.time_s[-2])  # the last value holds as long as the one before it
        if until_s >= YEAR_S and time_s.size:
            time_s = time_s - YEAR_S * max(0.0, np.floor(time_s.min() / YEAR_S))
            time_s = np.where(time_s > YEAR_S, np.mod(time_s, YEAR_S), time_s)
        if time_s.size and (time_s.min() < one.time_s[0] - 1e-6 or time_s.max() > until_s + 1e-6):
            raise WeatherError(
                f"{one.source}: '{name}' covers days {one.time_s[0] / DAY_S:g} to {until_s / DAY_S:g}, "
                f"asked for days {time_s.min() / DAY_S:g} to {time_s.max() / DAY_S:g}; choose an earlier window"
            )
        if name in _WEATHER:
            return np.asarray(np.interp(time_s, one.time_s, one.values))
        index = np.searchsorted(one.time_s, time_s + 1e-6, side="right") - 1
        return one.values[np.maximum(index, 0)]

    def require(self, names: Iterable[str], purpose: str) -> None:
        """Raise `ConfigError` if a series needed for `purpose` is missing."""
        missing = [name for name in names if name not in self.series]
        if missing:
            raise ConfigError(f"the FMU's resources have no series {', '.join(missing)}, needed for {purpose}")


def read_table(content: bytes, source: str) -> dict[str, Series]:
    """Return the series of one CSV file; {} for a file without a `time` column, which BOPTEST also ignores.

    A row in which all but the time is empty is left out. Raises `ConfigError`, which names file, column and row, for a
    truncated or malformed file, a cell that is no finite number, or a time that does not increase.
    """
    _check_lines(content, source)
    columns: dict[str, list[Array]] = {}
    try:
        # In parts, so that a cell of text costs memory for a part only.
        with (
            warnings.catch_warnings(),
            pd.read_csv(
                io.BytesIO(content), comment="#", index_col=False, chunksize=_PART_ROWS, low_memory=False
            ) as parts,
        ):
            warnings.simplefilter("error", pd.errors.ParserWarning)
            for part in parts:
                if "time" not in part:
                    return {}
                # A row without any value says nothing; BOPTEST goes on with the one before it.
                part = part[part.drop(columns="time").notna().any(axis=1) | (part.columns.size == 1)]
                for name in part.columns:
                    columns.setdefault(str(name), []).append(_numbers(part[name], source))
    except pd.errors.ParserWarning as error:
        raise ConfigError(f"{source}: its rows have more cells than its header") from error
    except (ValueError, OverflowError) as error:  # pandas' parser errors are ValueErrors
        raise ConfigError(f"{source}: not a CSV file ({error!s:.200})") from error
    arrays = {name: np.concatenate(values) for name, values in columns.items()}
    time_s = arrays.pop("time")
    if time_s.size < 2 or not (np.diff(time_s) > 0).all():
        raise ConfigError(f"{source}: column 'time' must rise over at least two rows")
    return {name: Series(time_s, values, source) for name, values in arrays.items()}


def _numbers(column: pd.Series, source: str) -> Array:
    """Return the numbers of a column; raises `ConfigError` naming the first cell that is none."""
    values: Array = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
    usable = np.abs(values) <= _LARGEST
    if not usable.all():
        at = int(np.argmin(usable))
        what = f"column '{column.name!s:.100}', data row {column.index[at] + 1}: '{column.iloc[at]!s:.60}'"
        raise ConfigError(f"{source}: {what} is no number, or beyond ±{_LARGEST:g}")
    return values


def _check_lines(content: bytes, source: str) -> None:
    """Raise `ConfigError` for what no table of numbers has: lines without end, many of them, open quotes."""
    if content.count(b"\n") > _MOST_ROWS:
        raise ConfigError(f"{source}: more than {_MOST_ROWS:,} rows, two years of minutes")
    characters = np.frombuffer(content, dtype=np.uint8)
    ends = np.concatenate([[-1], np.flatnonzero(characters == ord("\n")), [characters.size]])
    if np.diff(ends).max() > _MOST_LINE_BYTES:
        raise ConfigError(f"{source}: line {int(np.diff(ends).argmax()) + 1} has more than {_MOST_LINE_BYTES:,} bytes")
    quotes = np.bincount(np.searchsorted(ends, np.flatnonzero(characters == ord('"'))), minlength=1)
    if (quotes % 2).any():
        raise ConfigError(f"{source}: line {int((quotes % 2).argmax())}: a quotation mark is not closed")


# BOPTEST's test cases have 6 MB, 34 MB when unpacked, in 13 members.
_MOST_FILE_BYTES = 500_000_000
_MOST_UNPACKED_BYTES = 2_000_000_000
_MOST_MEMBERS = 20_000
_MOST_LIST_BYTES = 200 * _MOST_MEMBERS
_MOST_NAME = 1000
_KINDS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1


class Members:
    """Members of the zip file at `path` by name, after a check of their number, sizes and names.

    Raises `ConfigError` where the file is missing, no zip file, too large, or has a member that no FMU has.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        content = read_bounded(path, _MOST_FILE_BYTES, ConfigError)
        self.sha256 = hashlib.sha256(content).hexdigest()
        # Before the list is read: each of its entries costs ten times its size in memory.
        if _list_bytes(content) > _MOST_LIST_BYTES:
            raise ConfigError(f"{path}: not an FMU (its list of members is longer than {_MOST_LIST_BYTES:,} bytes)")
        with self._as_config_error():
            self._file = zipfile.ZipFile(io.BytesIO(content))
        self.names = tuple(self._file.namelist())
        if len(self.names) > _MOST_MEMBERS:
            raise ConfigError(f"{path}: {len(self.names):,} members; at most {_MOST_MEMBERS:,} are read")
        if len(set(self.names)) != len(self.names):
            raise ConfigError(f"{path}: two members have the same name")
        for member in self._file.infolist():
            self._check(member)
        unpacked = sum(member.file_size for member in self._file.infolist())
        if unpacked > _MOST_UNPACKED_BYTES:
            raise ConfigError(f"{path}: {unpacked:,} bytes when unpacked; at most {_MOST_UNPACKED_BYTES:,} are")

    def read(self, name: str, most_bytes: int) -> bytes:
        """Return the content of a member; raises `ConfigError` where it is damaged or longer than `most_bytes`."""
        size = self._file.getinfo(name).file_size
        if size > most_bytes:
            raise ConfigError(f"{self._path}: {name} has {size:,} bytes; at most {most_bytes:,} are read")
        with self._as_config_error(name), self._file.open(name) as member:
            return read_pieces(member, most_bytes)

    def unpack(self, folder: Path) -> None:
        """Write all members below `folder`; raises `ConfigError` if one is damaged or there is no room."""
        free = shutil.disk_usage(folder).free
        needed = sum(member.file_size for member in self._file.infolist())
        if needed > free:
            raise ConfigError(f"{self._path}: needs {needed:,} bytes in {folder}, which has {free:,}; set TMPDIR")
        with self._as_config_error():
            self._file.extractall(folder)

    def _check(self, member: zipfile.ZipInfo) -> None:
        name, where = member.filename, f"{self._path}: member {member.filename!r:.100}"
        pure = PurePosixPath(name)
        if pure.is_absolute() or ".." in pure.parts or re.search(r"[\\:\x00-\x1f]", name) or len(name) > _MOST_NAME:
            raise ConfigError(f"{where} leads out of the folder it would be unpacked to, or is no file's name")
        if member.compress_type not in _KINDS or member.flag_bits & _ENCRYPTED:
            raise ConfigError(f"{where} is encrypted or packed by another method than FMI's (deflate)")

    @contextmanager
    def _as_config_error(self, name: str = "") -> Iterator[None]:
        try:
            yield
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError) as error:
            what = f"{name} cannot be read ({error!s:.200})" if name else f"not an FMU ({error!s:.200})"
            raise ConfigError(f"{self._path}: {what}; an FMU is a zip file, BOPTEST's is wrapped.fmu") from error


def _list_bytes(content: bytes) -> int:
    """Return the length of a zip file's list of members as its end states it, bytes; of several ends the largest."""
    sizes = [0]
    for match in re.finditer(rb"PK\x05\x06", content[-(22 + 65_535) :]):
        end = max(0, len(content) - 22 - 65_535) + match.start()
        far = end - 20 - 56
        if far >= 0 and content[end - 20 :].startswith(b"PK\x06\x07") and content[far:].startswith(b"PK\x06\x06"):
            sizes.append(int.from_bytes(content[far + 40 : far + 48], "little"))
        else:
            sizes.append(int.from_bytes(content[end + 12 : end + 16], "little"))
    return max(sizes)


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
