"""Names of zones, actuators and machines, and arrays with an axis of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from thermoforce_mpc.data.clock import Array
from thermoforce_mpc.errors import DataError, InputError

# The first axis of each signal that has one: zones, actuators or machines.
AXIS = {
    **dict.fromkeys(("T_zone_C", "occupancy", "lower_C", "upper_C", "slack_K", "T_free_now_C"), "zones"),
    **dict.fromkeys(("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "T_low_C", "T_high_C"), "zones"),
    **dict.fromkeys(("u", "heat_W"), "actuators"),
    **dict.fromkeys(("power_W", "T_return_C", "price_per_kWh", "heating_price_per_kWh"), "machines"),
    "emission_kg_per_kWh": "machines",
}


@dataclass(frozen=True)
class Names:
    """Names of the zones (Z), actuators (A) and machines (M) of a building; `DataError` for none, one twice,
    or an empty one.
    """

    zones: tuple[str, ...] = ("zone",)
    actuators: tuple[str, ...] = ("actuator",)
    machines: tuple[str, ...] = ("machine",)

    def __post_init__(self) -> None:
        for kind in ("zones", "actuators", "machines"):
            names = tuple(getattr(self, kind))
            if not names or len(set(names)) != len(names):
                raise DataError(f"{kind} are {list(names)}: expected one name or more, each once")
            if not all(name.strip() for name in names):
                raise DataError(f"{kind} are {list(names)}: one has no name")
            object.__setattr__(self, kind, names)

    @property
    def single(self) -> bool:
        """Whether there is one zone, one actuator and one machine."""
        return len(self.zones) == len(self.actuators) == len(self.machines) == 1

    def label(self, signal: str, row: int) -> str:
        """Name of a row of a signal for people: 'T_zone_C' of one zone, 'T_zone_C[bath]' of several."""
        names = getattr(self, AXIS[signal])
        return signal if len(names) == 1 else f"{signal}[{names[row]}]"

    def of_actuator(self, a: int, text: str) -> str:
        """`text`, with the actuator's name before it where there are several."""
        return text if len(self.actuators) == 1 else f"{self.actuators[a]}: {text}"

    def of_actuators(self, told: Mapping[int, str]) -> list[str]:
        """The texts of actuators by number, each once; with the names that it is of where there are several."""
        same: dict[str, list[str]] = {}
        for a, text in told.items():
            same.setdefault(text, []).append(self.actuators[a])
        return list(same) if len(self.actuators) == 1 else [f"{', '.join(of)}: {text}" for text, of in same.items()]

    def columns(self, **signals: Array) -> dict[str, Array]:
        """The rows of `signals` (rows, n) by `label`, as columns of a table."""
        return {self.label(name, row): values for name, rows in signals.items() for row, values in enumerate(rows)}

    def rows(self, signal: str) -> int:
        """Number of rows of a signal: of its zones, actuators or machines."""
        return len(getattr(self, AXIS[signal]))


SINGLE = Names()
"""One zone with one actuator and one machine."""


def check_same_building(
    what: str, names: Names, of: str, others: Names, *, single_alike: bool = False, error: type[InputError] = DataError
) -> None:
    """Raise `error` where two things (`what` and `of` in words) are not of the same zones, actuators and machines.

    With `single_alike`, buildings of one zone with one actuator and one machine are the same, whatever their names.
    """
    if names != others and not (single_alike and names.single and others.single):
        unlike = [kind for kind in ("zones", "actuators", "machines") if getattr(names, kind) != getattr(others, kind)]
        ours, theirs = (
            " and ".join(f"{kind} {', '.join(getattr(one, kind))}" for kind in unlike) for one in (names, others)
        )
        raise error(f"{what} is of {ours}, {of} of {theirs}: another building?")


def frozen(value: object, name: str, length: int, names: Names) -> Array:
    """An array (length,) or, with an axis of its own, (rows, length); raises `DataError` for another shape."""
    array = value if _unchangeable(value) else np.array(value, dtype=np.float64)
    expected: tuple[int, ...] = (length,)
    if name in AXIS:
        rows = names.rows(name)
        expected = (rows, length)
        if rows == 1 and array.shape == (length,):
            array = array[None]
    if array.shape != expected:
        raise DataError(f"{name} has shape {array.shape}, expected {expected}")
    array.setflags(write=False)
    return array


def numbers(values: object, what: str) -> Array:
    """`values` as an array; raises `DataError` where they hold what is no number, or rows of several lengths."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise DataError(f"{what}: {error}: expected a number, or an array of numbers") from error


def _unchangeable(value: object) -> TypeGuard[Array]:
    """Whether nobody can change `value`, an array, any more: it need not be copied."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.flags.writeable:
        return False
    return value.base is None or (isinstance(value.base, np.ndarray) and not value.base.flags.writeable)


def of_each(value: object, name: str, names: Names) -> Array:
    """Values (rows,) of one instant; a number where there is one row. Raises `DataError` for another shape."""
    array = value if _unchangeable(value) and value.ndim else np.array(value, dtype=np.float64, ndmin=1)
    rows = names.rows(name)
    if array.shape != (rows,):
        raise DataError(f"{name} has shape {array.shape}, expected ({rows},)")
    array.setflags(write=False)
    return array
