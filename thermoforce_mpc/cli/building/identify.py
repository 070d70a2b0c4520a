"""`tf-mpc identify`: probe a plant or read measurements, identify a model, print it and save it."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange, base_options, probed_option, scenario_from, window_options
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.files import check_writable

if TYPE_CHECKING:
    from thermoforce_mpc.data import Record
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.model.thermal_model import ThermalModel
    from thermoforce_mpc.report.display import RunDisplay

# Exit code of a model that was identified and saved but is not competent.
NOT_COMPETENT = 4
_PROBE = "`tf-mpc data probe-plan` writes the cheapest probing by hand that would tell the effect of acting."
# Options that make no sense with measurements.
_OF_PLANTS = (
    "testcase", "config", "period", "days", "price", "url", "fmu", "weather", "prices", "uncertainty",
    "probe_days", "probing", "controller",
)  # fmt: skip


@click.command()
@base_options
@window_options
@click.option("--probe-days", type=float, help="Days of probing, ending a week before --period.  [default: 3]")
@probed_option
@click.option("--controller", metavar="NAME", help="Probe at the levels that this controller uses.")
@click.option("--data", "files", multiple=True, metavar="FILE", help="Measurements instead of probing; repeatable.")
@click.option("--map", "map_file", type=PATH, help="Map of the measurements (YAML).")
@click.option("--data-days", type=FiniteRange(1.0, 120.0), help="Days of longer measurements used.  [default: 28]")
@click.option("--out", type=PATH, default=Path("model"), help="Model folder.")
@click.option("--overwrite", is_flag=True, help="Replace an existing model.")
def identify(**options: Any) -> None:
    """Identify a thermal model, print it and save it as a model folder.

    A building that can be run is probed for a few days. The probing signal is designed for identifiability and keeps
    the zone near its comfort band. The probing days end where the warm-up of --period begins. If the model is then
    not competent (docs/how-it-works/competence.md), probing goes on day by day, up to identification.most_days (10).

    With --probing the model is identified from what an earlier run of the same test case has probed.

    With --data the model is identified from measurements in CSV or Parquet files, as --map says
    (docs/how-to/own-data.md); of long ones the 28 days that tell most about acting are used.

    A model that stays incompetent is saved, but the controllers do not act on it; the exit code is then 4, and the
    verdict says what to do. The folder also holds a plot of the fit and of the step response with its 90 % band.

    Use the model with `tf-mpc run --model FOLDER` or `tf-mpc plan --model FOLDER`.

    \b
    Example:
      tf-mpc identify --testcase bestest_hydronic_heat_pump --probe-days 3 --out my_model
      tf-mpc run --testcase bestest_hydronic_heat_pump --model my_model
      tf-mpc identify --data house.csv --map map.yaml --out my_house
    """
    out: Path = options["out"]
    if out.exists() and not options["overwrite"]:
        raise ArtifactError(f"--out {out}: exists already; choose another folder or give --overwrite")
    check_writable(out)
    if options["files"] or options["map_file"]:
        _from_measurements(options)
        return
    if options["data_days"] is not None:
        raise click.UsageError("--data-days belongs to --data")
    from thermoforce_mpc.experiment.experiment import Experiment
    from thermoforce_mpc.experiment.identifying import identification_task, run_identification
    from thermoforce_mpc.report.display import RunDisplay
    from thermoforce_mpc.scenario.scenario import Scenario
    from thermoforce_mpc.scenario.settings import merge, validate

    scenario = scenario_from(options)
    if options["probe_days"] is not None:
        changed = merge(scenario.model_dump(), {"identification": {"days": options["probe_days"]}})
        scenario = validate(Scenario, changed, "--probe-days")
    experiment = Experiment.of(scenario)
    task = identification_task(scenario, experiment.own.chosen)
    display = RunDisplay()
    records: list[Record] = []
    with closing(experiment.plant.build()) as plant:
        display.say(f"Plant: {plant.info.kind} {plant.info.testcase}\nWeather: {plant.info.weather}")
        with display.probing(task.in_words()) as progress:
            model = run_identification(task, plant, records.append, progress, say=display.say)
    _finish(model, records[0], out, display, overwrite=options["overwrite"])


def _from_measurements(options: dict[str, Any]) -> None:
    files, map_file = options["files"], options["map_file"]
    if not files or map_file is None:
        raise click.UsageError("--data and --map belong together (see `tf-mpc data map FILE`)")
    others = [name for name in _OF_PLANTS if options.get(name)]
    if others:
        raise click.UsageError(f"--{others[0].replace('_', '-')} is for probing a plant: leave it out with --data")
    from thermoforce_mpc.experiment.identifying import may_act
    from thermoforce_mpc.experiment.measured_model import model_of_measurements
    from thermoforce_mpc.report.display import RunDisplay

    display, config = RunDisplay(), _options(options)
    days = options["data_days"]
    try:
        model, record = model_of_measurements(files, map_file, days=days, config=config, say=display.say)
    except DataError as error:
        raise DataError(f"{error}\n{_PROBE}") from error
    if not may_act(model):
        display.say(_PROBE)
    _finish(model, record, options["out"], display, overwrite=options["overwrite"])


def _options(options: dict[str, Any]) -> IdentificationConfig:
    """Options of the identification in --seed and --set; of the latter only those make sense with measurements."""
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.scenario.settings import parse_overrides, validate

    overrides = parse_overrides(options.get("assignments", ()))
    chosen = overrides.get("identification", {}).get("options", {})
    if overrides and overrides != {"identification": {"options": chosen}}:
        raise click.UsageError("with --data, --set takes identification.options.KEY=VALUE only")
    seed = {} if options.get("seed") is None else {"seed": options["seed"]}
    return validate(IdentificationConfig, seed | chosen, "--set identification.options")


def _finish(model: ThermalModel, record: Record, out: Path, display: RunDisplay, *, overwrite: bool) -> None:
    """Save and show a model and the plot of its fit; exit code 4 where it is not competent."""
    from thermoforce_mpc.cli.inside.inspect import show_model
    from thermoforce_mpc.experiment.identifying import may_act
    from thermoforce_mpc.whatif.identified import PLOT_NAME, plot_identification

    model.save(out, overwrite=overwrite)
    show_model(str(out), model, display.console)
    plot_identification(out / PLOT_NAME, model, record)
    display.say(f"Plot of fit and step response: {out / PLOT_NAME}")
    if not may_act(model):
        click.get_current_context().exit(NOT_COMPETENT)
