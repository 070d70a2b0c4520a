"""Commands of `tf-mpc bench` for the paper's suites: measured homes, and paired interventions."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import click

from benchmarks.cli.options import FOLDER, JSON, NEW_FOLDER, QUICK, say
from benchmarks.cli.show import show
from thermoforce_mpc.cli.options import Opening, execution_options


@click.command("factual")
@click.option(
    "--records",
    type=FOLDER,
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
    type=NEW_FOLDER,
    default=Path("runs/factual"),
    show_default=True,
    help="Folder for tables, figures, JSON and HTML page; a stopped run goes on from it.",
)
@QUICK
@JSON
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
    from benchmarks.free_response.scales import SCALES

    if bool(files) != bool(map_file) or not (records or files):
        raise click.UsageError("give a folder with measured homes, --records FOLDER, or --data FILE --map map.yaml")
    homes = [home for folder in records for home in read_homes(folder, all_meters=all_meters, say=say)]
    homes += mapped_homes(files, map_file) if map_file else []
    homes = [home for home in homes if not only or any(part.lower() in home.name.lower() for part in only)]
    if not homes:
        raise click.UsageError(f"--home {', '.join(only)}: no home has that in its name")
    with engine(say) as where:
        result = run_factual_bench(
            homes,
            out,
            first=None if first is None else pd.Timestamp(first),
            last=None if last is None else pd.Timestamp(last),
            days=days,
            backbone=backbone,
            others=others or SCALES,
            quick=quick,
            engine=where,
            progress=say,
        )
    show(result, json_file)


@click.command("interventions")
@click.option(
    "--study",
    type=click.Choice(["validity", "ablation", "gamma", "data", "efficiency", "baselines", "office"]),
    default="validity",
    show_default=True,
    help="Table: interventional validity, operator ablation, gamma sweep, data efficiency, cost, baselines over "
    "settings and seeds, or DOE small office.",
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
    type=NEW_FOLDER,
    default=Path("runs/interventions-data"),
    show_default=True,
    help="Folder in which simulated pairs are cached.",
)
@click.option(
    "--out",
    type=NEW_FOLDER,
    default=Path("runs/interventions"),
    show_default=True,
    help="Folder for figures, JSON and HTML page.",
)
@QUICK
@JSON
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
    with engine(say) as where:
        options |= {"engine": where, "draw": draw, "progress": say}
        if study == "validity":
            show(run_interventions_bench(data_folder, **options, methods=methods), json_file)
        else:
            show(run_study(study, data_folder, **options), json_file)
