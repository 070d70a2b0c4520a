"""`tf-mpc validate FILE`: check a YAML file without running anything."""

from __future__ import annotations

from pathlib import Path

import click

from thermoforce_mpc.plants.registry import check_surroundings
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import read_yaml, validate
from thermoforce_mpc.simulation.checks import check_contestants, validate_scenario
from thermoforce_mpc.simulation.schemas import KINDS

# A key that only files of this kind have; any other file is a scenario.
_KIND_OF = {
    "buildings": "fleet", "variants": "comparison", "outdoor": "map", "actuator": "testcase", "zones": "testcase",
    "measurements": "testcase",
}  # fmt: skip


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
def command(file: Path) -> None:
    """Check FILE, a scenario, test case, comparison, fleet or map; an error names file, key and allowed values.

    A comparison has the key `variants`, a fleet `buildings`, a map `outdoor`, a test case `actuator`, `zones` or
    `measurements`. Of a scenario, weather, prices, model and forecaster are loaded too. Whether a map fits a table
    is said by `tf-mpc data check`. Exit code 2 when it is invalid.
    """
    data = read_yaml(file)
    kind = next((kind for key, kind in _KIND_OF.items() if key in data), "scenario")
    if kind != "scenario":
        validate(KINDS[kind], data, str(file))
        click.echo(f"{file}: valid {kind}")
        return
    scenario = validate(Scenario, data, str(file))
    testcase = validate_scenario(scenario)
    check_surroundings(scenario.plant)
    check_contestants(scenario, testcase)
    click.echo(f"{file}: valid scenario, {scenario.controller.name} on {scenario.testcase}, {scenario.period}")
