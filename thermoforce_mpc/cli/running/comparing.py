"""Options, progress display and execution shared by `tf-mpc compare` and `tf-mpc sweep`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from thermoforce_mpc.cli.options import (
    added,
    base_options,
    equal_comfort_option,
    execution_options,
    learned_options,
)
from thermoforce_mpc.cli.running.executing import FAILED, note_other_code, run_cells, sayer
from thermoforce_mpc.errors import ConfigError, counted
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.schedule.dates import window_name
from thermoforce_mpc.scenario.testcase import PRICES
from thermoforce_mpc.simulation.comparison.cells import Inputs, expand
from thermoforce_mpc.simulation.comparison.equal_comfort import searches_equal_comfort
from thermoforce_mpc.simulation.comparison.files import (
    FORMS,
    HEADINGS,
    formatted,
    headings,
    own_columns,
    shown_figures,
    write_outcome,
)
from thermoforce_mpc.simulation.comparison.outcome import group_title, grouped, verdicts
from thermoforce_mpc.simulation.comparison.searching import EqualComfort
from thermoforce_mpc.simulation.comparison.store import DONE, Store
from thermoforce_mpc.simulation.comparison.tasks import tasks_of
from thermoforce_mpc.simulation.comparison.variants import ComparisonFile, Variant, comma_list, known_names
from thermoforce_mpc.simulation.composition import check_window
from thermoforce_mpc.simulation.views.display import zone_table
from thermoforce_mpc.simulation.views.whole_tables import plain_table, print_whole

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
        "--forecast-uncertainty",
        metavar="A,B",
        help="none, low, medium, high.  [default: the scenario's, else none]",
    ),
    click.option("--tariff-file", "prices", metavar="FILE", help="CSV (time s, price per kWh): highly dynamic tariff."),
)
_result_options = added(
    click.option(
        "--out",
        type=click.Path(path_type=Path),
        help="Result folder; finished cells in it are reused.  [default: runs/...]",
    ),
    click.option(
        "--format",
        "form",
        type=click.Choice(FORMS),
        help="Print only the figures, in this format, instead of tables for people.",
    ),
    click.option("--quiet", is_flag=True, help="Print only the final tables."),
)
comparison_options = added(
    base_options, _axes_options, learned_options, _result_options, equal_comfort_option, execution_options()
)
"""Options that select cells, plant and parallel execution."""


@dataclass(frozen=True)
class Axes:
    """Windows, tariffs and forecast error levels over which variants are compared."""

    windows: tuple[str, ...]
    prices: tuple[str, ...]
    uncertainties: tuple[str, ...]


def axes_from(options: Mapping[str, Any], base: Scenario, file: ComparisonFile | None = None) -> Axes:
    """The axes from a command's options, else from its file of variants, else from the scenario.

    A scenario without a period gives the peak and the typical day of the building's season.

    Raises:
        ConfigError: an unknown window, tariff or error level, one given twice, or one of the scenario that the file
            would replace.
    """
    if options["windows"] is not None:
        windows = _windows_from(options["windows"])
    else:
        windows = _of_file(base, "period", "windows", file.windows if file else ()) or _windows_of(base)
    for window in windows:
        check_window(window)
    if options["tariffs"] is not None:
        prices = known_names(options["tariffs"], "--prices", PRICES)
    else:
        prices = _of_file(base, "price", "prices", file.prices if file else ()) or (base.price,)
    text = options["forecast_uncertainty"]
    levels: tuple[str, ...] = (base.plant.forecast_uncertainty,)
    if text is not None:
        levels = known_names(text, "--forecast-uncertainty", UNCERTAINTIES)
    return Axes(windows, prices, levels)


def _windows_from(text: str) -> tuple[str, ...]:
    try:
        return tuple(map(window_name, comma_list(text, "--windows")))
    except ValueError as error:
        raise ConfigError(f"--windows: {error}") from error


def _of_file(base: Scenario, key: str, axis: str, values: tuple[str, ...]) -> tuple[str, ...]:
    """The values that a file of variants gives to an axis; raises `ConfigError` where the scenario has its own."""
    if values and key in base.model_fields_set and values != (getattr(base, key),):
        raise ConfigError(
            f"{key}: the scenario has {getattr(base, key)}, and the file of variants {axis}: {', '.join(values)}; say "
            f"with --{axis} which to run"
        )
    return values


def _windows_of(base: Scenario) -> tuple[str, ...]:
    if "period" in base.model_fields_set:
        return (base.period,)
    season = "cool" if load_testcase(base.testcase).mode == "cooling" else "heat"
    return f"peak_{season}_day", f"typical_{season}_day"


def run_comparison(
    base: Scenario,
    variants: Mapping[str, Variant],
    axes: Axes,
    options: Mapping[str, Any],
    *,
    name: str,
    title: str,
    swept: Mapping[str, str] | None = None,
) -> None:
    """Run the cells that have no stored result, then write and print the outcome; exits with 3 where a cell has none.

    Raises:
        ConfigError: an option is wrong; no cell has been run.
        KeyboardInterrupt: interrupted; finished cells are stored.
    """
    inputs = Inputs()
    cells = expand(base, variants, axes.windows, axes.prices, axes.uncertainties, inputs)
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
    records: list[dict[str, Any]] = [{**stored[cell.key], "variant": cell.variant} for cell in cells]
    if searches_equal_comfort(base):
        search = EqualComfort(store, inputs, testcase, lambda text: say(f"searching a thermostat: {text}"))
        records = search.beside(cells, records)
    result = write_outcome(store.folder, records, name=name, title=title, currency=testcase.currency, swept=swept)
    if options["form"] is not None:
        click.echo(formatted(result["rows"], options["form"], title, testcase.currency), nl=False)
    else:
        show_outcome(console, result["rows"], testcase.currency)
        page = shlex.quote(str(store.folder / "comparison.html"))
        console.print(f"Table, CSV, JSON and page: {page}", soft_wrap=True, markup=False)
    if any(record["status"] != DONE for record in records):
        sys.exit(FAILED)


def show_outcome(console: Console, rows: Sequence[dict[str, Any]], currency: str) -> None:
    """Print the tables, the findings and the failed cells."""
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
        console.print(text, soft_wrap=True, markup=False)
    for row in rows:
        if row["status"] != DONE:
            where = f"{row['controller']}, {row['window']}, {row['price']}"
            console.print(f"FAILED {where}: {row['reason']}", soft_wrap=True, markup=False)
