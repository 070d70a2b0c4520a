"""Values of a saved document as what they must be: nothing is converted, "false" is no truth and 1.7 no index."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any

# Far beyond any temperature, power or gain, but products of it are still finite.
_LARGEST = 1e12


def built(kind: Any, value: Any) -> Any:
    """`value` as what the type hint `kind` says: plain types, tuples, mappings, unions with None, and dataclasses.

    Null is NaN where a number is expected.

    Raises:
        KeyError, TypeError, ValueError, DataError: it is something else.
    """
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if kind is float:
        return float("nan") if value is None else number(value)
    if kind is int:
        return whole(value, -(10**9), 10**9)
    if origin is types.UnionType:
        return None if value is None else built(inside[0], value)
    if origin is tuple:
        items = listed(value)
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


def number(value: Any) -> float:
    """A number; raises `TypeError` or `ValueError` for anything else, and beyond ±1e12."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.60} where a number is expected")
    if not abs(value) <= _LARGEST:
        raise ValueError(f"{value!r:.60} where a number within ±{_LARGEST:g} is expected")
    return float(value)


def whole(value: Any, low: int, high: int) -> int:
    """A whole number from `low` to `high`; raises `ValueError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{value!r:.60} where a whole number from {low} to {high} is expected")
    return value


def text(value: Any) -> str:
    """A text; raises `TypeError` for anything else."""
    return str(_expected(str, value))


def listed(value: Any) -> list[Any]:
    """A list; raises `TypeError` for anything else."""
    return list(_expected(list, value))


_WORDS = {bool: "true or false", str: "a text", list: "a list", dict: "an object with keys"}


def _expected(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"{value!r:.60} where {_WORDS.get(kind, kind)} is expected")
    return value
