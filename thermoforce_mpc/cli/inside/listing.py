"""Lists of what is registered by name, with its origin and its options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from thermoforce_mpc.registry import OWN, Registry

T = TypeVar("T")


def show_names(registry: Registry[T], summary: Callable[[T], str]) -> None:
    """Print each name with its summary; under that of a plugin where it comes from, and why it cannot be used."""
    for entry in registry.listing():
        click.echo(f"{entry.name:18s} {'cannot be used' if entry.found is None else summary(entry.found)}".rstrip())
        if entry.origin != OWN:
            click.echo(f"{'':18s} from {entry.origin}")
        if entry.problem:
            click.echo(f"{'':18s} {entry.problem}")


def show_options(model: type[BaseModel], defaults: Mapping[str, Any], prefix: str) -> None:
    """Print every option with its default and meaning, those of nested models by their full name."""
    for key, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True)
        if isinstance(default, BaseModel):
            show_options(type(default), defaults.get(key, {}), f"{prefix}{key}.")
            continue
        value = defaults.get(key, default)
        shown = "required" if value is PydanticUndefined else f"default {_as_written(value)!r}"
        click.echo(f"  {prefix}{key}  ({shown})" + (f"\n      {field.description}" if field.description else ""))


def _as_written(value: Any) -> Any:
    """A default as it is set: of a path its text."""
    return str(value) if isinstance(value, Path) else value
