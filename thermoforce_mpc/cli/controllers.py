"""`tf-mpc controllers`: names, summaries and options."""

from __future__ import annotations

from typing import Any

import click
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from controllers.registry import REGISTRY, find_entry


@click.command(short_help="List controllers and their options.")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the controllers, or every option of the controller NAME with its default and unit.

    Options are set with --set controller.options.KEY=VALUE or in a scenario file.
    """
    if name is None:
        for known, entry in REGISTRY.items():
            click.echo(f"{known:18s} {entry.summary}")
        click.echo("\n`tf-mpc controllers NAME` lists the options of a controller.")
        return
    entry = find_entry(name)
    click.echo(f"{name}: {entry.summary}\n")
    _describe(entry.config(), dict(entry.defaults), "controller.options.")


def _describe(model: type[BaseModel], defaults: dict[str, Any], prefix: str) -> None:
    for key, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True)
        if isinstance(default, BaseModel):
            _describe(type(default), defaults.get(key, {}), f"{prefix}{key}.")
            continue
        value = defaults.get(key, default)
        shown = "required" if value is PydanticUndefined else f"default {value!r}"
        click.echo(f"  {prefix}{key}  ({shown})\n      {field.description or ''}")
