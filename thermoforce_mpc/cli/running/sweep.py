"""`tf-mpc sweep`: run one controller for several values of one option."""

from __future__ import annotations

from typing import Any

import click

from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.cli.running.comparing import (
    axes_from,
    comparison_options,
    run_comparison,
)
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.simulation.comparison.variants import comma_list, numeric_option, swept_variants, variants_by_name

_VALUES = "0.0026,0.005,0.01,0.026,0.05,0.1"


@click.command()
@comparison_options
@click.option(
    "--controller", "varied", default="thermoforce_mpc", show_default=True, metavar="NAME", help="Controller to vary."
)
@click.option(
    "--over",
    default="comfort_weight_per_m2",
    show_default=True,
    metavar="KEY",
    help="Numeric option (dotted name, or its last part if unique).",
)
@click.option("--values", default=_VALUES, show_default=True, metavar="X,Y", help="Values of the option.")
@click.option(
    "--beside",
    default="thermostat,native",
    show_default=True,
    metavar="A,B",
    help="Controllers run for comparison; '' for none.",
)
def command(**options: Any) -> None:
    """Run one controller for several values of one option and plot cost against discomfort.

    As `tf-mpc compare`: parallel processes, resumable, one identification per window.

    \b
    Examples:
      tf-mpc sweep --testcase bestest_hydronic_heat_pump
      tf-mpc sweep --testcase bestest_hydronic_heat_pump --controller pi --over kp --values 0.2,0.5,1,2
      tf-mpc sweep --testcase bestest_hydronic_heat_pump --over horizon_h --values 12,24,48 --windows 44

    \b
    Exit codes: 0 all cells have a result, 2 bad input, 3 a cell failed (the others are stored), 7 the cluster is gone,
    130 interrupted.
    """
    base = scenario_from(options)
    testcase = load_testcase(base.testcase)
    controller = options["varied"]
    key = numeric_option(controller, options["over"])
    values = [_number(word) for word in comma_list(options["values"], "--values")]
    swept = swept_variants(controller, key, values, testcase)
    labels = {name: f"{value:g}" for name, value in zip(swept, values, strict=True)}
    beside = variants_by_name(comma_list(options["beside"], "--beside"), None) if options["beside"].strip() else {}
    title = f"{controller} over {key} on {base.testcase}"
    variants = {**swept, **beside}
    run_comparison(base, variants, axes_from(options, base), options, name="sweep", title=title, swept=labels)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigError(f"--values: '{word}' is not a number") from None
