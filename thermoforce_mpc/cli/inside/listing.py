"""What is there by name: test cases and files, controllers, plants, connections and free responses with their options.

A command imports its registry when it is called: some load much.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from thermoforce_mpc.files import named_configs
from thermoforce_mpc.plants.testcases import MADE_TESTCASES, load_testcase
from thermoforce_mpc.registry import OWN, Registry
from thermoforce_mpc.scenario.own_code import first_line, options_model
from thermoforce_mpc.scenario.settings import read_yaml

if TYPE_CHECKING:
    from thermoforce_mpc.model.free_response.backbones.known import Known

T = TypeVar("T")
_NAME = click.argument("name", required=False)


@click.command()
@_NAME
def controllers(name: str | None) -> None:
    """List the controllers, or every option of the controller NAME with its default and unit.

    Options are set with --set controller.options.KEY=VALUE or in a scenario file. Controllers of other distributions
    stand with their origin (docs/how-to/plugins.md).
    """
    from controllers.registry import REGISTRY, find_entry

    if name is None:
        _show_names(REGISTRY, lambda entry: entry.summary)
        click.echo("\n`tf-mpc controllers NAME` lists the options of a controller.")
    else:
        entry = find_entry(name)
        _show_options(f"{name}: {entry.summary}", entry.config(), entry.defaults, "controller.options.")


@click.command()
@_NAME
def plants(name: str | None) -> None:
    """List the plants, or every option of the plant NAME with its default and unit.

    A test case names the plant that implements it; --url and --fmu choose another, and --set plant.kind=NAME a
    plugin's. Options are set with --set plant.options.KEY=VALUE or in a scenario file. Plants of other distributions
    stand with their origin (docs/how-to/plugins.md).
    """
    from thermoforce_mpc.plants.registry import REGISTRY

    if name is None:
        _show_names(REGISTRY, lambda entry: entry.summary)
    else:
        entry = REGISTRY.find(name)
        _show_options(f"{name}: {entry.summary}", entry.config(), {}, "plant.options.")


@click.command()
@_NAME
def connections(name: str | None) -> None:
    """List the connections of `tf-mpc control`, or every option of the connection NAME with its default.

    Options are set with --set connection.KEY=VALUE. Connections of other distributions stand with their origin
    (docs/how-to/connection.md).
    """
    from thermoforce_mpc.connections.registry import REGISTRY

    if name is None:
        _show_names(REGISTRY, first_line)
    else:
        make = REGISTRY.find(name)
        _show_options(f"{name}: {first_line(make)}", options_model(make, ()), {}, "connection.")


@click.command()
@_NAME
def free_responses(name: str | None) -> None:
    """List the free responses and the forecasters, or the options of the free response or forecaster NAME.

    A free response is chosen with --forecaster or --set controller.options.free_response.name=NAME, its options with
    --set controller.options.free_response.options.KEY=VALUE. The forecaster (backbone) of `residual` and `chronos` is
    chosen with --forecaster: one of those listed, a directory, or a hub name, owner/model or owner/model@revision.
    Those of other distributions stand with their origin (docs/how-to/plugins.md).
    """
    from thermoforce_mpc.model.free_response.backbones.known import KNOWN
    from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as BACKBONES
    from thermoforce_mpc.model.free_response.registry import REGISTRY, options_of

    if name is None:
        click.echo("Free responses:")
        _show_names(REGISTRY, first_line)
        click.echo("\nForecasters of residual and chronos (--forecaster NAME, a directory, or owner/model on the hub):")
        _show_table(KNOWN)
        _show_names(BACKBONES, first_line, without={model.name for model in KNOWN})
        return
    for model in KNOWN:
        if model.name == name:
            _show_table([model])
            click.echo(model.missing() or "it can be used here")
            return
    build = REGISTRY.find(name)
    click.echo(f"{name}: {first_line(build)}\n")
    for key, default in options_of(build).items():
        click.echo(f"  controller.options.free_response.options.{key}  (default {default!r})")


def _show_table(forecasters: Sequence[Known]) -> None:
    rows = [("name", "parameters", "licence", "weather read", "extra", "weights", "usable here")]
    for one in forecasters:
        here = one.missing().partition(": ")[0] or "yes"
        rows.append((one.name, one.parameters, one.licence, one.covariates, one.extra or "–", one.weights, here))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _show_names(registry: Registry[T], summary: Callable[[T], str], without: Collection[str] = ()) -> None:
    """Print each name but those `without` with its summary; under that of a plugin where it is from, and its fault."""
    for entry in registry.listing():
        if entry.name in without and entry.origin == OWN:
            continue
        click.echo(f"{entry.name:18s} {'cannot be used' if entry.found is None else summary(entry.found)}".rstrip())
        if entry.origin != OWN:
            click.echo(f"{'':18s} from {entry.origin}")
        if entry.problem:
            click.echo(f"{'':18s} {entry.problem}")


def _show_options(title: str, model: type[BaseModel], defaults: Mapping[str, Any], prefix: str) -> None:
    if title:
        click.echo(f"{title}\n")
    for key, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True)
        if isinstance(default, BaseModel):
            _show_options("", type(default), defaults.get(key, {}), f"{prefix}{key}.")
            continue
        value = defaults.get(key, default)
        value = str(value) if isinstance(value, Path) else value
        shown = "required" if value is PydanticUndefined else f"default {value!r}"
        click.echo(f"  {prefix}{key}  ({shown})" + (f"\n      {field.description}" if field.description else ""))


@click.command()
def testcases() -> None:
    """List the shipped test cases, scenarios, comparisons and fleets, with their files."""
    click.echo("Test cases (--testcase NAME):")
    for name, path in named_configs("testcases").items():
        testcase = load_testcase(name)
        on_engine = testcase.energyplus is not None or testcase.plant == "small_office"
        ships = "EnergyPlus (extra [energyplus])" if on_engine else ""
        embedded = testcase.embedded or testcase.plant is not None
        plants = ships or f"{'embedded emulator, ' if embedded else ''}BOPTEST service (--url), FMU (--fmu)"
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
