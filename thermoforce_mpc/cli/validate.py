"""`tf-mpc validate FILE`: check a YAML file without running anything."""

from __future__ import annotations

from pathlib import Path

import click

from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.checks import validate_scenario


@click.command(short_help="Check a scenario or test case file.")
@click.argument("file", type=click.Path(path_type=Path))
def command(file: Path) -> None:
    """Check FILE, a scenario or a test case; an error names file, key and allowed values.

    A file with one of the keys `actuator`, `zones` and `measurements` is read as a test case, any other as a scenario.
    Exit code 2 when it is invalid.
    """
    data = read_yaml(file)
    if data.keys() & {"actuator", "zones", "measurements"}:
        testcase = validate(TestCase, data, str(file))
        click.echo(f"{file}: valid test case '{testcase.name}'")
        return
    scenario = validate(Scenario, data, str(file))
    validate_scenario(scenario)
    click.echo(f"{file}: valid scenario, {scenario.controller.name} on {scenario.testcase}, {scenario.period}")
