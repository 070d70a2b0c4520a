"""`tf-mpc connections`: names, summaries and options."""

from __future__ import annotations

import click

from thermoforce_mpc.cli.inside.listing import show_names, show_options
from thermoforce_mpc.connections.registry import REGISTRY
from thermoforce_mpc.scenario.signatures import first_line, options_model


@click.command(short_help="List connections to real buildings and their options.")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the connections of `tf-mpc control`, or every option of the connection NAME with its default.

    Options are set with --set connection.KEY=VALUE. Connections of other distributions stand with their origin
    (docs/how-to/connection.md).
    """
    if name is None:
        show_names(REGISTRY, first_line)
        return
    make = REGISTRY.find(name)
    click.echo(f"{name}: {first_line(make)}\n")
    show_options(options_model(make, ()), {}, "connection.")
