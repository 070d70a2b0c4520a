"""`tf-mpc init`: files to start from."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import storage_errors, write_whole

_SCHEMAS = "schema"


@click.command()
@click.argument("folder", metavar="[DIR]", default=".", type=click.Path(path_type=Path))
@click.option("--testcase", default="bestest_hydronic_heat_pump", show_default=True, help="Building of the scenario.")
@click.option("--copy-testcase", is_flag=True, help="Copy that test case to testcase.yaml, to make it yours.")
@click.option("--data", metavar="FILE", help="Write map.yaml too, guessed from this table of measurements.")
def command(folder: Path, testcase: str, copy_testcase: bool, data: str | None) -> None:
    """Write a commented scenario to DIR, with every key, its meaning and its default, ready to run.

    Nothing is overwritten. The schemas of the files are written beside them, so that editors complete keys.

    \b
    Examples:
      tf-mpc init my_study
      tf-mpc init my_house --testcase bestest_hydronic --copy-testcase
      tf-mpc init my_house --data house.csv
    """
    from thermoforce_mpc.measurements.map.starting_map import starting_map
    from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
    from thermoforce_mpc.scenario.settings import find_config, is_config
    from thermoforce_mpc.scenario.starting_scenario import scenario_text
    from thermoforce_mpc.simulation.schemas import schema_text

    building = load_testcase(testcase)
    implemented = building.embedded or building.energyplus or building.plant
    reference = str(Path(testcase).absolute()) if Path(testcase).suffix in (".yaml", ".yml") else testcase
    overrides = {"testcase": "testcase.yaml" if copy_testcase else reference}
    scenario = load_scenario(
        None, overrides | {"testcase": testcase, "plant": {"kind": "embedded" if implemented else "boptest"}}
    )
    texts = {"scenario": _headed("scenario", scenario_text(scenario.model_copy(update=overrides)))}
    if copy_testcase:
        if building.name == testcase and not is_config("testcases", testcase):
            raise ConfigError(f"--copy-testcase: '{testcase}' is made, not read from a file; leave the option out")
        path = find_config("testcases", testcase.replace("energyplus:", "energyplus_", 1))
        texts["testcase"] = _headed("testcase", path.read_text(encoding="utf-8"))
    if data is not None:
        texts["map"] = _headed("map", starting_map(data))
    files = {folder / f"{kind}.yaml": text for kind, text in texts.items()}
    existing = [str(path) for path in files if path.exists()]
    if existing:
        raise ConfigError(f"{', '.join(existing)}: there already, and never overwritten; choose another folder")
    files |= {folder / _SCHEMAS / f"{kind}.json": schema_text(kind) for kind in texts}
    for path, text in files.items():
        with storage_errors(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
    _print_next_steps(folder, texts, implemented=bool(implemented), data=data)


def _headed(kind: str, text: str) -> str:
    """The text of a file with the line that names its schema."""
    lines = [line for line in text.splitlines() if not re.match(r"#\s*yaml-language-server:", line)]
    return "\n".join([f"# yaml-language-server: $schema={_SCHEMAS}/{kind}.json", *lines]) + "\n"


def _print_next_steps(folder: Path, texts: dict[str, str], *, implemented: bool, data: str | None) -> None:
    for kind in texts:
        click.echo(f"Wrote {folder / kind}.yaml")
    enter = "" if folder == Path() else f"cd {shlex.quote(str(folder))} && "
    what = " (the simulated test case, not your measurements)" if data is not None else ""
    click.echo(f"Run it:   {enter}tf-mpc run --config scenario.yaml{what}")
    if not implemented:
        click.echo("The plant is a BOPTEST service: set plant.url, or plant.kind: fmu and plant.path.")
    if data is not None:
        table = shlex.quote(str(Path(data).absolute()))
        click.echo(f"Check it: {enter}tf-mpc data check {table} --map map.yaml")
