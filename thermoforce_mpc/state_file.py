"""File of a controller's state: dataclasses, named tuples and enumerations of this package, plain values and arrays.

An .npz file without pickles: the arrays, and a JSON text that says where they stand. Reading it builds classes of this
package by their constructors and runs nothing else.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
from enum import Enum
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import read_bounded, write_whole

_PACKAGES = ("thermoforce_mpc", "controllers")
_MOST_BYTES = 200_000_000
_TEXT = "structure"


def write_state(path: Path, value: object) -> None:
    """Write `value` to `path`, whole or not at all.

    Raises:
        TypeError: it holds what is neither plain nor of this package.
        StorageError: the file cannot be written.
    """
    arrays: dict[int, np.ndarray[Any, Any]] = {}
    text = json.dumps(_plain(value, arrays), allow_nan=False)
    members: dict[str, Any] = {_TEXT: np.frombuffer(text.encode(), np.uint8)}
    members |= {f"a{number}": array for number, array in arrays.items()}
    content = BytesIO()
    np.savez(content, **members)
    write_whole(path, content.getvalue())


def read_state(path: Path) -> Any:
    """What `write_state` wrote to `path`.

    Raises:
        InputError: there is no such file, it is damaged, or of another version of this package.
    """
    content = read_bounded(path, _MOST_BYTES, InputError)
    try:
        with np.load(BytesIO(content), allow_pickle=False) as stored:
            return _built(json.loads(bytes(stored[_TEXT])), stored)
    except Exception as error:  # of a damaged archive, of other classes, of what their constructors refuse
        raise InputError(f"{path}: no state of this version ({type(error).__name__}: {str(error)[:200]})") from error


def _plain(value: Any, arrays: dict[int, np.ndarray[Any, Any]]) -> Any:
    """`value` as JSON values; its arrays go into `arrays` by `id`, one that stands in several places once."""
    if isinstance(value, Enum):
        return {"enum": _name(value), "member": value.name}
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, np.generic):
        return _plain(value.item(), arrays)
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        arrays[id(value)] = value
        return {"array": id(value)}
    fields = _fields(value)
    if fields is not None:
        return {"is": _name(value), "of": {name: _plain(getattr(value, name), arrays) for name in fields}}
    if isinstance(value, list | tuple):
        return {type(value).__name__: [_plain(item, arrays) for item in value]}
    if isinstance(value, dict):
        return {"dict": [[_plain(key, arrays), _plain(item, arrays)] for key, item in value.items()]}
    raise TypeError(f"a {type(value).__name__} cannot be kept")


def _fields(value: Any) -> list[str] | None:
    """What the constructor of a dataclass or named tuple takes; None for anything else."""
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value) if field.init]
    return list(value._fields) if isinstance(value, tuple) and hasattr(value, "_fields") else None


def _name(value: Any) -> str:
    """The name that `_class` finds the class of `value` by; raises `TypeError` for one of another package."""
    module, path = type(value).__module__, type(value).__qualname__
    if not _is_ours(module):
        raise TypeError(f"a {module}.{path} cannot be kept")
    return f"{module}:{path}"


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in _PACKAGES


def _built(content: Any, arrays: Any) -> Any:
    """The value of `_plain`."""
    if not isinstance(content, dict):
        return content
    match content:
        case {"float": text}:
            return float(text)
        case {"array": number}:
            return arrays[f"a{number}"]
        case {"list": items}:
            return [_built(item, arrays) for item in items]
        case {"tuple": items}:
            return tuple(_built(item, arrays) for item in items)
        case {"dict": items}:
            return {_built(key, arrays): _built(item, arrays) for key, item in items}
        case {"enum": name, "member": member}:
            return _class(name, Enum)[member]
        case {"is": name, "of": fields}:
            return _class(name)(**{key: _built(item, arrays) for key, item in fields.items()})
    raise ValueError(f"{sorted(content)} is nothing that is kept")


def _class(name: str, kind: type | None = None) -> Any:
    """The class of a name, one of this package that holds values."""
    module, _, path = name.partition(":")
    if not _is_ours(module):
        raise ValueError(f"{name} is not of this package")
    found = getattr(importlib.import_module(module), path)
    holds = issubclass(found, kind) if kind else dataclasses.is_dataclass(found) or issubclass(found, tuple)
    if not holds:
        raise ValueError(f"{name} holds no values")
    return found
