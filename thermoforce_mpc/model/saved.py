"""File of a model: a folder with `model.json` and `arrays.safetensors`, without pickle.

The JSON contains the format's name and version, the SHA-256 of the arrays and that of its own content, so that a file
that was damaged or edited is refused. A folder is written to a temporary place and then moved, so that it is either
complete or absent. Values are what they must be: nothing is converted, "false" is no truth and 1.7 no index.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.files import plain_json, read_bounded, read_json, write_folder
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.version import VERSION

# Far beyond any temperature, power or gain, so that products of it are still finite: no overflow.
_LARGEST = 1e12
_WORDS = {bool: "true or false", str: "a text", list: "a list", dict: "an object with keys"}
_OPERATOR_ARRAYS = ("poles", "gains", "hidden_weight", "hidden_bias", "output_weight", "feature_mean", "feature_scale")
_FREE_ARRAYS = ("poles", "weights", "process_K2", "start_K2")
# Fields that files call otherwise.
_IN_FILES = {"u_min": "lowest"}
FORMAT = "thermoforce-mpc thermal model"
FORMAT_VERSION = 10
JSON_NAME = "model.json"
ARRAYS_NAME = "arrays.safetensors"
FILES = (ARRAYS_NAME, JSON_NAME)
# Thirty rooms with all pairs coupled: 0.8 MB of JSON, 2.1 MB of arrays.
_MOST_JSON_BYTES, _MOST_ARRAYS_BYTES = 20_000_000, 100_000_000


def built(kind: Any, value: Any) -> Any:
    """`value` as what the type hint `kind` says: plain types, tuples, mappings, unions with None, and dataclasses.

    Null is NaN where a number is expected. Raises KeyError, TypeError, ValueError or DataError for something else.
    """
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if kind is float:
        return float("nan") if value is None else _number(value)
    if kind is int:
        return _whole(value, -(10**9), 10**9)
    if origin is types.UnionType:
        return None if value is None else built(inside[0], value)
    if origin is tuple:
        items = built(list, value)
        kinds = (inside[0],) * len(items) if inside[-1] is ... else inside
        return tuple(built(one, item) for one, item in zip(kinds, items, strict=True))
    if origin is Mapping:
        return {key: built(inside[1], item) for key, item in _expected(dict, value).items()}
    if dataclasses.is_dataclass(kind):
        return of_fields(kind, value)
    return _expected(kind, value)


def of_fields(kind: Any, value: Any, **known: Any) -> Any:
    """The dataclass `kind` of the object `value`, with the fields `known`; raises as `built`."""
    hints, given = typing.get_type_hints(kind), _expected(dict, value)
    names = [item.name for item in dataclasses.fields(kind) if item.name not in known]
    return kind(**known, **{name: built(hints[name], given[name]) for name in names})


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.60} where a number is expected")
    if not abs(value) <= _LARGEST:
        raise ValueError(f"{value!r:.60} where a number within ±{_LARGEST:g} is expected")
    return float(value)


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{value!r:.60} where a whole number from {low} to {high} is expected")
    return value


def _expected(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"{value!r:.60} where {_WORDS.get(kind, kind)} is expected")
    return value


def encode(
    operator: BuildingOperator,
    power: Sequence[PowerModel | None],
    free: Sequence[RcParameters | None],
    cards: Sequence[ModelCard],
    machines: Sequence[str],
    machine_of: Sequence[int],
    shares: Sequence[float],
    exclusive: Sequence[Sequence[int]],
    floor_area_m2: Sequence[float],
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the parts of a thermal model as values of a JSON document, and its arrays by name."""
    arrays: dict[str, Array] = {}
    pairs = []
    for z, a, pair in operator.each():
        arrays |= {f"pair.{z}.{a}.{name}": getattr(pair, name) for name in _OPERATOR_ARRAYS}
        pairs.append({"zone": z, "actuator": a, **_pair_content(pair)})
    zones = []
    for z, (name, linear, area) in enumerate(zip(operator.zones, free, floor_area_m2, strict=True)):
        free_content = None
        if linear is not None:
            arrays |= {f"zone.{z}.{key}": getattr(linear, key) for key in _FREE_ARRAYS}
            free_content = {"step_s": linear.step_s, "sensor_sd_K": linear.sensor_sd_K}
        zones.append({"name": name, "floor_area_m2": area, "free": free_content})
    content = {
        "zones": zones,
        "actuators": [
            {"name": name, "home": home, "machine": machine, "share": share, "card": dataclasses.asdict(card)}
            for name, home, machine, share, card in zip(
                operator.actuators, operator.home, machine_of, shares, cards, strict=True
            )
        ],
        "machines": [
            {"name": name, "power": None if law is None else dataclasses.asdict(law)}
            for name, law in zip(machines, power, strict=True)
        ],
        "exclusive": [list(group) for group in exclusive],
        "n_trained": operator.n_trained,
        "pairs": pairs,
    }
    return content, arrays


def _pair_content(operator: OperatorParameters) -> dict[str, Any]:
    return {
        "order": operator.order,
        "n_trained": operator.n_trained,
        "output_bias": operator.output_bias,
        "gamma": operator.gamma,
        "sign": operator.sign,
        "step_s": operator.step_s,
        "feedback": operator.feedback,
        "heat_input": {_IN_FILES.get(name, name): v for name, v in dataclasses.asdict(operator.heat_input).items()},
        "time_constants_h": operator.time_constants_h,
        "steady_gains_K": operator.steady_gains_K,
    }


