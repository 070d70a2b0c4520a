"""`tf-mpc plants`: names, summaries and options."""

from __future__ import annotations

import click

from thermoforce_mpc.cli.inside.listing import show_names, show_options
from thermoforce_mpc.plants.registry import REGISTRY


@click.command(short_help="List plants and their options.")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the plants, or every option of the plant NAME with its default and unit.

    A test case names the plant that implements it; --url and --fmu choose another, and --set plant.kind=NAME a
    plugin's. Options are set with --set plant.options.KEY=VALUE or in a scenario file. Plants of other distributions
    stand with their origin (docs/how-to/plugins.md).
    """
    if name is None:
        show_names(REGISTRY, lambda entry: entry.summary)
        return
    entry = REGISTRY.find(name)
    click.echo(f"{name}: {entry.summary}\n")
    show_options(entry.config(), {}, "plant.options.")
