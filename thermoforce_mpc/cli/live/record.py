"""`tf-mpc record`: what a connection knows of the past, or hears from now on, as a table to identify from."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange, map_option
from thermoforce_mpc.errors import ConfigError, PlantError


@click.command()
@map_option
@click.option("--connection", required=True, metavar="NAME|FILE", help="See `tf-mpc control`.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="connection.KEY.")
@click.option("--days", type=FiniteRange(0.01, 3700.0), default=400.0, help="So many days back, of a history.")
@click.option("--hours", type=FiniteRange(0.0), help="End after so long, where there is no history.  [default: never]")
@click.option("--out", type=PATH, default=Path("house.csv"), help="Table of a history.")
def record(
    map_file: Path, connection: str, assignments: tuple[str, ...], days: float, hours: float | None, out: Path
) -> None:
    """Write the history of a building as a table for `tf-mpc identify`; where the connection has none, record it.

    Home Assistant has a history: its states as far as its recorder goes back, and hourly statistics before. Over MQTT
    what comes is appended to the connection's record until Ctrl-C, or for --hours, with exit code 3 where nothing came.
    Nothing is set.

    \b
    Examples:
      tf-mpc record --map map.yaml --connection connection.yaml --days 365 --out house.csv
      tf-mpc identify --data house.csv --map map.yaml --out my_house
    """
    from thermoforce_mpc.connections.registry import build_connection, connection_settings
    from thermoforce_mpc.files import written
    from thermoforce_mpc.measurements.map.mapping import load_map
    from thermoforce_mpc.scenario.settings import parse_overrides

    chosen = parse_overrides(assignments)
    if unknown := [key for key in chosen if key != "connection"]:
        raise ConfigError(f"--set {unknown[0]}: write connection.KEY=VALUE")
    rules = load_map(map_file)
    name, options = connection_settings(connection, chosen.get("connection", {}))
    with closing(build_connection(name, options)) as building:
        if (reads := getattr(building, "reads", None)) is not None:
            reads([column for _, signal in rules.signals() for column in signal.columns])
        if (history := getattr(building, "history", None)) is not None:
            table = history(days).dropna(how="all")
            with written(out) as aside:
                table.to_csv(aside, lineterminator="\n")
            click.echo(f"{out}: {len(table)} rows from {table.index[0]} to {table.index[-1]}")
            return
        begin = getattr(building, "begin", None)
        if begin is None:
            raise ConfigError(f"connection {name} has no history and records nothing: its table is what you give it")
        begin()
        click.echo("Records what comes (Ctrl-C ends)")
        until = float("inf") if hours is None else time.monotonic() + 3600.0 * hours
        problem = ""
        while time.monotonic() < until:
            time.sleep(min(1.0, max(until - time.monotonic(), 0.0)))
            before, problem = problem, getattr(building, "problem", "")
            if problem != before:
                click.echo(f"{problem}; it is tried again" if problem else "Connected again", err=True)
        if problem:
            raise PlantError(f"nothing comes: {problem}")
        building.measurements()  # raises where nothing was recorded
