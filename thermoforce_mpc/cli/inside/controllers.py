"""`tf-mpc controllers`: names, summaries and options."""

from __future__ import annotations

import click

from controllers.registry import REGISTRY, find_entry
from thermoforce_mpc.cli.inside.listing import show_names, show_options


@click.command(short_help="List controllers and their options.")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the controllers, or every option of the controller NAME with its default and unit.

    Options are set with --set controller.options.KEY=VALUE or in a scenario file. Controllers of other distributions
    stand with their origin (docs/how-to/plugins.md).
    """
    if name is None:
        show_names(REGISTRY, lambda entry: entry.summary)
        click.echo("\n`tf-mpc controllers NAME` lists the options of a controller.")
        return
    entry = find_entry(name)
    click.echo(f"{name}: {entry.summary}\n")
    show_options(entry.config(), dict(entry.defaults), "controller.options.")
