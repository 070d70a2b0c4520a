"""`tf-mpc ask`: other bounds for a while, away, warmer now."""

from __future__ import annotations

from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import click

from thermoforce_mpc.cli.options import PATH
from thermoforce_mpc.errors import ConfigError


@click.command()
@click.argument("key", metavar="lower|upper|away|boost|comfort|mode")
@click.argument("value")
@click.option("--out", type=PATH, default=Path("control"), help="Folder of the controller that is asked.")
@click.option("--zone", help="Time zone of a time without an offset.  [default: UTC]")
def ask(key: str, value: str, out: Path, zone: str | None) -> None:
    """Ask a running `tf-mpc control` for something, from its next step on: VALUE, or off.

    lower, upper: comfort bound of all zones, °C, for 12 h. away: until a time, within 16 to 28 °C; it is warm again
    then. boost: 2 K warmer for so many minutes. comfort off: the bounds of the map again. mode: of a controller that
    sets the building, advise gives it back and plans on, control sets it again.

    \b
    Examples:
      tf-mpc ask lower 21
      tf-mpc ask away 2026-12-27T18:00 --zone Europe/Berlin
      tf-mpc ask boost 90
    """
    import pandas as pd

    from thermoforce_mpc.live import People
    from thermoforce_mpc.records.journal import NAME
    from thermoforce_mpc.records.people import KEYS
    from thermoforce_mpc.records.run_folder import LOCK, in_use

    if key not in KEYS:
        raise ConfigError(f"{key!r} cannot be asked; there are {', '.join(KEYS)}")
    if not ((out / NAME).exists() or (out / LOCK).exists()):
        what = "no controller writes or wrote to it" if out.is_dir() else "no such folder"
        raise ConfigError(f"--out {out}: {what}; give the --out of the `tf-mpc control` that is asked")
    try:
        ZoneInfo(zone or "UTC")
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise ConfigError(f"--zone {zone}: unknown; expected one such as Europe/Berlin") from error
    now = pd.Timestamp.now("UTC")
    people = People(out / "people.json", zone)
    people.ask(key, value, now)
    shown = people.shown(now).items()
    told = ", ".join(f"{name} {one}" for name, one in shown if one not in (None, False, 0, "control"))
    later = "" if in_use(out) else "; no process here controls by that folder: it counts once one does"
    click.echo(f"Asked: {told or 'nothing'}{later}")
