"""Addresses of results by content: the same inputs to the same source give the same key."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

_PACKAGES = ("thermoforce_mpc", "controllers", "boptest_client")


def content_key(function: Callable[..., Any], inputs: Any, *, source: str | None = None) -> str:
    """Key of `function(inputs)`, 16 hexadecimal digits: hash of its name, its inputs and the code, `source`.

    Raises:
        TypeError: among the inputs is something without a `canonical` form, or `function` has no name of its own.
    """
    name = f"{function.__module__}.{function.__qualname__}"
    if "<" in name:
        raise TypeError(f"{name}: only a function of a module can be executed elsewhere")
    return digest({"function": name, "inputs": canonical(inputs), "source": source or source_fingerprint()})


def digest(content: Mapping[str, Any]) -> str:
    """Hash of JSON `content`, 16 hexadecimal digits, independent of the order of its keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@functools.cache
def source_fingerprint(*others: str) -> str:
    """Hash of the source files, 16 hexadecimal digits; distinguishes working trees of one version.

    `others` are folders beside this package whose code takes part too.
    """
    total = hashlib.sha256()
    root = Path(__file__).resolve().parents[2]
    for package in (*_PACKAGES, *others):
        for path in sorted((root / package).rglob("*.py")):
            total.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return total.hexdigest()[:16]


def canonical(value: Any) -> Any:
    """`value` as JSON in which equal values are equal and different ones differ.

    Dataclasses, pydantic models, arrays, bytes, enumerations, paths (by name), mappings with text keys, sequences and
    plain values have one; raises `TypeError` for others.
    """
    if isinstance(value, Enum):
        return {"enum": _name(value), "value": value.name}
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.hasobject:
            raise TypeError("an array of objects has no content key: give an array of numbers")
        data = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
        return {"array": data, "dtype": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, bytes):
        return {"bytes": hashlib.sha256(value).hexdigest()}
    if isinstance(value, BaseModel):
        return {
            "model": _name(value),
            "fields": {key: canonical(getattr(value, key)) for key in type(value).model_fields},
        }
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {item.name: canonical(getattr(value, item.name)) for item in dataclasses.fields(value)}
        return {"dataclass": _name(value), "fields": fields}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {"mapping": {key: canonical(item) for key, item in value.items()}}
    if isinstance(value, list | tuple):
        return [canonical(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no content key: give plain data")


def _name(value: Any) -> str:
    kind = type(value)
    return f"{kind.__module__}.{kind.__qualname__}"
