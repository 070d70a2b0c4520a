"""Values of a saved document as what they must be: nothing is converted, "false" is no truth and 1.7 no index."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Far beyond any temperature, power or gain, but products of it are still finite.
_LARGEST = 1e12


def number(value: Any) -> float:
    """Return a number; raises `TypeError` or `ValueError` for anything else, and beyond ±1e12."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.60} where a number is expected")
    if not abs(value) <= _LARGEST:
        raise ValueError(f"{value!r:.60} where a number within ±{_LARGEST:g} is expected")
    return float(value)


def number_or_nan(value: Any) -> float:
    """Return a number, NaN for None; raises as `number`."""
    return float("nan") if value is None else number(value)


def whole(value: Any, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`; raises `ValueError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{value!r:.60} where a whole number from {low} to {high} is expected")
    return value


def truth(value: Any) -> bool:
    """Return true or false; raises `TypeError` for anything else."""
    if not isinstance(value, bool):
        raise TypeError(f"{value!r:.60} where true or false is expected")
    return value


def text(value: Any) -> str:
    """Return a text; raises `TypeError` for anything else."""
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.60} where a text is expected")
    return value


def listed(value: Any) -> list[Any]:
    """Return a list; raises `TypeError` for anything else."""
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.60} where a list is expected")
    return value


def keyed(value: Any) -> Mapping[str, Any]:
    """Return an object with keys; raises `TypeError` for anything else."""
    if not isinstance(value, dict):
        raise TypeError(f"{value!r:.60} where an object with keys is expected")
    return value
