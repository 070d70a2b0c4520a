"""One scenario from start to end: identify, run the controller and its baselines, write the run folder, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from controllers.registry import lent
from thermoforce_mpc.data.clock import seconds_of
from thermoforce_mpc.errors import ConfigError, counted
from thermoforce_mpc.experiment.equal_comfort import (
    THERMOSTAT,
    as_comfortable,
    run_shifted,
)
from thermoforce_mpc.experiment.experiment import Experiment, Setting, check_contestants
from thermoforce_mpc.experiment.identifying import IdentifiedModel
from thermoforce_mpc.experiment.outside import note_given, with_given
from thermoforce_mpc.experiment.run_book import RunBook, ended_early
from thermoforce_mpc.experiment.run_models import (
    frozen_proof,
    identify_all,
    kept_models,
    origins_of,
    weight_hash,
)
from thermoforce_mpc.experiment.scenario_result import ScenarioResult, headline, print_summary, write_results
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.plants.boptest.plant import allow_token
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.records.recorded_plant import JournaledPlant
from thermoforce_mpc.records.run_folder import (
    clear_partial,
    create_run_folder,
    file_stem,
    is_complete,
    is_empty,
    log_step,
    logging_to,
    sole_use,
    with_own_kpis,
)
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.findings import DISCOMFORT
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import merge

if TYPE_CHECKING:  # loaded only when a controller needs a model
    import pandas as pd

    from thermoforce_mpc.model.thermal_model import ThermalModel


def run(
    testcase: str,
    *,
    controller: str | Controller | type = "thermoforce_mpc",
    kpis: Sequence[str | Callable[[pd.DataFrame], float]] = (),
    model: ThermalModel | None = None,
    progress: bool = True,
    **settings: Any,
) -> ScenarioResult:
    """Control a building over a scored window; nothing is written (`tf-mpc run` also writes a folder and a report).

    Args:
        testcase: a test case that ships, by name, or the path of a YAML file.
        controller: name in the registry, see `tf-mpc controllers`; a controller of your own (`Controller`), or a class
            of one.
        kpis: KPIs of your own: functions of the trajectory (a table, one row a block), see `own_kpis`.
        model: an identified model; by default the plant is probed and a model identified first.
        progress: say on the terminal how far the run is.
        settings: any other key of a scenario file: `days`, `period`, `price`, `plant`, `baselines`, `seed`, ….

    Raises:
        InputError: something given cannot be used; the message names the key.
        PlantError: the plant or its service failed.
    """
    with nullcontext(controller) if isinstance(controller, str) else lent(controller) as name:
        scenario = load_scenario(None, merge({"testcase": testcase, "controller": {"name": name}}, settings))
        if "url" in scenario.plant.model_fields_set:
            allow_token(scenario.plant.url)
        return _execute(Experiment.of(scenario, kpis), RunDisplay(quiet=not progress), {}, model)


def run_scenario(scenario: Scenario, display: RunDisplay, out: Path | None, command: Sequence[str]) -> Path:
    """Run a scenario and its baselines, print the KPI table, and write the run folder, which is returned.

    Raises:
        InputError: something given cannot be used, or another run has the folder; nothing is left behind.
        PlantError: the plant or service failed; what had been recorded is in the run folder the message names. One that
            was never reached leaves nothing behind.
        StorageError: the disk is full, or the folder cannot be written any more; the plant was released.
    """
    experiment = Experiment.of(scenario)
    note_given(scenario)
    folder = create_run_folder(
        out, f"{experiment.testcase.name}-{experiment.window}-{experiment.price}-{file_stem(experiment.own.name)}"
    )
    with sole_use(folder):
        if not is_empty(folder):  # another run was quicker
            raise ConfigError(f"{folder}: exists already and is never overwritten; choose another folder")
        return _carry_out(RunBook.begin(folder, experiment, command), display)


def resume_run(
    folder: Path,
    display: RunDisplay,
    since: str | None = None,
    given: Mapping[str, str] | None = None,
    code: Sequence[str] = (),
) -> Path:
    """Go on with a run that was ended before its time, from its journal; the result is that of an undisturbed run.

    `since`: line of the journal, or a time (`seconds_of`), from which on its records are lost; `given`, `code`: as of
    `with_given`.

    Raises:
        ConfigError: the journal names something outside that is neither known nor given; there is a link in the folder.
        JournalError: there is no journal, it is damaged, or the run does not repeat itself.
        NoSuchTest: the run was on a service that no longer has its test.
        PlantError, StorageError: as `run_scenario`.
    """
    with sole_use(folder):
        if is_complete(folder):
            display.say(f"{folder} is complete; there is nothing to resume")
            return folder
        at = None if since is None else int(since) if since.isdecimal() else seconds_of(since, "--from")
        book = _reopened(folder, given, code, at)
        steps = sum(entry.kind == "done" for entry in book.told)
        display.say(f"Resuming after {counted(steps, 'recorded step')}")
        return _carry_out(book, display)


def stop_test(folder: Path, given: Mapping[str, str] | None = None, code: Sequence[str] = ()) -> None:
    """Stop the test that a run has at a service, which then cannot go on; arguments and errors as of `resume_run`."""
    with sole_use(folder):
        book = _reopened(folder, given, code)
        with closing(book.journal):
            plant = book.experiment.plant
            if not (book.told and plant.outlives_us):
                raise ConfigError(f"{folder}: its plant is simulated, or was never reached: there is no test to stop")
            book.connect(plant.build).close()


def _reopened(
    folder: Path, given: Mapping[str, str] | None, code: Sequence[str], at: int | float | None = None
) -> RunBook:
    # What acts outside the folder is asked for before anything of it is looked up.
    return RunBook.reopen(folder, at, lambda told: Experiment.of(with_given(told, given or {}, code, folder)))


def _carry_out(book: RunBook, display: RunDisplay) -> Path:
    """Run what is in the book, and write results and report."""
    folder, testcase = book.folder, book.experiment.testcase
    records: dict[str, KeptSteps[StepRecord]] = {}
    try:
        with closing(book.journal), logging_to(folder, display.say):
            outcome = _execute(book.experiment, display, records, book=book)
    except BaseException as error:
        ended = ended_early(book, records, error)
        if ended is error:
            raise
        raise ended from error
    clear_partial(folder)
    kpis = write_results(folder, outcome, book.command, testcase.currency)
    with display.working("Drawing the report"):
        from thermoforce_mpc.report import write_report

        write_report(
            folder,
            currency=testcase.currency,
            kpis=kpis,
            result=outcome.result,
            baselines=outcome.baselines,
            layout=testcase.layout,
            area_m2=testcase.area_m2,
            model=outcome.models.get(outcome.result.controller),
        )
    print_summary(outcome, folder, testcase.currency, kpis["power_cap"], display)
    return folder


def build_plant(experiment: Experiment, testid: str | None = None) -> Plant:
    """The plant of an experiment; raises as `ChosenPlant.build`."""
    return experiment.plant.build(testid)


def _execute(
    experiment: Experiment,
    display: RunDisplay,
    records: dict[str, KeptSteps[StepRecord]],
    model: ThermalModel | None = None,
    book: RunBook | None = None,
) -> ScenarioResult:
    """Build the plant, identify unless there is a `model`, run everyone; `records` keeps the steps if the plant fails.

    With a `book`, all that the controllers get is written to its journal, or taken from it.
    """
    if book is None or not book.told:  # a run that is resumed has its models in its folder
        check_contestants(experiment)
    own, *baselines = experiment.contestants

    def build(testid: str | None = None) -> Plant:
        return build_plant(experiment, testid)

    with book.released(book.connect(build)) if book else closing(build()) as plant:
        setting = Setting.of(plant, experiment)
        display.say(headline(plant, setting.period, experiment))
        identified: Mapping[str, IdentifiedModel] = {}
        models: dict[str, ThermalModel | str] = {}
        if model is not None:
            models |= {one.name: model for one in experiment.contestants if one.chosen.needs_model}
        elif book and isinstance(plant, JournaledPlant):
            # Probing has journals of its own: the journal of the run has the models, which are what comes of it.
            find = partial(identify_all, experiment.contestants, plant.inside, display, book.folder)
            identified = kept_models(plant, book.folder, find)
        else:
            identified = identify_all(experiment.contestants, plant, display)
        models |= {who: found.acts_on for who, found in identified.items()}

        def follow(controller: Controller) -> RunResult:
            steps = records.setdefault(controller.name, KeptSteps(book.folder if book else None))
            return with_own_kpis(_follow(setting, controller, display, steps), experiment.kpis)

        controller = own.chosen.build(models.get(own.name))
        actuation = getattr(controller, "actuation_in_words", None)
        if actuation:
            display.say(f"Actuation: {actuation}")
        hash_before = weight_hash(controller)
        result = follow(controller)
        forecaster = frozen_proof(controller, hash_before)
        beside = {one.name: follow(one.chosen.build(models.get(one.name))) for one in baselines}
        equal, thermostat = None, experiment.contestant(THERMOSTAT)
        if thermostat and THERMOSTAT in beside and own.chosen.needs_model and experiment.equal_comfort:
            # Not part of the run that a journal tells: it is searched again where that is resumed.
            again = replace(setting, plant=plant.inside) if isinstance(plant, JournaledPlant) else setting
            run_at = run_shifted(thermostat.chosen, lambda shifted: again.run(shifted).kpis)
            with display.working("Searching the thermostat that is as comfortable"):
                equal = as_comfortable(run_at, beside[THERMOSTAT].kpis, result.kpis[DISCOMFORT])
        usable = {who: model for who, model in models.items() if not isinstance(model, str)}
        origins = origins_of(identified, own.name)
        if actuation and origins:
            origins["actuation"] = actuation
        if isinstance(plant, JournaledPlant) and plant.differing:
            display.say(f"{counted(plant.differing, 'step')} planned otherwise than then; what acted then counts")
        return ScenarioResult(experiment, plant.info, result, beside, usable, origins, forecaster, equal)


def _follow(setting: Setting, controller: Controller, display: RunDisplay, steps: KeptSteps[StepRecord]) -> RunResult:
    """One closed loop, shown and recorded step by step so that a failure half way loses nothing."""
    plant = setting.plant
    keeper = plant if isinstance(plant, JournaledPlant) else None
    if keeper:
        keeper.noted("loop", lambda: {"controller": controller.name})
    kpis = keeper.kpis_so_far if keeper else plant.kpis
    with display.loop(controller.name, setting.period, kpis, setting.experiment.testcase.currency) as progress:

        def on_step(record: StepRecord) -> None:
            progress.step(record)
            if not (keeper and keeper.catching_up):
                log_step(controller.name, record)

        return setting.run(controller, on_step, keeper, steps)
