"""`tf-mpc data`: check a table of measurements, write a map to start from, plan a probing by hand."""

from __future__ import annotations

import json
from pathlib import Path

import click

from thermoforce_mpc.cli.building.data_shown import show_findings, show_measurements, show_remarks
from thermoforce_mpc.cli.building.probe_plan import FILES, MAP, probe_plan_command
from thermoforce_mpc.cli.options import plot_option
from thermoforce_mpc.files import written
from thermoforce_mpc.simulation.views.display import RunDisplay


@click.group()
def command() -> None:
    """Measurements of your own building: CSV or Parquet files and a map that says which column is what.

    \b
    Example:
      tf-mpc data map house.csv > map.yaml        (then check every line of it)
      tf-mpc data check house.csv --map map.yaml
      tf-mpc identify --data house.csv --map map.yaml --out my_house
    """


@command.command("map")
@click.argument("file", metavar="FILE")
def map_command(file: str) -> None:
    """Print a map for FILE, guessed from names and sizes of its columns, to be checked line by line."""
    from thermoforce_mpc.measurements.map.starting_map import starting_map

    click.echo(starting_map(file), nl=False)


@command.command("check")
@FILES
@MAP
@plot_option(Path("data_check.png"), "the measurements")
@click.option("--fit/--no-fit", default=True, show_default=True, help="Fit a linear model to see what the data tell.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write what was understood as JSON.")
def check_command(files: tuple[str, ...], map_file: Path, plot: Path, fit: bool, json_file: Path | None) -> None:
    """Say what was understood of FILE (several, or a pattern in quotes) by the map, and draw it.

    Prints period, step, gaps, ranges and flagged readings of every signal, what was assumed, what is missing and what
    is doubtful: stamps that are late or early, units, set-points taken for levels, other loads on a meter, rooms left
    out. Then what a linear model of the data tells about the effect of acting.
    """
    from thermoforce_mpc.measurements.load import read_measurements
    from thermoforce_mpc.measurements.picture import draw_measurements

    display = RunDisplay()
    measured = read_measurements(files, map_file)
    show_measurements(measured, display.console)
    doubts = show_remarks(measured, display.console)
    tells = show_findings(measured, display, doubts) if fit else {}
    with written(plot) as aside:
        names = ", ".join(Path(name).name for name in measured.understood.files[:3])
        draw_measurements(aside, measured, ": ".join([names, *([tells["headline"]] if tells else [])]))
    display.say(f"Picture: {plot}")
    if json_file is not None:
        content = {"understood": measured.understood.to_json(), "remarks": doubts, "tells": tells}
        with written(json_file) as aside:
            aside.write_text(json.dumps(content, indent=2, ensure_ascii=False), encoding="utf-8")


command.add_command(probe_plan_command)
