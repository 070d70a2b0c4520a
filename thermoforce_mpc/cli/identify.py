"""`tf-mpc identify`: probe, learn, show, save."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import click

from thermoforce_mpc.cli.inspect import show_model
from thermoforce_mpc.cli.options import scenario_from, scenario_options
from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.scenario.settings import merge
from thermoforce_mpc.simulation.checks import validate_scenario
from thermoforce_mpc.simulation.composition import build_plant
from thermoforce_mpc.simulation.display import RunDisplay
from thermoforce_mpc.simulation.identifying import identification_task, run_identification


@click.command(short_help="Probe a building for a few days and save what was identified.")
@scenario_options
@click.option("--probe-days", type=float, help="Days of probing, ending a week before --period.  [default: 3]")
@click.option("--controller", metavar="NAME", help="Probe the way this controller will act.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("model"), show_default=True, help="Model folder.")
@click.option("--overwrite", is_flag=True, help="Replace a model that is there already.")
def command(**options: Any) -> None:
    """Probe a building for a few days, identify what our actions do to it, show it and save it as a model folder.

    The probing chooses its actions for what can be identified from them, and keeps the zone near its comfort band. The
    folder also gets a picture of the fit and of the step response with its uncertainty.

    The probing days end where the warm-up of --period begins. Use the model with `tf-mpc run --model FOLDER`.

    \b
    Example:
      tf-mpc identify --testcase bestest_hydronic_heat_pump --probe-days 3 --out my_model
      tf-mpc run --testcase bestest_hydronic_heat_pump --model my_model
    """
    out: Path = options["out"]
    if out.exists() and not options["overwrite"]:
        raise ArtifactError(f"--out {out}: exists already; choose another folder or give --overwrite")
    scenario = scenario_from(options)
    if options["probe_days"] is not None:
        changed = merge(scenario.model_dump(), {"identification": {"days": options["probe_days"]}})
        scenario = type(scenario).model_validate(changed)
    testcase = validate_scenario(scenario)
    task = identification_task(scenario, testcase)
    display = RunDisplay()
    records: list[Record] = []
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        display.say(f"Plant: {plant.info.kind} {plant.info.testcase}\nWeather: {plant.info.weather}")
        with display.working(f"Probing for {task.days:g} days and identifying"):
            model = run_identification(task, plant, records.append)
    model.save(out, overwrite=options["overwrite"])
    show_model(str(out), model, display.console)
    from thermoforce_mpc.identification.report import PLOT_NAME, plot_identification

    plot_identification(out / PLOT_NAME, model, records[0])
    display.say(f"Fit and step response with its band: {out / PLOT_NAME}")
