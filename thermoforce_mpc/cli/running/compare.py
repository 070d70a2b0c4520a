"""`tf-mpc compare`: compare controllers on the same windows and tariffs."""

from __future__ import annotations

from typing import Any

import click

from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.cli.running.comparing import (
    axes_from,
    comparison_options,
    run_comparison,
)
from thermoforce_mpc.simulation.comparison.variants import comma_list, load_comparison, variants_by_name

_CONTESTANTS = "thermoforce_mpc,thermostat,native"


@click.command()
@comparison_options
@click.option("--controllers", metavar="A,B", help=f"Names (see `tf-mpc controllers`).  [default: {_CONTESTANTS}]")
@click.option("--variants", metavar="FILE", help="Controllers with options: YAML file or shipped name.")
def command(**options: Any) -> None:
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
    variants = variants_by_name(names, file)
    base = scenario_from(options, file.scenario if file else None)
    axes = axes_from(options, base, file)
    run_comparison(base, variants, axes, options, name="compare", title=f"Controllers compared on {base.testcase}")