def decode(content: Mapping[str, Any], arrays: Mapping[str, Array]) -> dict[str, Any]:
    """The parts of a thermal model by the arguments of `encode`, from its values after writing and reading.

    Raises KeyError, TypeError, ValueError, AttributeError or DataError for content that was damaged or edited.
    """
    zones, actuators, machines = (built(list, content[key]) for key in ("zones", "actuators", "machines"))
    pairs: list[list[OperatorParameters | None]] = [[None] * len(actuators) for _ in zones]
    for pair in built(list, content["pairs"]):
        z, a = _whole(pair["zone"], 0, len(zones) - 1), _whole(pair["actuator"], 0, len(actuators) - 1)
        pairs[z][a] = _operator(pair, arrays, f"pair.{z}.{a}.")
    operator = BuildingOperator(
        tuple(built(str, zone["name"]) for zone in zones),
        tuple(built(str, actuator["name"]) for actuator in actuators),
        tuple(tuple(row) for row in pairs),
        tuple(_whole(actuator["home"], 0, len(zones) - 1) for actuator in actuators),
    )
    return {
        "operator": operator,
        "power": tuple(built(PowerModel | None, machine["power"]) for machine in machines),
        "free": tuple(_free(zone["free"], arrays, f"zone.{z}.") for z, zone in enumerate(zones)),
        "cards": tuple(built(ModelCard, actuator["card"]) for actuator in actuators),
        "machines": tuple(built(str, machine["name"]) for machine in machines),
        "machine_of": tuple(_whole(actuator["machine"], 0, len(machines) - 1) for actuator in actuators),
        "shares": tuple(_number(actuator["share"]) for actuator in actuators),
        "exclusive": tuple(
            tuple(_whole(a, 0, len(actuators) - 1) for a in built(list, group))
            for group in built(list, content["exclusive"])
        ),
        "floor_area_m2": tuple(built(float, zone["floor_area_m2"]) for zone in zones),
    }


def _operator(data: Mapping[str, Any], arrays: Mapping[str, Array], prefix: str) -> OperatorParameters:
    of_file = _expected(dict, data["heat_input"])
    named = {item.name: of_file[_IN_FILES.get(item.name, item.name)] for item in dataclasses.fields(HeatInput)}
    known = {name: _array(arrays, prefix + name) for name in _OPERATOR_ARRAYS}
    return of_fields(OperatorParameters, {**data, "heat_input": named}, **known)


def _array(arrays: Mapping[str, Array], name: str) -> Array:
    array = arrays[name]
    if array.dtype.kind != "f":
        raise TypeError(f"array {name} holds {array.dtype}, expected numbers")
    return array


def _free(data: Mapping[str, Any] | None, arrays: Mapping[str, Array], prefix: str) -> RcParameters | None:
    if data is None:
        return None
    return of_fields(RcParameters, data, **{name: _array(arrays, prefix + name) for name in _FREE_ARRAYS})


def write_model_file(folder: Path, content: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write `content` and `arrays` to `folder`; equal input gives equal bytes. Raises `StorageError`."""
    raw = save_tensors({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    head = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "code_version": VERSION,
        "arrays_sha256": hashlib.sha256(raw).hexdigest(),
    }
    document = plain_json(head | dict(content) | head)
    text = json.dumps(document | {"sha256": content_sha256(document)}, indent=2, allow_nan=False) + "\n"
    write_folder(folder, {ARRAYS_NAME: raw, JSON_NAME: text.encode()})


def read_model_file(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the content and the arrays of a saved model.

    Raises `ArtifactError`, with the file, for what is missing, damaged, not a model or of another version.
    """
    path = folder / JSON_NAME
    content = _read_json(folder)
    if content.get("version") != FORMAT_VERSION:
        wrote = content.get("code_version")
        raise ArtifactError(
            f"{path}: format version {content.get('version')!r:.20}, this release reads {FORMAT_VERSION}; identify "
            "again from the same data"
            + ("" if wrote == VERSION else f", or use thermoforce-mpc {wrote!s:.20}, which wrote it")
        )
    if content_sha256(content) != content.get("sha256"):
        raise ArtifactError(f"{path}: damaged or edited, its content has another sha256 than it says; identify again")
    return content, _read_arrays(folder, content)


def _read_arrays(folder: Path, content: Mapping[str, Any]) -> dict[str, Array]:
    arrays_path = folder / ARRAYS_NAME
    raw = read_bounded(arrays_path, _MOST_ARRAYS_BYTES, ArtifactError)
    digest = hashlib.sha256(raw).hexdigest()
    if digest != content.get("arrays_sha256"):
        raise ArtifactError(f"{arrays_path}: damaged or swapped, its sha256 is not the one in {JSON_NAME}")
    try:
        return load_tensors(raw)
    except (SafetensorError, ValueError, TypeError, KeyError) as error:  # the last two: a type that numpy lacks
        raise ArtifactError(f"{arrays_path}: not a readable safetensors file ({error})") from error


def _read_json(folder: Path) -> dict[str, Any]:
    path = folder / JSON_NAME
    if folder.is_file():
        raise ArtifactError(f"{folder}: a file; give the folder that `tf-mpc identify` wrote")
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; `tf-mpc identify` makes one")
    if not path.exists():
        raise ArtifactError(f"{folder}: holds no model, {JSON_NAME} is not there; `tf-mpc identify` makes one")
    document = read_json(path, _MOST_JSON_BYTES, ArtifactError)
    if document.get("format") != FORMAT:
        raise ArtifactError(f"{path}: not a model of thermoforce-mpc (its 'format' is not '{FORMAT}')")
    return document


def content_sha256(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a model's JSON document, layout and the entry `sha256` left aside."""
    content = {key: value for key, value in document.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
