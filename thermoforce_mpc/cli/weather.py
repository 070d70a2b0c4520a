"""`tf-mpc weather fetch`: the test case's own weather, for users who have a network."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import click


@click.group(short_help="Get the weather of the real test case.")
def command() -> None:
    """Weather for the emulator. Without a file it runs in a synthetic year, which is no place."""


@command.command("fetch")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder to keep it in.  [default: the user's cache folder]"
)
@click.option("--url", metavar="URL", help="Another copy of the same file, such as a mirror's.")
def fetch_command(out: Path | None, url: str | None) -> None:
    """Get BOPTEST's Brussels year (IWEC, by ASHRAE: for your own use) and print where it is.

    It is downloaded once, checked by its values against the pinned fingerprint, and kept; a later call needs no
    network.

    \b
    Example:
      tf-mpc run --testcase bestest_hydronic_heat_pump --weather "$(tf-mpc weather fetch)"
    """
    from thermoforce_mpc.boundary.weather.fetch import URL, fetch_brussels

    path = fetch_brussels(out or cache_folder(), url or URL)
    click.echo(str(path))
    click.echo(f"Use it with --weather {shlex.quote(str(path))}", err=True)


def cache_folder() -> Path:
    """Where downloads are kept: `$XDG_CACHE_HOME/thermoforce-mpc`, by default in `~/.cache`."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "thermoforce-mpc"
