"""`tf-mpc testcases`: list the shipped test cases, scenarios, comparisons and fleets."""

from __future__ import annotations

import click

from thermoforce_mpc.plants.testcases import MADE_TESTCASES, load_testcase
from thermoforce_mpc.registry import OWN
from thermoforce_mpc.scenario.settings import named_configs, read_yaml


@click.command()
def command() -> None:
    """List the shipped test cases, scenarios, comparisons and fleets, with their files."""
    click.echo("Test cases (--testcase NAME):")
    for name, path in named_configs("testcases").items():
        testcase = load_testcase(name)
        on_engine = testcase.energyplus is not None or testcase.plant == "small_office"
        ships = "EnergyPlus (extra [energyplus])" if on_engine else ""
        plants = ships or f"{'embedded emulator, ' if testcase.embedded else ''}BOPTEST service (--url), FMU (--fmu)"
        click.echo(f"  {name}\n      {testcase.description}\n      plant: {plants}; {path}")
    click.echo("  house:Nrooms, house:Nrooms:SEED\n      drawn house of N rooms (1 to 30), a valve each, one heat pump")
    click.echo("  office:Nrooms, office:Nrooms:SEED\n      drawn office likewise, light and set back at night")
    click.echo("      plant: its own, nothing to install (docs/how-it-works/random-buildings.md)")
    click.echo("  generated:SEED:INDEX\n      house number INDEX of a population, one zone, any emitter and machine")
    click.echo("      plant: its own, nothing to install (docs/how-it-works/random-buildings.md)")
    for entry in MADE_TESTCASES.listing():
        if entry.origin != OWN:
            click.echo(f"  {entry.name}\n      {entry.problem or 'made by a plugin'}\n      from {entry.origin}")
    click.echo("\nScenarios (--config FILE):")
    for name, path in named_configs("scenarios").items():
        click.echo(f"  {name}: {read_yaml(path).get('testcase')}; {path}")
    click.echo("\nComparisons (tf-mpc compare --variants NAME):")
    for name, path in named_configs("comparisons").items():
        click.echo(f"  {name}: {', '.join(read_yaml(path)['variants'])}; {path}")
    click.echo("\nFleets (tf-mpc fleet NAME):")
    for name, path in named_configs("fleets").items():
        click.echo(f"  {name}: {', '.join(map(str, read_yaml(path)['windows']))}; {path}")
