"""Commands of `tf-mpc bench` on plant, solvers, environments and fleets: what a step costs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from benchmarks.cli.options import FOLDER, JSON, QUICK, say
from benchmarks.cli.show import show

if TYPE_CHECKING:
    from benchmarks.fleet.bench import Part


@click.command("plant")
@click.option(
    "--reference",
    "references",
    required=True,
    multiple=True,
    type=FOLDER,
    help="Folder with records of a real test case, which their columns tell; repeatable.",
)
@click.option("--weather", type=click.Path(path_type=Path), help="Weather file of the records, if not in the folder.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@QUICK
@JSON
def plant_command(
    references: tuple[Path, ...], weather: Path | None, out: Path | None, quick: bool, json_file: Path | None
) -> None:
    """Score the embedded plants against records of the real test cases."""
    from benchmarks.plant.bench import run_plant_bench

    show(run_plant_bench(references, weather, quick=quick, out=out, progress=say), json_file)


@click.command("controller")
@QUICK
@JSON
def controller_command(quick: bool, json_file: Path | None) -> None:
    """Time the solvers and do-mpc on the same instances, and each part of a control step (extra [bench])."""
    from benchmarks.controller.bench import run_controller_bench

    show(run_controller_bench(quick=quick, progress=say), json_file)


@click.command("gym")
@QUICK
@JSON
def gym_command(quick: bool, json_file: Path | None) -> None:
    """Steps per second of the Gymnasium environments beside the same over REST (extras [gym] and [serve])."""
    from benchmarks.plant.gym import run_gym_bench

    show(run_gym_bench(quick=quick, progress=say), json_file)


@click.command("fleet")
@click.option(
    "--only",
    multiple=True,
    type=click.Choice(["identify", "plan", "coordinate", "campaign"]),
    help="Measure this part alone; repeatable.",
)
@QUICK
@JSON
def fleet_command(only: tuple[Part, ...], quick: bool, json_file: Path | None) -> None:
    """What many buildings cost to identify, to plan for, to coordinate under a limit and to simulate, on two cores."""
    from benchmarks.fleet.bench import PARTS, run_fleet_bench

    show(run_fleet_bench(only or PARTS, quick=quick, progress=say), json_file)
