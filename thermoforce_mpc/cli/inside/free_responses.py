"""`tf-mpc free-responses`: forecasters of the free response, their backbones and options."""

from __future__ import annotations

import click

from thermoforce_mpc.cli.inside.listing import show_names
from thermoforce_mpc.model.free_response.backbones import loading
from thermoforce_mpc.model.free_response.registry import REGISTRY, options_of
from thermoforce_mpc.scenario.signatures import first_line


@click.command(name="free-responses", short_help="List forecasters of the free response and their options.")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the forecasters of the free response and the backbones, or the options of the free response NAME.

    One is chosen with --set controller.options.free_response.name=NAME, its options with
    --set controller.options.free_response.options.KEY=VALUE, the backbone of `residual` and `chronos` also with
    --backbone: one of those listed, a directory, or a hub name. Those of other distributions stand with their origin
    (docs/how-to/plugins.md).
    """
    if name is None:
        click.echo("Free responses:")
        show_names(REGISTRY, first_line)
        click.echo("\nBackbones of residual and chronos:")
        show_names(loading.REGISTRY, first_line)
        return
    build = REGISTRY.find(name)
    click.echo(f"{name}: {first_line(build)}\n")
    for key, default in options_of(build).items():
        click.echo(f"  controller.options.free_response.options.{key}  (default {default!r})")
