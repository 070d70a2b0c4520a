"""Commands of `tf-mpc bench` that score what a model says: effects of actions, savings, free responses."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.cli.options import FILE, FOLDER, JSON, NEW_FOLDER, QUICK, say
from benchmarks.cli.show import show
from thermoforce_mpc.cli.options import FiniteRange, Opening, execution_options
from thermoforce_mpc.registry import names_in


@click.command("operator")
@click.option("--reference", required=True, type=FOLDER, help="Folder with records of the real test case.")
@QUICK
@JSON
def operator_command(reference: Path, quick: bool, json_file: Path | None) -> None:
    """Score identified operators on held-out interventions and time the rollout against a plain loop."""
    from benchmarks.operator.bench import run_operator_bench

    show(run_operator_bench(reference, quick=quick, progress=say), json_file)


@click.command("probing")
@QUICK
@JSON
def probing_command(quick: bool, json_file: Path | None) -> None:
    """Compare designed with random probing on the embedded plant."""
    from benchmarks.probing.bench import run_probing_bench

    show(run_probing_bench(quick=quick, progress=say), json_file)


@click.command("operation")
@execution_options()
@QUICK
@JSON
def operation_command(engine: Opening, quick: bool, json_file: Path | None) -> None:
    """Score models from 3, 7 and 28 days of a thermostat, a PI loop and a timer beside those from probing.

    On the embedded plant and a house of three rooms, by the effect of acting on pairs of days; heat is not measured.
    Target: a model that is wrong says so.
    """
    from benchmarks.operation.bench import run_operation_bench

    with engine(say) as where:
        show(run_operation_bench(engine=where, quick=quick, progress=say), json_file)


@click.command("effects")
@click.option(
    "--mode",
    type=click.Choice(["probing", "operation"]),
    default="probing",
    show_default=True,
    help="Records of probing, or of ordinary operation of houses of several rooms.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the population.")
@click.option("--houses", type=click.IntRange(1), default=12, show_default=True, help="Number of generated houses.")
@click.option(
    "--days",
    type=FiniteRange(1, 35),
    multiple=True,
    help="Days of probing, 1 to 10, repeatable; of operation, 7 to 35.  [default: 3 and 7; 28]",
)
@execution_options()
@click.option("--out", type=NEW_FOLDER, help="Folder for the plot.")
@QUICK
@JSON
def effects_command(
    mode: str,
    seed: int,
    houses: int,
    days: tuple[float, ...],
    engine: Opening,
    out: Path | None,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Score what models say of six hours at full level: bias, and whether their bands hold the truth.

    From probing: on generated houses, the embedded plant and EnergyPlus (extra [energyplus]). From ordinary operation
    (thermostats, schedules, night setback; levels, temperatures, weather and power measured): on houses of 3 to 5
    rooms, each valve on each room. The truth is the difference of two runs of the same building.
    """
    from benchmarks.effects.bench import run_effects_bench, run_operated_bench

    if mode == "operation" and (len(days) > 1 or out is not None):
        raise click.UsageError("--mode operation takes one number of --days, and draws no plot (--out)")
    with engine(say) as where:
        if mode == "operation":
            chosen = {"days": days[0]} if days else {}
            result = run_operated_bench(seed=seed, houses=houses, engine=where, quick=quick, progress=say, **chosen)
        else:
            result = run_effects_bench(
                seed=seed, houses=houses, days=days or (3.0, 7.0), engine=where, quick=quick, out=out, progress=say
            )
    show(result, json_file)


