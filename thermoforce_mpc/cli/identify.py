"""`tf-mpc identify`: probe a plant, identify a model, print it and save it."""

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
from thermoforce_mpc.simulation.identifying import identification_task, may_act, run_identification

# Exit code of a model that was identified and saved but is below the bar.
BELOW_THE_BAR = 4


@click.command(short_help="Probe a building for a few days, identify and save a model.")
@scenario_options
@click.option("--probe-days", type=float, help="Days of probing, ending a week before --period.  [default: 3]")
@click.option("--controller", metavar="NAME", help="Probe at the levels that this controller uses.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("model"), show_default=True, help="Model folder.")
@click.option("--overwrite", is_flag=True, help="Replace an existing model.")
def command(**options: Any) -> None:
    """Probe a building for a few days, identify a thermal model, print it and save it as a model folder.

    The probing signal is designed for identifiability and keeps the zone near its comfort band. The folder also holds
    a plot of the fit and of the step response with its 90 % band.

    The probing days end where the warm-up of --period begins. If the model is then below the bar (docs/competence.md),
    probing goes on day by day, up to identification.most_days (10). A model that stays below the bar is saved, but the
    controllers do not act on it; the exit code is then 4, and the verdict says what to do.

    Use the model with `tf-mpc run --model FOLDER`.

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
        with display.probing(task.days) as progress:
            model = run_identification(task, plant, records.append, progress)
    model.save(out, overwrite=options["overwrite"])
    show_model(str(out), model, display.console)
    from thermoforce_mpc.identification.report import PLOT_NAME, plot_identification

    plot_identification(out / PLOT_NAME, model, records[0])
    display.say(f"Plot of fit and step response: {out / PLOT_NAME}")
    if not may_act(model):
        click.get_current_context().exit(BELOW_THE_BAR)
