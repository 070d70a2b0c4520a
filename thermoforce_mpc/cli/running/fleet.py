"""`tf-mpc fleet`: many buildings × windows × tariffs × controllers × seeds."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import pandas as pd
from rich.console import Console

from thermoforce_mpc.cli.options import PATH, Opening, check_named_code, code_option, execution_options
from thermoforce_mpc.cli.running.comparing import FAILED, note_other_code, outcomes_of, run_cells, sayer
from thermoforce_mpc.comparison.store import DONE, Store
from thermoforce_mpc.comparison.tasks import failure
from thermoforce_mpc.errors import ConfigError, counted
from thermoforce_mpc.execution import Task
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.fleet.file import buildings_of, load_fleet
from thermoforce_mpc.fleet.page import RunGroup, causes, fleet_page, groups, headline, lost, paired
from thermoforce_mpc.fleet.runs import (
    FleetRun,
    Measured,
    check_dataset,
    check_surroundings_of,
    finished_rows,
    models_again,
    place_trajectories,
    read_dataset,
    reused_row,
    row_of,
    runs_of,
    tasks_of,
    tasks_of_records,
    with_models,
    write_dataset,
    write_models,
)
from thermoforce_mpc.report.whole_tables import plain_table, print_whole

_SHOWN_FAILURES = 10


@click.command()
@click.argument("fleet", metavar="FLEET.yaml")
@click.option("--count", is_flag=True, help="Say what would be run, and run nothing.")
@click.option(
    "--out", type=PATH, help="Folder of the dataset; finished runs in it are reused.  [default: runs/fleet-NAME]"
)
@click.option(
    "--reuse",
    type=PATH,
    multiple=True,
    help="Folder or runs.parquet of another fleet: its finished runs, where they have the same inputs, count as done. "
    "Repeatable.",
)
@code_option
@execution_options()
@click.option("--quiet", is_flag=True, help="Print only the summary.")
def fleet(
    fleet: str,
    count: bool,
    out: Path | None,
    reuse: tuple[Path, ...],
    code: tuple[str, ...],
    engine: Opening,
    quiet: bool,
) -> None:
    """Run every building of a fleet in every window under every tariff with every controller and seed.

    FLEET.yaml names the buildings (generated houses, houses of rooms, test cases, or a table of your own) and the axes;
    `tf-mpc schema fleet` is its schema. The folder then holds runs.parquet, one row a run, index.html with the
    distributions of saving and discomfort, who lost and why, models.parquet with the verdict on every model, and what
    each run and identification gave. Repeating the command runs only what is missing or failed.

    \b
    Examples:
      tf-mpc fleet small --count
      tf-mpc fleet small --out runs/small
      tf-mpc fleet portfolio --scheduler tcp://host:8786
      tf-mpc fleet whole.yaml --reuse runs/north --reuse runs/south

    \b
    Exit codes: 0 all runs have a result, 2 bad input, 3 a run failed or measurements gave no model (the others are
    kept), 7 the cluster is gone, 130 interrupted.
    """
    console = Console(highlight=False, markup=False)
    file, path = load_fleet(fleet)
    if reuse and file.trajectories:
        raise ConfigError(f"{path}: trajectories: true goes without --reuse: rows of other datasets have none")
    finished = finished_rows(reuse)
    buildings = buildings_of(file, path)
    variants = [{"controller": {"name": one.controller, "options": one.options}} for one in file.variants.values()]
    check_named_code([file.scenario, *variants, *(building.scenario for building in buildings)], [], code, str(path))
    measured = tasks_of_records(buildings)
    # Checked before anything is run: those with measurements get their model later.
    check_surroundings_of(file, buildings, path)
    runs = runs_of(file, [building for building in buildings if building.runs], path)
    identifications = len({run.cell.identification_key for run in runs if run.building.record is None} - {None})
    if measured:
        console.print(f"{counted(len(measured), 'building')} to identify from measurements", soft_wrap=True)
    console.print(f"{_counts_in_words(runs)}, {counted(identifications, 'identification')}", soft_wrap=True)
    if count:
        return
    store = Store(out or Path("runs") / f"fleet-{path.stem}")
    check_dataset(store.folder)
    no_model: dict[str, str] = {}
    if measured:
        models, no_model = _identify(measured, store, console, engine, quiet)
        runs = runs_of(file, with_models(buildings, models, no_model), path)
    to_run = [run for run in runs if not run.refused]
    records = {run.cell.key: record for run in to_run if (record := store.finished(run.cell)) is not None}
    keys = {run.cell.key for run in to_run}
    rows_of_others = {key: finished[key] for key in keys if key in finished and key not in records}
    own = [run for run in to_run if run.cell.key not in rows_of_others]
    todo = [run for run in own if run.cell.key not in records]
    again = models_again(own, records, store)
    say = sayer(console, quiet)
    taken = f"{len(to_run) - len(own)} taken from other datasets, " if reuse else ""
    say(f"{counted(len(own) - len(todo), 'run')} done, {taken}{len(todo)} left; {store.folder}")
    if again:
        say(f"{counted(len(again), 'model')} missing or damaged, to be identified again")
    made_by = [record["source"] for record in records.values()] + [row["code"] for row in rows_of_others.values()]
    note_other_code(made_by, say, "take another --out" + " and leave out --reuse" * bool(rows_of_others))
    run_cells([*again, *tasks_of(todo)], store, console, engine, quiet, records)
    store.create()
    dataset = write_dataset(store.folder, [_row(run, records, rows_of_others) for run in runs])
    if file.trajectories:
        place_trajectories(store, to_run)
    rows = read_dataset(dataset)
    verdicts = write_models(store, own, records, measured, no_model)
    page = store.folder / "index.html"
    command_line = shlex.join(["tf-mpc", "fleet", fleet])
    scenarios = {run.cell.key: run.cell.scenario for run in runs}
    write_whole(page, fleet_page(rows, file.reference, f"Fleet {path.stem}", command_line, scenarios))
    _show(console, rows, file.reference)
    console.print(f"Runs: {shlex.quote(str(dataset))}; models: {shlex.quote(str(verdicts))}", soft_wrap=True)
    console.print(f"Page: {shlex.quote(str(page))}", soft_wrap=True)
    if no_model or (rows["status"] != DONE).any():
        sys.exit(FAILED)


def _row(
    run: FleetRun, records: Mapping[str, Mapping[str, Any]], others: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    if run.refused:
        return row_of(run, failure(run.cell, run.refused))
    if run.cell.key in others:
        return reused_row(run, others[run.cell.key])
    return row_of(run, records[run.cell.key])


def _counts_in_words(runs: list[FleetRun]) -> str:
    sources = Counter({run.building.name: run.building.source for run in runs}.values())
    axes = [
        (sum(sources.values()), f"buildings ({', '.join(f'{n} {source}' for source, n in sources.items())})"),
        (len({run.cell.window for run in runs}), "windows"),
        (len({run.cell.price for run in runs}), "tariffs"),
        (len({run.cell.variant for run in runs}), "controllers"),
        (len({run.cell.scenario.seed for run in runs}), "seeds"),
    ]
    if not runs:
        return "no runs"
    of = " × ".join(f"{n} {what}" for n, what in axes if n > 1)
    return f"{of}: {len(runs)} runs" if of else "1 run"


def _identify(
    measured: Mapping[str, Task], store: Store, console: Console, engine: Opening, quiet: bool
) -> tuple[dict[str, Path], dict[str, str]]:
    models, none = dict[str, Path](), dict[str, str]()
    for outcome in outcomes_of(measured.values(), store, console, engine, quiet):
        made_of = outcome.task.inputs
        if not isinstance(made_of, Measured):
            continue
        if why := outcome.reason or outcome.value.refused:
            none[made_of.building] = f"{'failed' if outcome.reason else 'refused'}: {why}"
            console.print(f"{made_of.building}: no model from its measurements: {why}", soft_wrap=True)
        else:
            models[made_of.building] = store.model_path(outcome.task.key)
    return models, none


def saving_cells(group: RunGroup) -> tuple[str, str, str]:
    """Median saving, its range and the share that is cheaper, %; dashes where no run has a saving."""
    if not group.counted:
        return "–", "–", "–"
    low, middle, high = (100 * value for value in group.saving)
    return f"{middle:+.1f}", f"{low:+.1f} to {high:+.1f}", f"{100 * group.cheaper:.0f}"


def _show(console: Console, rows: pd.DataFrame, reference: str) -> None:
    for variant in [name for name in dict.fromkeys(rows["variant"]) if name != reference]:
        pairs = paired(rows, variant, reference)
        if pairs.empty:
            continue
        distributions = groups(pairs)
        console.print(headline(distributions[0], variant, reference), soft_wrap=True)
        headings = (variant, "runs", "saving\nmedian %", "10 to 90 %", "cheaper\n%", "> 0.5 K·h\nworse %")
        table = plain_table(headings, folded=True)
        for group in distributions:
            table.add_row(
                f"{group.by} {group.value}".strip(), str(group.runs), *saving_cells(group), f"{100 * group.colder:.0f}"
            )
        print_whole(table, console, folded=True)
        for cause, n in causes(lost(pairs)):
            console.print(f"{counted(n, 'run')} {cause}", soft_wrap=True)
    failed = rows[rows["status"] != DONE]
    for row in failed.head(_SHOWN_FAILURES).to_dict("records"):
        seed = f", seed {row['seed']}" if rows["seed"].nunique() > 1 else ""
        console.print(
            f"FAILED {row['building']}, {row['window']}, {row['price']}, {row['variant']}{seed}: {row['reason']}",
            soft_wrap=True,
        )
    if len(failed) > _SHOWN_FAILURES:
        console.print(f"and {len(failed) - _SHOWN_FAILURES} more failed, see the page", soft_wrap=True)