@click.command("verdicts")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the population.")
@click.option("--houses", type=click.IntRange(1), default=60, show_default=True, help="Number of generated houses.")
@click.option(
    "--closed-loop", type=click.IntRange(0), default=60, show_default=True, help="So many also run a week each."
)
@click.option(
    "--days",
    type=FiniteRange(1, 10),
    multiple=True,
    default=(1.5, 3.0),
    show_default=True,
    help="Days of probing; repeatable.",
)
@execution_options()
@QUICK
@JSON
def verdicts_command(
    seed: int,
    houses: int,
    closed_loop: int,
    days: tuple[float, ...],
    engine: Opening,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Set the verdict on models of generated houses beside what they are worth.

    That is how far the effect of an action is off, and what a week costs beside the thermostat, with the gate off.
    Targets: no model that passes costs more at equal comfort, at most 10 % of the good ones are held back.
    """
    from benchmarks.verdicts.bench import run_verdicts_bench

    with engine(say) as where:
        result = run_verdicts_bench(
            seed=seed,
            houses=houses,
            closed_loop=closed_loop,
            days=days,
            engine=where,
            quick=quick,
            progress=say,
        )
    show(result, json_file)


@click.command("saving")
@click.option(
    "--mode",
    type=click.Choice(["verified", "worth", "plan"]),
    default="verified",
    show_default=True,
    help="What a changed operation saved, what plans would have saved, or what a plan will save.",
)
@click.option("--cases", type=click.IntRange(1), help="Number of cases.  [default: 40; 20; 8]")
@click.option(
    "--seed", type=click.IntRange(0), default=7, show_default=True, help="Seed of houses, start days and set-points."
)
@execution_options()
@QUICK
@JSON
def saving_command(
    mode: str, cases: int | None, seed: int, engine: Opening, quick: bool, json_file: Path | None
) -> None:
    """Compare savings that are said with the truth: houses run both ways.

    Verified: with a change of operation and without it. Every fourth case changes nothing. Targets: the 95 % interval
    holds the truth in 85 % of the cases or more, and no saving is claimed where there was none. Worth: `tf-mpc worth`
    of three days of houses of rooms, models from four weeks of ordinary operation; the 90 % band holds what the same
    controller saves in the house in 85 % or more. Plan: what `tf-mpc plan` says of levels on three days of such houses,
    which hold them in 85 % or more.
    """
    from benchmarks.operation.plan_saving import run_plan_saving_bench
    from benchmarks.operation.saving import run_saving_bench
    from benchmarks.operation.would_save import run_would_save_bench

    run = {"verified": run_saving_bench, "worth": run_would_save_bench, "plan": run_plan_saving_bench}[mode]
    number = {} if cases is None else {"n": cases}
    with engine(say) as where:
        show(run(seed=seed, engine=where, quick=quick, progress=say, **number), json_file)


@click.command("rooms")
@click.option(
    "--records",
    type=FOLDER,
    multiple=True,
    required=True,
    help="Folder with measured records: ehbe/ with its maps, armadillo_H2_30min.csv, mons_house_30min.csv.gz. "
    "Repeatable.",
)
@click.option("--only", multiple=True, metavar="NAME", help="Only the record of this name; repeatable.")
@click.option(
    "--against",
    type=FILE,
    help="JSON of an earlier run: compare with it.",
)
@execution_options()
@QUICK
@JSON
def rooms_command(
    records: tuple[Path, ...],
    only: tuple[str, ...],
    against: Path | None,
    engine: Opening,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Predict measured rooms 6 h and 24 h ahead by models from the first 60 % of their records.

    From a start every 3 h of the rest, with measured weather and levels. RMSE in K of the model with the controllers'
    free response (default) and with its own linear one (rc), of the linear weather model alone, and of persistence;
    and what 48 h at full level change. With --against: no worse in the median, no room by more than 10 %.

    \b
    Example:
      tf-mpc bench rooms --records ../shared/measured_buildings --records ../shared/real_house --json rooms.json
    """
    from benchmarks.measured_rooms.bench import run_rooms_bench

    with engine(say) as where:
        found = run_rooms_bench(records, engine=where, only=only, against=against, quick=quick, progress=say)
    show(found, json_file)


@click.command("names")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the draws.")
@click.option("--buildings", type=click.IntRange(1), default=1000, show_default=True, help="Number of buildings.")
@QUICK
@JSON
def names_command(seed: int, buildings: int, quick: bool, json_file: Path | None) -> None:
    """Draw names and records of buildings, and count the signals that `tf-mpc data map` takes for what they are.

    Names of 14 styles: Home Assistant, point lists, KNX, spreadsheets in seven languages, grey-box models. Wrong and
    unmarked is what is wrong without a mark in the map.
    """
    from benchmarks.names.bench import run_names_bench

    show(run_names_bench(seed=seed, buildings=buildings, quick=quick, progress=say), json_file)


@click.command("records")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the population.")
@click.option("--houses", type=click.IntRange(1), default=40, show_default=True, help="Houses of each operation.")
@click.option(
    "--records",
    type=FOLDER,
    multiple=True,
    help="Folder with measured records to spoil too: ehbe/ with its maps. Repeatable.",
)
@execution_options()
@QUICK
@JSON
def records_command(
    seed: int, houses: int, records: tuple[Path, ...], engine: Opening, quick: bool, json_file: Path | None
) -> None:
    """Put faults into records and count how many the checks find and name rightly, and what they say of clean ones.

    Records of generated houses under probing and thermostats, and of houses of rooms. Faults of several sizes: stamps
    that are late or early, units of power and temperature, set-points as levels, other loads on a meter, rooms left
    out.

    \b
    Example:
      tf-mpc bench records --seed 7 --records ../shared/measured_buildings --json records.json
    """
    from benchmarks.records.bench import run_records_bench

    with engine(say) as where:
        found = run_records_bench(seed=seed, houses=houses, engine=where, records=records, quick=quick, progress=say)
    show(found, json_file)


@click.command("free-response")
@click.option("--reference", type=FOLDER, help="Folder with records of the real test case.")
@click.option("--houses", type=FOLDER, help="Folder with measured houses.")
@click.option("--backbone", default="shipped", show_default=True, help="Weights of the forecaster.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@QUICK
@JSON
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
    (both left out with --quick), what share of the true future each method knows by length of history, with people and
    without, the effect of the number of resolutions, and the time per forecast.
    """
    from benchmarks.free_response.bench import run_free_response_bench

    result = run_free_response_bench(reference, houses, backbone=backbone, quick=quick, out=out, progress=say)
    show(result, json_file)


@click.command("backbones")
@click.option(
    "--backbones",
    help="Comma-separated: shipped, shipped_small, shipped_tiny, fracast, directories, hub names.  [default: the "
    "shipped ones, and fracast where installed]",
)
@click.option("--reference", type=FOLDER, help="Folder with records of the real test case.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the plot.")
@QUICK
@JSON
def backbones_command(
    backbones: str | None, reference: Path | None, out: Path | None, quick: bool, json_file: Path | None
) -> None:
    """Compare forecasters, alone and composed with the operator, 6 h ahead on records with control."""
    from benchmarks.free_response.backbones import run_backbone_bench

    show(run_backbone_bench(names_in(backbones), reference, quick=quick, out=out, progress=say), json_file)


@click.command("forecasters")
@click.option("--models", help="Comma-separated, as tf-mpc free-responses lists them.  [default: those installed]")
@JSON
def forecasters_command(models: str | None, json_file: Path | None) -> None:
    """What each foundation model does with constant, gapped, moved or mirrored series; its time and memory.

    Those whose weights do not ship are built with random ones of their real architecture (no download).
    """
    from benchmarks.free_response.forecasters import run_forecasters_bench

    show(run_forecasters_bench(names_in(models), say), json_file)
