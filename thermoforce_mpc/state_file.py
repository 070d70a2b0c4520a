"""File of a controller's state: dataclasses, named tuples and enumerations by name, plain values and arrays.

An .npz file without pickles: the arrays, and a JSON text that says where they stand. Reading it builds the classes of a
closed table by their constructors, of values of the types that their fields are declared with; nothing that a file
names is imported.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
import zipfile
from collections.abc import Iterable, Mapping
from enum import Enum
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import read_bounded, write_whole

_MOST_BYTES = 200_000_000
_TEXT = "structure"


class StateFormat:
    """Format of state files that may hold these `classes` (dataclasses, named tuples, enumerations) by their names."""

    def __init__(self, classes: Iterable[type[Any]]) -> None:
        self._by_name = {of.__name__: of for of in classes}

    def write(self, path: Path, value: object) -> None:
        """Write `value` to `path`; raises `StorageError`, and `TypeError` for what is of no class of the table."""
        arrays: dict[int, np.ndarray[Any, Any]] = {}
        text = json.dumps(self._plain(value, arrays), allow_nan=False)
        members: dict[str, Any] = {_TEXT: np.frombuffer(text.encode(), np.uint8)}
        members |= {f"a{number}": array for number, array in arrays.items()}
        content = BytesIO()
        np.savez(content, **members)
        write_whole(path, content.getvalue())

    def read(self, path: Path) -> Any:
        """What `write` wrote to `path`; raises `InputError` for a file that is damaged or of another version."""
        content = read_bounded(path, _MOST_BYTES, InputError)
        try:
            with zipfile.ZipFile(BytesIO(content)) as archive:
                unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > _MOST_BYTES:
                raise ValueError(f"{unpacked:,} bytes when unpacked, at most {_MOST_BYTES:,} are read")
            with np.load(BytesIO(content), allow_pickle=False) as stored:
                return self._built(json.loads(bytes(stored[_TEXT])), stored)
        except Exception as error:  # of a damaged archive, of other classes, of what their constructors refuse
            raise InputError(
                f"{path}: no state of this version ({type(error).__name__}: {str(error)[:200]})"
            ) from error

    def _plain(self, value: Any, arrays: dict[int, np.ndarray[Any, Any]]) -> Any:
        """`value` as JSON values; its arrays go into `arrays` by `id`, one that stands in several places once."""
        if isinstance(value, Enum):
            return {"enum": self._name(value), "member": value.name}
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return float(value) if math.isfinite(value) else {"float": repr(float(value))}
        if isinstance(value, np.generic):
            return self._plain(value.item(), arrays)
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError("an array of objects cannot be kept")
            arrays[id(value)] = value
            return {"array": id(value)}
        fields = _fields(value)
        if fields is not None:
            of = {name: self._plain(getattr(value, name), arrays) for name in fields}
            return {"is": self._name(value), "of": of}
        if isinstance(value, list | tuple):
            return {type(value).__name__: [self._plain(item, arrays) for item in value]}
        if isinstance(value, dict):
            return {"dict": [[self._plain(key, arrays), self._plain(item, arrays)] for key, item in value.items()]}
        raise TypeError(f"a {type(value).__name__} cannot be kept")

    def _name(self, value: Any) -> str:
        kind = type(value)
        if self._by_name.get(kind.__name__) is not kind:
            raise TypeError(f"a {kind.__module__}.{kind.__qualname__} cannot be kept")
        return kind.__name__

    def _built(self, content: Any, arrays: Any) -> Any:
        if not isinstance(content, dict):
            return content
        match content:
            case {"float": text}:
                return float(text)
            case {"array": number}:
                return arrays[f"a{number}"]
            case {"list": items}:
                return [self._built(item, arrays) for item in items]
            case {"tuple": items}:
                return tuple(self._built(item, arrays) for item in items)
            case {"dict": items}:
                return {self._built(key, arrays): self._built(item, arrays) for key, item in items}
            case {"enum": name, "member": member}:
                return self._of(name)[member]
            case {"is": name, "of": fields}:
                kind, of = self._of(name), {key: self._built(item, arrays) for key, item in fields.items()}
                for key, declared in _declared(kind).items():
                    if key in of and not _fits(of[key], declared):
                        raise ValueError(f"{name}.{key} is a {type(of[key]).__name__}, not as it is declared")
                return kind(**of)
        raise ValueError(f"{sorted(content)} is nothing that is kept")

    def _of(self, name: str) -> Any:
        if name not in self._by_name:
            raise ValueError(f"'{name}' is no class that is kept")
        return self._by_name[name]


@cache
def _declared(kind: type[Any]) -> dict[str, Any]:
    """Types that the fields of a class are declared with, by name."""
    return typing.get_type_hints(kind)


def _fits(value: Any, declared: Any) -> bool:
    """Whether a value is of a declared type: a class, a union, a tuple, list or mapping of these, words; else any."""
    of, inside = typing.get_origin(declared), typing.get_args(declared)
    if of in (typing.Union, types.UnionType):
        return any(_fits(value, one) for one in inside)
    if of is typing.Literal:
        return value in inside
    if of is tuple:
        alike = inside[1:] == (...,)
        right = isinstance(value, tuple) and (alike or len(value) == len(inside))
        return right and all(_fits(item, inside[0 if alike else k]) for k, item in enumerate(value))
    if isinstance(of, type) and issubclass(of, Mapping):
        right = isinstance(value, Mapping)
        return right and all(_fits(key, inside[0]) and _fits(item, inside[1]) for key, item in value.items())
    if of is list:
        return isinstance(value, list) and all(_fits(item, inside[0]) for item in value)
    kind = of or declared
    if kind is Any or not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True
    if kind in (float, int):  # a truth value is no number, and every number of a float may be whole
        return isinstance(value, int | float if kind is float else int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _fields(value: Any) -> list[str] | None:
    """What the constructor of a dataclass or named tuple takes; None for anything else."""
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value) if field.init]
    return list(value._fields) if isinstance(value, tuple) and hasattr(value, "_fields") else None
