"""Base class of everything that users configure: what cannot be right is refused where it enters."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from thermoforce_mpc.files import odd_number

# Largest magnitude by the unit at the end of a key: far beyond any building, but finite. Temperatures in °C also have a
# least value; no key is in kelvin.
_MOST = {
    "_C": 200.0, "_K": 500.0, "_h": 24.0 * 366, "_hours": 24.0 * 366, "_s": 366 * 86400.0, "_days": 3660.0,
    "days": 3660.0, "_steps": 1e6, "_m2": 1e7, "_W": 1e9, "_kW": 1e6,
}  # fmt: skip
_LEAST = {"_C": -100.0}
_SHOWN = {"_C": "°C", "_m2": "m²"}
_MOST_ANY = 1e12
_NO_NUMBER = "expected a number, not true or false (nor yes, no, on, off)"
# BOPTEST's names are those of Modelica variables, with the zone in brackets; EnergyPlus' are words.
_POINT = re.compile(r"[A-Za-z_][\w.:/-]*( [\w.:/-]+)*(\[[\w .:,-]+\][\w.]*)*")


def _possible_point(name: str) -> str:
    if not _POINT.fullmatch(name) or len(name) > 200:
        raise ValueError(
            "no point has this name: letters, digits, _ . : / - and single spaces, an index in [ ], a letter first"
        )
    return name


PointName = Annotated[str, AfterValidator(_possible_point)]
"""Name of a point at the plant's interface."""


def _no_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(_NO_NUMBER)
    return value


Factor = Annotated[float, BeforeValidator(_no_truth_value), Field(ge=-1e6, le=1e6)]
"""Factor of a point in a sum."""


def one_of(*usual: str) -> WithJsonSchema:
    """The JSON Schema of a name that is one of the `usual` ones, or a plugin's."""
    return WithJsonSchema({"anyOf": [{"enum": list(usual)}, {"type": "string"}]})


class StrictModel(BaseModel):
    """Base class of all configuration models; values are immutable.

    Refused: unknown keys, NaN and infinity, true and false where a number is meant, text that only Python takes for one
    (1_0), and numbers that no building can have, by the unit that a key's name ends with. A class variable is a
    constant: files that name it with its own value are read, another value is refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _constants_are_no_options(cls, data: Any) -> Any:
        named = cls.__class_vars__ & data.keys() if isinstance(data, Mapping) else set()
        for key in named:
            constant, value = getattr(cls, key), data[key]
            same = constant.model_dump().items() >= value.items() if _is_model(constant, value) else value == constant
            if not same:
                shown = "what it is" if _is_model(constant, value) else f"{constant}"
                raise ValueError(f"{key} is no option any more: it stays {shown}; leave the key out")
        return {key: value for key, value in data.items() if key not in named} if named else data

    @field_validator("*", mode="before")
    @classmethod
    def _numbers_are_no_truth_values(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        if _takes_numbers_only(cls, name):
            for one in _leaves(value):
                if isinstance(one, bool):
                    raise ValueError(_NO_NUMBER)
                if isinstance(one, str) and not _may_be_text(cls, name) and odd_number(one):
                    raise ValueError(f"{one!r:.60} is not a number")
        return value

    @field_validator("*", mode="after")
    @classmethod
    def _numbers_are_possible(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        if not _takes_numbers_only(cls, name):
            return value
        unit = max((unit for unit in _MOST if name.endswith(unit)), key=len, default="")
        most = _MOST.get(unit, _MOST_ANY)
        least = _LEAST.get(unit, -most)
        for one in _leaves(value):
            if isinstance(one, int | float) and not least <= one <= most:
                in_unit = f" {_SHOWN.get(unit, unit.removeprefix('_'))}" if unit else ""
                raise ValueError(f"no building has {one:g}; expected {least:g} to {most:g}{in_unit}")
        return value


def _is_model(constant: Any, value: Any) -> bool:
    return isinstance(constant, BaseModel) and isinstance(value, Mapping)


@functools.cache
def _takes_numbers_only(model: type[BaseModel], name: str) -> bool:
    """Whether the values of a field are numbers (and text), alone or in lists and mappings."""
    kinds = set(_kinds(model.model_fields[name].annotation))
    others = bool in kinds or Any in kinds or object in kinds
    nested = any(isinstance(kind, type) and issubclass(kind, BaseModel) for kind in kinds)
    return bool(kinds & {int, float}) and not others and not nested


@functools.cache
def _may_be_text(model: type[BaseModel], name: str) -> bool:
    """Whether a value of the field may be any text, such as the name of a column."""
    annotation = model.model_fields[name].annotation
    return str in _kinds(annotation) and get_origin(annotation) is not dict


def _kinds(annotation: Any) -> Iterator[Any]:
    below = get_args(annotation)
    if below:
        for one in below:
            yield from _kinds(one)
    elif isinstance(annotation, type) or annotation is Any:
        yield annotation


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple | set | frozenset):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def check_range(minimum: float, maximum: float, unit: str) -> None:
    """Raise `ValueError` unless the ends of a range are in order, and in K temperatures of a building, not in °C."""
    if not minimum < maximum:
        raise ValueError(f"minimum ({minimum}) must be below maximum ({maximum})")
    for name, value in {"minimum": minimum, "maximum": maximum}.items():
        if unit == "K" and not 200.0 <= value <= 500.0:
            raise ValueError(f"{name} is {value:g} K; in unit K a temperature is between 200 and 500 (20 °C is 293.15)")
