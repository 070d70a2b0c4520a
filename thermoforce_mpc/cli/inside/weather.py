"""`tf-mpc weather fetch`: download the weather file of the BOPTEST test case."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from thermoforce_mpc.data.cache_folder import cache_folder


@click.group()
def command() -> None:
    """Weather files for the emulator. Without a file it uses a synthetic year that represents no real place."""


@command.command("fetch")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the file.  [default: the user's cache folder]")
@click.option("--url", metavar="URL", help="URL of another copy of the file, such as a mirror.")
def fetch_command(out: Path | None, url: str | None) -> None:
    """Download BOPTEST's Brussels weather year (IWEC, by ASHRAE: for your own use) and print its path.

    The file is downloaded once, its values are checked against a pinned fingerprint, and it is cached; later calls
    need no network.

    \b
    Example:
      tf-mpc run --testcase bestest_hydronic_heat_pump --weather "$(tf-mpc weather fetch)"
    """
    from thermoforce_mpc.boundary.weather.fetch import URL, fetch_brussels

    path = fetch_brussels(out or cache_folder(), url or URL)
    click.echo(str(path))
    click.echo(f"Use it with --weather {shlex.quote(str(path))}", err=True)
