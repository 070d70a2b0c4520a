"""`tf-mpc bench NAME`: benchmarks that reproduce the figures in the documentation."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import FiniteRange, Opening, execution_options

if TYPE_CHECKING:
    from benchmarks.fleet.bench import Part


@click.group(short_help="Run benchmarks and compare the results with their targets.")
def command() -> None:
    """Run a benchmark: print its table, check its targets, write plots and JSON."""


_WIDTH_OF_FILES = 160
_FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
_JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the result to this JSON file.")
_QUICK = click.option("--quick", is_flag=True, help="Smaller and faster version of the benchmark.")


@command.command("plant")
@click.option("--reference", required=True, type=_FOLDER, help="Folder with records of the real test case.")
@click.option("--weather", type=click.Path(path_type=Path), help="Weather file of the records, if not in the folder.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@_QUICK
@_JSON
def plant_command(reference: Path, weather: Path | None, out: Path | None, quick: bool, json_file: Path | None) -> None:
    """Score the embedded plant against records of the real test case."""
    from benchmarks.plant.bench import run_plant_bench

    show(run_plant_bench(reference, weather, quick=quick, out=out, progress=_progress), json_file)


@command.command("operator")
@click.option("--reference", required=True, type=_FOLDER, help="Folder with records of the real test case.")
@_QUICK
@_JSON
def operator_command(reference: Path, quick: bool, json_file: Path | None) -> None:
    """Score identified operators on held-out interventions and time the rollout against a plain loop."""
    from benchmarks.operator.bench import run_operator_bench

    show(run_operator_bench(reference, quick=quick, progress=_progress), json_file)


@command.command("probing")
@_QUICK
@_JSON
def probing_command(quick: bool, json_file: Path | None) -> None:
    """Compare designed with random probing, and test online adaptation to a loss of capacity, on the embedded plant."""
    from benchmarks.probing.bench import run_probing_bench

    show(run_probing_bench(quick=quick, progress=_progress), json_file)


@command.command("controller")
@_QUICK
@_JSON
def controller_command(quick: bool, json_file: Path | None) -> None:
    """Time the solvers and do-mpc on the same instances, and each part of a control step (extra [bench])."""
    from benchmarks.controller.bench import run_controller_bench

    show(run_controller_bench(quick=quick, progress=_progress), json_file)


@command.command("gym")
@_QUICK
@_JSON
def gym_command(quick: bool, json_file: Path | None) -> None:
    """Steps per second of the Gymnasium environments beside the same over REST (extras [gym] and [serve])."""
    from benchmarks.plant.gym import run_gym_bench

    show(run_gym_bench(quick=quick, progress=_progress), json_file)


@command.command("dpc")
@click.option("--days", type=FiniteRange(0, min_open=True), default=14.0, show_default=True, help="Days a window.")
@click.option(
    "--price",
    type=click.Choice(["constant", "dynamic", "highly_dynamic"]),
    default="constant",
    show_default=True,
    help="Tariff.",
)
@_QUICK
@_JSON
def dpc_command(days: float, price: str, quick: bool, json_file: Path | None) -> None:
    """Put a policy trained through the model beside the MPC and the thermostat: cost, discomfort, training, time."""
    from benchmarks.closed_loop.dpc import run_dpc_bench

    show(run_dpc_bench(days=days, price=price, quick=quick, progress=_progress), json_file)


@command.command("buildings")
@click.option("--houses", type=click.IntRange(1), default=40, show_default=True, help="Number of generated houses.")
@click.option("--seed", type=click.IntRange(0), default=2026, show_default=True, help="Seed of the population.")
@execution_options()
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for a plot of each window and outcomes.json with every figure.",
)
@_QUICK
@_JSON
def buildings_command(
    houses: int, seed: int, engine: Opening, out: Path | None, quick: bool, json_file: Path | None
) -> None:
    """Run the default configuration on generated houses, against a thermostat and the houses' own control.

    Two weeks a house: the coldest and a sunny one in spring. Costs in EUR/m² and discomfort in K·h of the week.
    """
    from benchmarks.closed_loop.buildings import run_buildings_bench

    with engine(_progress) as where:
        result = run_buildings_bench(houses=houses, seed=seed, engine=where, quick=quick, out=out, progress=_progress)
    show(result, json_file)


@command.command("fleet")
@click.option(
    "--only",
    multiple=True,
    type=click.Choice(["identify", "plan", "coordinate", "campaign"]),
    help="Measure this part alone; repeatable.",
)
@_QUICK
@_JSON
def fleet_command(only: tuple[Part, ...], quick: bool, json_file: Path | None) -> None:
    """What many buildings cost to identify, to plan for, to coordinate under a limit and to simulate, on two cores."""
    from benchmarks.fleet.bench import PARTS, run_fleet_bench

    show(run_fleet_bench(only or PARTS, quick=quick, progress=_progress), json_file)


@command.command("zones")
@click.option("--fmus", type=_FOLDER, help="Folder with twozone_apartment_hydronic.fmu; without it, it is left out.")
@execution_options()
@click.option("--only-speed", is_flag=True, help="Time a step alone, without buildings.")
@_QUICK
@_JSON
def zones_command(fmus: Path | None, engine: Opening, only_speed: bool, quick: bool, json_file: Path | None) -> None:
    """Run the default configuration on buildings of several zones, and time a step over the number of zones.

    Five zones are solved in do-mpc too (extra [bench]).
    """
    from benchmarks.zones.bench import run_zones_bench

    with engine(_progress) as where:
        result = run_zones_bench(fmus=fmus, engine=where, quick=quick, only_speed=only_speed, progress=_progress)
    show(result, json_file)


@command.command("boptest")
@click.option("--fmus", required=True, type=_FOLDER, help="Folder with FMUs of test cases, NAME.fmu.")
@click.option(
    "--price",
    type=click.Choice(["constant", "dynamic", "highly_dynamic"]),
    default="constant",
    show_default=True,
    help="Tariff.",
)
@execution_options()
@_QUICK
@_JSON
def boptest_command(fmus: Path, price: str, engine: Opening, quick: bool, json_file: Path | None) -> None:
    """Run the default configuration on test cases from their FMUs, over all their scenarios, beside native control.

    Cost per m² in the test case's currency and discomfort in K·h of two weeks (extra [fmu]).
    """
    from benchmarks.closed_loop.boptest import run_boptest_bench

    with engine(_progress) as where:
        show(run_boptest_bench(fmus, price=price, engine=where, quick=quick, progress=_progress), json_file)


@command.command("faults")
@click.option("--stand-back", type=click.Choice(["native", "rule"]), default="native", help="Who acts after an alarm.")
@_QUICK
@_JSON
def faults_command(stand_back: str, quick: bool, json_file: Path | None) -> None:
    """Measure how soon the watch notices faults of the embedded plant that last a day, and what they cost."""
    from benchmarks.faults.bench import run_faults_bench

    show(run_faults_bench(quick=quick, progress=_progress, stand_back=stand_back), json_file)


@command.command("fallback")
@_QUICK
@_JSON
def fallback_command(quick: bool, json_file: Path | None) -> None:
    """Measure what broken sensors, forecasts and solvers cost on the embedded plant, with protection and without."""
    from benchmarks.faults.fallback import run_fallback_bench

    show(run_fallback_bench(quick=quick, progress=_progress), json_file)


@command.command("factual")
@click.option(
    "--records",
    type=_FOLDER,
    multiple=True,
    help="Folder with measured homes: the REFIT release, mons_house_30min.csv.gz, armadillo_H2_30min.csv. May be "
    "given more than once.",
)
@click.option("--data", "files", multiple=True, metavar="FILE", help="Your own measurements; repeatable.")
@click.option("--map", "map_file", type=click.Path(path_type=Path), help="Map of --data.")
@click.option("--from", "first", type=click.DateTime(), help="Leave out what was recorded before.")
@click.option("--until", "last", type=click.DateTime(), help="Leave out what was recorded later.")
@click.option("--home", "only", multiple=True, metavar="NAME", help="Only homes with NAME in their name.")
@click.option(
    "--all-meters", is_flag=True, help="Mons: appliances, lights and hot water may act too, not only heating."
)
@click.option(
    "--days", type=click.IntRange(1, 30), multiple=True, help="Identification budget; may be given more than once."
)
@click.option("--backbone", default="shipped", show_default=True, help="Weights of the forecaster.")
@click.option(
    "--other", "others", multiple=True, metavar="NAME", help="Backbone for their table.  [default: the shipped ones]"
)
@execution_options("--workers")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs/factual"),
    show_default=True,
    help="Folder for tables, figures, JSON and HTML page; a stopped run goes on from it.",
)
@_QUICK
@_JSON
def factual_command(
    records: tuple[Path, ...],
    files: tuple[str, ...],
    map_file: Path | None,
    first: datetime | None,
    last: datetime | None,
    only: tuple[str, ...],
    all_meters: bool,
    days: tuple[int, ...],
    backbone: str,
    others: tuple[str, ...],
    engine: Opening,
    out: Path,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Score few-shot forecasts of measured homes 6 h and 24 h ahead by every method of the paper.

    Each record is cut into a fit part (30 days), a validation part (21) and a test part (28), from its start or --from.
    Everything is chosen on the validation part; the test part is scored once.

    \b
    Example:
      tf-mpc bench factual --records ../shared/real_house --until 2016-04-01
    """
    import pandas as pd

    from benchmarks.factual.bench import run_factual_bench
    from benchmarks.factual.readers import mapped_homes, read_homes
    from thermoforce_mpc.model.free_response.backbones.loading import SHIPPED_SCALES

    if bool(files) != bool(map_file) or not (records or files):
        raise click.UsageError("give a folder with measured homes, --records FOLDER, or --data FILE --map map.yaml")
    homes = [home for folder in records for home in read_homes(folder, all_meters=all_meters, say=_progress)]
    homes += mapped_homes(files, map_file) if map_file else []
    homes = [home for home in homes if not only or any(part.lower() in home.name.lower() for part in only)]
    if not homes:
        raise click.UsageError(f"--home {', '.join(only)}: no home has that in its name")
    with engine(_progress) as where:
        result = run_factual_bench(
            homes,
            out,
            first=None if first is None else pd.Timestamp(first),
            last=None if last is None else pd.Timestamp(last),
            days=days,
            backbone=backbone,
            others=others or SHIPPED_SCALES,
            quick=quick,
            engine=where,
            progress=_progress,
        )
    show(result, json_file)


