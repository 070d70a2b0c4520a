"""Which options of a controller may name a file or folder: free text, but no name of a registry, choice or default."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, WithJsonSchema

from controllers.registry import find_entry
from thermoforce_mpc.model.free_response.registry import may_be_file

Change = Callable[[str], str]


def with_files(controller: str, options: Mapping[str, Any], change: Change) -> dict[str, Any]:
    """Options of a controller with `change` applied to each text that may name a file or folder.

    Raises:
        ConfigError: there is no such controller or free response.
    """
    return _change_model(find_entry(controller).config(), options, change)


def _change_model(model: type[BaseModel], values: Mapping[str, Any], change: Change) -> dict[str, Any]:
    return {key: _change_field(model, key, values, change) for key in values}


def _change_field(model: type[BaseModel], key: str, values: Mapping[str, Any], change: Change) -> Any:
    field, value = model.model_fields.get(key), values[key]
    # `one_of` marks a name of a registry.
    if field is None or value == field.default or any(isinstance(mark, WithJsonSchema) for mark in field.metadata):
        return value
    if key == "options" and _is_free_response(model):
        name = values.get("name") or model.model_fields["name"].default
        return {option: change(v) if may_be_file(name, option, v) else v for option, v in value.items()}
    return _change_value(field.annotation, value, change)


def _is_free_response(model: type[BaseModel]) -> bool:
    from controllers.mpc.config import FreeResponseConfig  # with what plans need

    return issubclass(model, FreeResponseConfig)


def _change_value(kind: Any, value: Any, change: Change) -> Any:
    """`value` of a field annotated as `kind`; a `Literal` or enum is no text."""
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        return _change_value(inner[0], value, change)
    if get_origin(kind) in (Union, UnionType):
        for member in inner:
            value = _change_value(member, value, change)
        return value
    if kind in (str, Path, Any) and isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return _change_model(kind, value, change)
        of = inner[1] if len(inner) == 2 else Any if kind in (Any, dict) else None
        return {key: _change_value(of, item, change) for key, item in value.items()} if of else value
    if isinstance(value, list | tuple):
        of = inner[0] if inner else Any if kind in (Any, list, tuple) else None
        return [_change_value(of, item, change) for item in value] if of else value
    return value
