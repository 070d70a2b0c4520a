"""`tf-mpc run`: run a controller over a scored window and write a run folder."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from thermoforce_mpc.cli.options import (
    base_options,
    equal_comfort_option,
    learned_options,
    mpc_options,
    scenario_from,
    window_options,
)


@click.command()
@base_options
@window_options
@click.option("--controller", metavar="NAME", help="Controller (see `tf-mpc controllers`).")
@learned_options
@mpc_options
@click.option("--baselines", metavar="A,B", help="Baselines to run; '' for none.  [default: native,thermostat]")
@equal_comfort_option
@click.option("--out", type=click.Path(path_type=Path), help="Run folder; must not exist.  [default: runs/...]")
@click.option("--quiet", is_flag=True, help="Print only the final table.")
def command(**options: Any) -> None:
    """Run a controller over a scored window and report KPIs.

    Builds the plant, probes it for a few days and identifies a model (or loads --model, or identifies from the probing
    of an earlier run of the same test case, --probing), runs the controller over the
    window after seven days of warm-up under native control, runs the baselines on the same plant, weather and window,
    and the thermostat at the set-point at which it is as comfortable as the controller. Prints the KPIs of all
    controllers and writes a run folder with an HTML report.

    \b
    Examples:
      tf-mpc run --testcase bestest_hydronic_heat_pump
      tf-mpc run --testcase bestest_hydronic_heat_pump --period typical_heat_day --weather Brussels.mos
      tf-mpc run --testcase bestest_hydronic_heat_pump --url http://127.0.0.1:8000
      tf-mpc run --testcase bestest_hydronic_heat_pump --fmu wrapped.fmu
      tf-mpc run --config peak_heat_day --start 2026-01-17 --horizon 36h
      tf-mpc run --config peak_heat_day --probing runs/my_run --set identification.options.order=2
    """
    from thermoforce_mpc.simulation.run import run_scenario
    from thermoforce_mpc.simulation.views.display import RunDisplay

    scenario = scenario_from(options)
    display = RunDisplay(options["quiet"])
    folder = run_scenario(scenario, display, options["out"], command=["tf-mpc", *sys.argv[1:]])
    display.console.print(f"Report: {shlex.quote(str(folder / 'report.html'))}", soft_wrap=True, markup=False)
