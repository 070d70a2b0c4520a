"""`tf-mpc migrate MODEL`: a saved model of an older release, rewritten for this one."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write to; must not exist.")
def command(model: Path, out: Path) -> None:
    """Read the saved MODEL (a folder) of an older file format, prove its certificate again, and write it in today's.

    MODEL stays as it is. What was identified does not change: the new model predicts as the old one did. Formats before
    version 4 have no hash of their content, so look at the result with `tf-mpc inspect` before you trust it. A model
    with a machine that feeds several actuators has to be identified again.

    \b
    Example:
      tf-mpc migrate my_house --out my_house_new
    """
    from thermoforce_mpc.model.migration import migrate_model

    migrated = migrate_model(model, out)
    click.echo(f"{out}: {migrated.names}; identified from {migrated.cards[0].source}")
