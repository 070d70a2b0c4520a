"""Description of an FMU: its signals, read by FMPy from modelDescription.xml."""

from __future__ import annotations

import io
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.fmu.members import Members

_NAME = "modelDescription.xml"
# BOPTEST's test cases of one and two zones have 4 to 13 MB; in memory ten times that.
_MOST_BYTES = 100_000_000
_PIECE = 4096
_MOST_REFERENCE = 2**32 - 1


@dataclass(frozen=True)
class Signal:
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
    try:
        # No schema validation: tools differ in details that are irrelevant here.
        description = read_model_description(io.BytesIO(_alone(xml)), validate=False)
    except Exception as error:  # the parser raises exceptions of several libraries
        raise ConfigError(f"{path}: {_NAME} cannot be used ({error!s:.300})") from error
    if description.coSimulation is None:
        raise ConfigError(f"{path}: a model-exchange FMU; co-simulation is needed (BOPTEST compiles with target='cs')")
    return description


def read_signals(path: Path, description: Any, causality: str) -> dict[str, Signal]:
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
        signals[point.name] = Signal(reference, str(variable.type), point)
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


def _alone(xml: bytes) -> bytes:
    """Return a zip file with only the model description, so that FMPy does not read the whole FMU again."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as small:
        small.writestr(_NAME, xml)
    return buffer.getvalue()