@command.command("operation")
@execution_options()
@_QUICK
@_JSON
def operation_command(engine: Opening, quick: bool, json_file: Path | None) -> None:
    """Score models from 3, 7 and 28 days of a thermostat, a PI loop and a timer beside those from probing.

    On the embedded plant and a house of three rooms, by the effect of acting on pairs of days; heat is not measured.
    Target: a model that is wrong says so.
    """
    from benchmarks.operation.bench import run_operation_bench

    with engine(_progress) as where:
        show(run_operation_bench(engine=where, quick=quick, progress=_progress), json_file)


@command.command("saving")
@click.option("--cases", type=click.IntRange(1), default=40, show_default=True, help="Number of cases.")
@click.option("--seed", type=int, default=7, show_default=True, help="Seed of houses, start days and set-points.")
@execution_options()
@_QUICK
@_JSON
def saving_command(cases: int, seed: int, engine: Opening, quick: bool, json_file: Path | None) -> None:
    """Compare verified savings with the truth: houses run both with a change of operation and without it.

    Every fourth case changes nothing. Targets: the 95 % interval holds the truth in 85 % of the cases or more, and no
    saving is claimed where there was none.
    """
    from benchmarks.operation.saving import run_saving_bench

    with engine(_progress) as where:
        show(run_saving_bench(n=cases, seed=seed, engine=where, quick=quick, progress=_progress), json_file)


