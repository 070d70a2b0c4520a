"""`tf-mpc compare` and `tf-mpc sweep`: controllers on the same windows and tariffs.

Runs, those of `tf-mpc fleet` too, are shown while they are made, and kept.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from thermoforce_mpc.cli.options import (
    PATH,
    Opening,
    added,
    base_options,
    check_named_code,
    equal_comfort_option,
    execution_options,
    learned_options,
    scenario_from,
)
from thermoforce_mpc.comparison.cells import (
    Cell,
    ComparisonFile,
    Inputs,
    Variant,
    building_limits,
    comma_list,
    expand,
    known_names,
    load_comparison,
    numeric_option,
    shared_limits,
    swept_variants,
    variants_by_name,
)
from thermoforce_mpc.comparison.files import (
    FORMS,
    HEADINGS,
    formatted,
    headings,
    own_columns,
    shown_figures,
    write_outcome,
)
from thermoforce_mpc.comparison.outcome import group_title, grouped, verdicts
from thermoforce_mpc.comparison.store import DONE, Ran, Store
from thermoforce_mpc.comparison.tasks import EqualComfort, failure, tasks_of
from thermoforce_mpc.errors import ConfigError, Terminated, counted
from thermoforce_mpc.execution import Task, TaskOutcome, TaskProgress, execute, source_fingerprint
from thermoforce_mpc.execution.progress import summary
from thermoforce_mpc.experiment.experiment import Experiment, check_window
from thermoforce_mpc.files import plain_number
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.report.display import zone_table
from thermoforce_mpc.report.findings import COST, DISCOMFORT
from thermoforce_mpc.report.whole_tables import plain_table, print_whole
from thermoforce_mpc.scenario.comfort import window_name
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.testcase import PRICES

FAILED = 3
"""Exit code where a run has no result."""


def sayer(console: Console, quiet: bool) -> Callable[[str], None]:
    """Prints a line unless `quiet`."""
    return lambda text: None if quiet else console.print(text, soft_wrap=True)


def outcomes_of(
    tasks: Iterable[Task], store: Store, console: Console, engine: Opening, quiet: bool
) -> Iterator[TaskOutcome]:
    """The outcomes of tasks as they come; raises as `execute`."""
    with TaskProgress(console, quiet=quiet, line=_line) as progress, engine(sayer(console, quiet)) as where:
        store.create()  # not before: a cluster that cannot be used leaves no folder
        yield from execute(tasks, where, store, progress)


def run_cells(
    tasks: Sequence[Task],
    store: Store,
    console: Console,
    engine: Opening,
    quiet: bool,
    records: dict[str, dict[str, Any]],
) -> None:
    """Run tasks; the record of each cell, its result or the reason of its failure, goes into `records` by key.

    An interrupt or a signal to end notes how many of all are kept.
    """
    everyone = {*records, *(task.key for task in tasks if isinstance(task.inputs, Cell))}
    try:
        for outcome in outcomes_of(tasks, store, console, engine, quiet) if tasks else ():
            cell = outcome.task.inputs
            if isinstance(cell, Cell):
                ran = Ran(failure(cell, outcome.reason)) if outcome.reason else outcome.value
                if outcome.reason:
                    store.write(cell, ran)
                records[cell.key] = ran.record
    except (KeyboardInterrupt, Terminated) as error:
        kept = sum(record["status"] == DONE for record in records.values())
        error.add_note(f"{kept} of {len(everyone)} runs are kept in {store.folder}; repeat the command to resume")
        raise


def note_other_code(sources: Iterable[str], say: Callable[[str], None], anew: str = "take another --out") -> None:
    """Say how many kept runs were made by other source code of this version, and what runs them `anew`."""
    if stale := sum(source != source_fingerprint() for source in sources):
        say(f"Note: {stale} of them made by other source code of this version; to run all anew, {anew}")


def _line(outcome: TaskOutcome) -> str:
    if not isinstance(outcome.value, Ran):
        return summary(outcome)
    kpis = outcome.value.record["kpis"]
    return f"{outcome.task.title}: {kpis[COST]:.4f} / {kpis[DISCOMFORT]:.2f} K·h ({outcome.seconds:.0f} s)"


_CONTESTANTS = "thermoforce_mpc,thermostat,native"
_VALUES = "0.0026,0.005,0.01,0.026,0.05,0.1"
UNCERTAINTIES = tuple(PlantSpec.model_fields["forecast_uncertainty"].annotation.__args__)  # type: ignore[union-attr]
# KPIs that fit 80 columns; the files have all.
_ON_CONSOLE = ("cost_tot", "tdis_tot", "saving", "ener_tot", "plan_ms", "fallbacks")


_axes_options = added(
    click.option(
        "--windows",
        metavar="A,B",
        help="peak_heat_day, typical_heat_day, or first days: 2026-01-17 or 44.  [default: the scenario's, else the "
        "peak and typical day of the building's season]",
    ),
    click.option(
        "--prices",
        "tariffs",
        metavar="A,B",
        help="constant, dynamic, highly_dynamic.  [default: the scenario's, else constant]",
    ),
    click.option(
        "--forecast-uncertainty", metavar="A,B", help="none, low, medium, high.  [default: the scenario's, else none]"
    ),
    click.option("--tariff-file", "prices", metavar="FILE", help="CSV (time s, price per kWh): highly dynamic tariff."),
)
_seeds_option = click.option(
    "--seeds",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Seeds of probing, training and forecast errors, from the scenario's on; differences are over them too.",
)
_result_options = added(
    click.option("--out", type=PATH, help="Result folder; finished cells in it are reused.  [default: runs/...]"),
    click.option(
        "--format",
        "form",
        type=click.Choice(FORMS),
        help="Print only the figures, in this format, instead of tables for people.",
    ),
    click.option("--quiet", is_flag=True, help="Print only the final tables."),
)
comparison_options = added(
    base_options,
    _axes_options,
    _seeds_option,
    learned_options,
    _result_options,
    equal_comfort_option,
    execution_options(),
)


@click.command()
@comparison_options
@click.option("--controllers", metavar="A,B", help=f"Names (see `tf-mpc controllers`).  [default: {_CONTESTANTS}]")
@click.option("--variants", metavar="FILE", help="Controllers with options: YAML file or shipped name.")
def compare(**options: Any) -> None:
    """Run every controller on every window under every tariff, in parallel processes.

    A cell is one controller on one window under one tariff. Each finished cell is stored in the folder under a hash
    of all its inputs; repeating the command runs only missing and failed cells. Cells with the same identification
    settings share one model per window. Writes a table as Markdown and CSV, JSON, and an HTML page with cost against
    discomfort, and reports where a baseline is cheaper or more comfortable than a model-based controller.

    \b
    Examples:
      tf-mpc compare --testcase bestest_hydronic_heat_pump --controllers thermoforce_mpc,rc_mpc,thermostat,native
      tf-mpc compare --testcase bestest_hydronic_heat_pump --windows 44,58 --prices constant,dynamic
      tf-mpc compare --testcase bestest_hydronic_heat_pump --variants ablation --weather Brussels.mos

    \b
    Exit codes: 0 all cells have a result, 2 bad input, 3 a cell failed (the others are stored), 7 the cluster is gone,
    130 interrupted.
    """
    file = load_comparison(options["variants"]) if options["variants"] else None
    names: tuple[str, ...] = ()
    if options["controllers"] is not None:
        names = comma_list(options["controllers"], "--controllers")
    elif file is None:
        names = comma_list(_CONTESTANTS, "--controllers")
    if file is not None:
        named = [{"controller": {"name": one.controller, "options": one.options}} for one in file.variants.values()]
        check_named_code(named, [{"controller": name} for name in names], options["code"], options["variants"])
    variants = variants_by_name(names, file)
    base = scenario_from(options, file.scenario if file else None)
    axes = axes_from(options, base, file)
    _run_comparison(base, variants, axes, options, name="compare", title=f"Controllers compared on {base.testcase}")


@click.command()
@comparison_options
@click.option("--controller", "varied", default="thermoforce_mpc", metavar="NAME", help="Controller to vary.")
@click.option(
    "--over",
    default="comfort_weight_per_m2",
    metavar="KEY",
    help="Numeric option (dotted name, or its last part if unique), or key of the scenario.",
)
@click.option("--values", metavar="X,Y", help=f"Values of the option.  [default: of comfort_weight_per_m2 {_VALUES}]")
@click.option(
    "--beside", default="thermostat,native", metavar="A,B", help="Controllers run for comparison; '' for none."
)
def sweep(**options: Any) -> None:
    """Run one controller for several values of one option or key and plot cost against discomfort.

    As `tf-mpc compare`: parallel processes, resumable, one identification per window.

    \b
    Examples:
      tf-mpc sweep --testcase bestest_hydronic_heat_pump
      tf-mpc sweep --testcase bestest_hydronic_heat_pump --controller pi --over kp --values 0.2,0.5,1,2
      tf-mpc sweep --testcase bestest_hydronic_heat_pump --over horizon_h --values 12,24,48 --windows 44
      tf-mpc sweep --testcase bestest_hydronic_heat_pump --over identification.days --values 1,3,7 --seeds 5

    \b
    Exit codes: 0 all cells have a result, 2 bad input, 3 a cell failed (the others are stored), 7 the cluster is gone,
    130 interrupted.
    """
    base = scenario_from(options)
    testcase = load_testcase(base.testcase)
    controller = options["varied"]
    key = numeric_option(controller, options["over"])
    values, given = [], options["values"]
    if given is None and not key.endswith("comfort_weight_per_m2"):
        raise ConfigError(f"--values: missing; give values of {key} to compare, such as --values 0.5,1,2")
    for word in comma_list(given or _VALUES, "--values"):
        try:
            values.append(plain_number(word))
        except ValueError:
            raise ConfigError(f"--values: '{word}' is not a number") from None
    swept = swept_variants(controller, key, values, testcase)
    labels = {name: f"{value:g}" for name, value in zip(swept, values, strict=True)}
    beside = variants_by_name(comma_list(options["beside"], "--beside"), None) if options["beside"].strip() else {}
    title = f"{controller} over {key} on {base.testcase}"
    variants = {**swept, **beside}
    _run_comparison(base, variants, axes_from(options, base), options, name="sweep", title=title, swept=labels)


@dataclass(frozen=True)
class Axes:
    """Windows, tariffs and forecast error levels over which variants are compared."""

    windows: tuple[str, ...]
    prices: tuple[str, ...]
    uncertainties: tuple[str, ...]


def axes_from(options: Mapping[str, Any], base: Scenario, file: ComparisonFile | None = None) -> Axes:
    """The axes from a command's options, else from its file of variants, else from the scenario.

    Raises:
        ConfigError: an unknown window, tariff or error level, one given twice, or one of the scenario that the file
            would replace.
    """
    if options["windows"] is not None:
        try:
            windows = tuple(map(window_name, comma_list(options["windows"], "--windows")))
        except ValueError as error:
            raise ConfigError(f"--windows: {error}") from error
    else:
        windows = _of_file(base, "period", "windows", file.windows if file else ())
    if not windows:
        season = "cool" if load_testcase(base.testcase).mode == "cooling" else "heat"
        of_season = (f"peak_{season}_day", f"typical_{season}_day")
        windows = (base.period,) if "period" in base.model_fields_set else of_season
    for window in windows:
        check_window(window)
    if options["tariffs"] is not None:
        prices = known_names(options["tariffs"], "--prices", PRICES)
    else:
        prices = _of_file(base, "price", "prices", file.prices if file else ()) or (base.price,)
    levels: tuple[str, ...] = (base.plant.forecast_uncertainty,)
    if options["forecast_uncertainty"] is not None:
        levels = known_names(options["forecast_uncertainty"], "--forecast-uncertainty", UNCERTAINTIES)
    return Axes(windows, prices, levels)


def _of_file(base: Scenario, key: str, axis: str, values: tuple[str, ...]) -> tuple[str, ...]:
    """The values that a file of variants gives to an axis; raises `ConfigError` where the scenario has its own."""
    if values and key in base.model_fields_set and values != (getattr(base, key),):
        raise ConfigError(
            f"{key}: the scenario has {getattr(base, key)}, and the file of variants {axis}: {', '.join(values)}; say "
            f"with --{axis} which to run"
        )
    return values


def _run_comparison(
    base: Scenario,
    variants: Mapping[str, Variant],
    axes: Axes,
    options: Mapping[str, Any],
    *,
    name: str,
    title: str,
    swept: Mapping[str, str] | None = None,
) -> None:
    """Run the cells without a stored result, then write and print the outcome; exits with 3 where a cell has none."""
    inputs = Inputs()
    cells = expand(base, variants, axes.windows, axes.prices, axes.uncertainties, inputs, options["seeds"])
    testcase = load_testcase(base.testcase)
    store = Store(options["out"] or Path("runs") / f"{name}-{testcase.name}")
    console = Console(highlight=False, markup=False)
    quiet = options["quiet"] or options["form"] is not None
    say = sayer(console, quiet)
    stored = {cell.key: record for cell in cells if (record := store.finished(cell)) is not None}
    todo = [cell for cell in cells if cell.key not in stored]
    say(f"{counted(len(cells), 'cell')}: {len(cells) - len(todo)} already done, {len(todo)} to run; {store.folder}")
    note_other_code((record["source"] for record in stored.values()), say)
    run_cells(tasks_of(todo), store, console, options["engine"], quiet, stored)
    # With the names of this comparison: two may refer to the same run.
    named = [{"variant": cell.variant, "window": cell.window} for cell in cells]
    records: list[dict[str, Any]] = [stored[cell.key] | names for cell, names in zip(cells, named, strict=True)]
    asked = base.equal_comfort  # a cell does not have it, so that its result is found again with and without
    if Experiment.of(cells[0].scenario).equal_comfort if asked is None else asked:
        search = EqualComfort(store, inputs, testcase, lambda text: say(f"searching a thermostat: {text}"))
        records = search.beside(cells, records)
    result = write_outcome(store.folder, records, name=name, title=title, currency=testcase.currency, swept=swept)
    if options["form"] is not None:
        click.echo(formatted(result["rows"], options["form"], title, testcase.currency), nl=False)
    else:
        _show(console, result["rows"], testcase.currency)
        for line in contestants_in_words(base, cells):
            console.print(line, soft_wrap=True)
        page = shlex.quote(str(store.folder / "comparison.html"))
        console.print(f"Table, CSV, JSON and page: {page}", soft_wrap=True)
    if any(record["status"] != DONE for record in records):
        sys.exit(FAILED)


def contestants_in_words(base: Scenario, cells: Sequence[Cell]) -> list[str]:
    """Who keeps to the limits of the building, and what each thermostat keeps, in a line each."""
    from controllers.rules.thermostat import ThermostatConfig

    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(cell.variant, cell)
    lines, limits = [], building_limits(base)
    if limits:
        shared = {name: bool(shared_limits(base, cell.scenario.controller.name)) for name, cell in first.items()}
        said = ", ".join(f"{key} {value:g}" for key, value in limits.items())
        none = [name for name, knows in shared.items() if not knows]
        free = f"; {', '.join(none)} know no limits, and are not held to them" if none else ""
        lines.append(f"{said}: given to {', '.join(name for name, knows in shared.items() if knows)}{free}")
    for name, cell in first.items():
        config = Experiment.of(cell.scenario).own.chosen.config
        if isinstance(config, ThermostatConfig):
            lines.append(f"{name} {config.in_words}")
    return lines


def _show(console: Console, rows: Sequence[dict[str, Any]], currency: str) -> None:
    for group, members in grouped(rows).items():
        own = own_columns(members)
        of_key = dict(zip((*HEADINGS, *own), headings(currency, members), strict=True))
        shown = [of_key[key].replace(", ", "\n") for key in (*_ON_CONSOLE, *own)]
        shown = [text.replace("discomfort", "discomf.").replace("saving at equal comfort", "saved") for text in shown]
        table = plain_table(["controller", *shown], group_title(group), folded=True)
        table.columns[0].min_width = 12
        for row in members:
            figures = dict(zip((*HEADINGS, *own), shown_figures(row, own), strict=True))
            style = "bold" if row["pareto"] else None
            table.add_row(row["controller"], *(figures[key] for key in (*_ON_CONSOLE, *own)), style=style)
        print_whole(table, console, folded=True)
        zones = {row["controller"]: row["zones"] for row in members}
        if any(zones.values()):
            print_whole(zone_table(zones), console)
    for text in verdicts(rows):
        console.print(text, soft_wrap=True)
    for row in rows:
        if row["status"] != DONE:
            where = f"{row['controller']}, {row['window']}, {row['price']}"
            console.print(f"FAILED {where}: {row['reason']}", soft_wrap=True)