@command.command("free-response")
@click.option("--reference", type=_FOLDER, help="Folder with records of the real test case.")
@click.option("--houses", type=_FOLDER, help="Folder with measured houses.")
@click.option("--backbone", default="shipped", show_default=True, help="Weights of the forecaster.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@_QUICK
@_JSON
def free_response_command(
    reference: Path | None,
    houses: Path | None,
    backbone: str,
    out: Path | None,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Score 24 h free-response forecasts of every method from many origins, on the same history (extra [bench]).

    Also measures the coverage of the intervals over two weeks and the share of the error that weather can explain
    (both left out with --quick), the effect of history length and number of resolutions, and the time per forecast.
    """
    from benchmarks.free_response.bench import run_free_response_bench

    result = run_free_response_bench(reference, houses, backbone=backbone, quick=quick, out=out, progress=_progress)
    show(result, json_file)


@command.command("backbones")
@click.option(
    "--backbones",
    help="Comma-separated: shipped, shipped_small, shipped_tiny, fracast, directories, hub names.  [default: the "
    "shipped ones, and fracast where installed]",
)
@click.option("--reference", type=_FOLDER, help="Folder with records of the real test case.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@_QUICK
@_JSON
def backbones_command(
    backbones: str | None, reference: Path | None, out: Path | None, quick: bool, json_file: Path | None
) -> None:
    """Compare forecasters, alone and composed with the operator, 6 h ahead on records with control."""
    from benchmarks.free_response.backbones import run_backbone_bench

    names = [name.strip() for name in (backbones or "").split(",") if name.strip()]
    show(run_backbone_bench(names, reference, quick=quick, out=out, progress=_progress), json_file)


@command.command("interventions")
@click.option(
    "--study",
    type=click.Choice(["validity", "ablation", "gamma", "data", "efficiency", "office"]),
    default="validity",
    show_default=True,
    help="Table: interventional validity, operator ablation, gamma sweep, data efficiency, cost, or DOE small office.",
)
@click.option(
    "--days",
    type=click.IntRange(1, 30),
    multiple=True,
    help="Probe days; may be given more than once.  [default: 3; with --quick 1; studies have their own]",
)
@click.option(
    "--method", "methods", multiple=True, metavar="NAME", help="Only this method; may be given more than once."
)
@click.option("--backbone", default="shipped", show_default=True, help="Weights of the forecaster.")
@click.option("--seed", default=1, show_default=True, help="Seed of network training.")
@click.option("--draw", default=1, show_default=True, help="Seed of occupants and probing in the suite.")
@execution_options("--workers")
@click.option(
    "--data",
    "data_folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs/interventions-data"),
    show_default=True,
    help="Folder in which simulated pairs are cached.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs/interventions"),
    show_default=True,
    help="Folder for figures, JSON and HTML page.",
)
@_QUICK
@_JSON
def interventions_command(
    study: str,
    days: tuple[int, ...],
    methods: tuple[str, ...],
    backbone: str,
    seed: int,
    draw: int,
    engine: Opening,
    data_folder: Path,
    out: Path,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Score predicted effects of interventions against paired EnergyPlus runs (extra [energyplus])."""
    from benchmarks.interventions.bench import run_interventions_bench
    from benchmarks.interventions.studies import run_study

    options: dict[str, Any] = {"out": out, "days": days, "quick": quick, "backbone": backbone, "seed": seed}
    if methods and study != "validity":
        raise click.UsageError("--method can only be used with --study validity; the other studies have fixed methods")
    with engine(_progress) as where:
        options |= {"engine": where, "draw": draw, "progress": _progress}
        if study == "validity":
            show(run_interventions_bench(data_folder, **options, methods=methods), json_file)
        else:
            show(run_study(study, data_folder, **options), json_file)


def _progress(line: str) -> None:
    click.echo(line, err=True)


def show(result: Mapping[str, Any], json_file: Path | None) -> None:
    """Print the rows and targets of a benchmark; write its JSON where `json_file` is given."""
    from rich.console import Console
    from rich.table import Table

    from thermoforce_mpc.simulation.folder.run_folder import write_json

    console = Console(highlight=False)
    if not console.is_terminal:  # do not wrap tables in files
        console.width = _WIDTH_OF_FILES
    # Consecutive rows with the same columns share a table.
    columns: tuple[str, ...]
    for columns, group in groupby(result["rows"], key=tuple):
        table = Table(title=f"bench {result['bench']}", title_justify="left")
        for column in columns:
            table.add_column(column, overflow="fold")
        for row in group:
            table.add_row(*(_cell(row[column]) for column in columns))
        console.print(table)
    for target in result["targets"]:
        mark = "holds      " if target["holds"] else "DOES NOT HOLD"
        console.print(f"{mark}  {target['name']}: {_cell(target['value'])} ({target['sense']} {target['goal']:g})")
    if json_file:
        write_json(json_file, result)
        console.print(f"JSON: {json_file}")


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
