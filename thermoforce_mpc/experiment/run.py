"""One scenario from start to end: identify, run the controller and its baselines, write the run folder, report.

`ScenarioResult` is a scenario that was run, as its results are written and said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import yaml

from controllers.registry import lent
from thermoforce_mpc.data import DAY_S, Period, PlantInfo
from thermoforce_mpc.data.clock import seconds_of
from thermoforce_mpc.errors import ConfigError, check_kind, counted
from thermoforce_mpc.experiment.equal_comfort import (
    THERMOSTAT,
    AsComfortable,
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
from thermoforce_mpc.files import file_sha256, write_json, write_plain
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.plants.boptest.plant import allow_token
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.records.recorded_plant import JournaledPlant
from thermoforce_mpc.records.run_folder import (
    LOCK,
    clear_partial,
    create_run_folder,
    environment,
    file_stem,
    is_complete,
    is_empty,
    log_step,
    logging_to,
    sole_use,
    steps_frame,
    times_frame,
    trajectory_frame,
    with_own_kpis,
)
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.findings import (
    COST,
    DISCOMFORT,
    Capped,
    Planning,
    figures_of,
    gates_held,
    planning_of,
    verdict,
    watch_spells,
    without_times,
)
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import merge, suggestion

if TYPE_CHECKING:
    import pandas as pd

    from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run: the controller's closed loop and its baselines' on the same plant and window.

    `identification` and `forecaster` are what the manifest says of the models and of the frozen weights. `equal`: the
    thermostat that is as comfortable; None where it was not searched.
    """

    experiment: Experiment
    plant: PlantInfo
    result: RunResult
    baselines: Mapping[str, RunResult]
    models: Mapping[str, ThermalModel]
    identification: Mapping[str, Any]
    forecaster: Mapping[str, Any]
    equal: AsComfortable | None = None

    @property
    def scenario(self) -> Scenario:
        """The scenario that was run."""
        return self.experiment.written

    @property
    def kpis(self) -> dict[str, dict[str, float]]:
        """BOPTEST's KPIs by controller, the scenario's own first."""
        return {name: dict(result.kpis) for name, result in self._results().items()}

    @property
    def planning(self) -> dict[str, Planning]:
        """How each controller planned: solves by solver, calls of the exported operator, parameters."""
        return {name: planning_of(result, self.models.get(name)) for name, result in self._results().items()}

    def to_dataframe(self, controller: str | None = None) -> pd.DataFrame:
        """The trajectory of a controller, by default the scenario's own, a row a block; raises `ConfigError`."""
        results = self._results()
        name = controller or self.result.controller
        if name not in results:
            raise ConfigError(f"no run of '{name}'{suggestion(name, results)}; there are {', '.join(results)}")
        return trajectory_frame(results[name].steps)

    def equal_in_words(self, currency: str) -> str:
        """The controller beside a thermostat that is as comfortable; '' where none was searched."""
        if self.equal is None:
            return ""
        return f"{self.result.controller} costs {self.equal.in_words(self.result.kpis[COST], currency)}"

    def _results(self) -> dict[str, RunResult]:
        return {self.result.controller: self.result, **self.baselines}


def write_results(folder: Path, outcome: ScenarioResult, command: Sequence[str], currency: str) -> dict[str, Any]:
    """Write configuration, trajectories, step log, KPIs, manifest with hashes; returns what `kpis.json` holds.

    Equal runs write equal files, but for `times.csv` and the manifest.
    """
    scenario, plant, result, baselines = outcome.experiment.written, outcome.plant, outcome.result, outcome.baselines
    resolved = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False)
    write_plain(folder / "scenario.yaml", resolved)
    write_plain(folder / "trajectory.csv", trajectory_frame(result.steps).to_csv(index=False))
    write_plain(folder / "steps.csv", steps_frame(result.steps).to_csv(index=False))
    for name, baseline in baselines.items():
        write_plain(folder / f"trajectory_{file_stem(name)}.csv", trajectory_frame(baseline.steps).to_csv(index=False))
    kpis = figures_of(scenario, asdict(plant), result, baselines, outcome.equal_in_words(currency))
    write_json(folder / "kpis.json", kpis)
    runs = {run.controller: run.steps for run in (result, *baselines.values())}
    write_plain(folder / "times.csv", times_frame(runs).to_csv(index=False))
    table = pd.DataFrame.from_dict({name: without_times(of) for name, of in outcome.kpis.items()}, orient="index")
    write_plain(folder / "kpis.csv", table.to_csv(index_label="controller"))
    manifest = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": list(command),
        "seed": scenario.seed,
        "environment": environment(),
        "plant": asdict(plant),
        "identification": dict(outcome.identification),
        "planning": {name: counts.to_json() for name, counts in outcome.planning.items()},
        "forecaster": dict(outcome.forecaster),
        "fallbacks": {"controller": result.fallback_levels()}
        | {name: baseline.fallback_levels() for name, baseline in baselines.items()},
        "seconds": {run.controller: run.seconds for run in (result, *baselines.values())},
        "time_rat": {run.controller: run.kpis["time_rat"] for run in (result, *baselines.values())},
        "sha256": {
            path.name: file_sha256(path) for path in sorted(folder.iterdir()) if path.is_file() and path.name != LOCK
        },
    }
    write_json(folder / "manifest.json", manifest)
    return kpis


def headline(plant: Plant, period: Period, experiment: Experiment) -> str:
    """What is run, in three lines."""
    info = plant.info
    return (
        f"Plant: {info.kind} {info.testcase} ({info.description})\n"
        f"Weather: {info.weather}\n"
        f"Window: {_window(period)}, {experiment.price} tariff; controller {experiment.own.name}"
    )


def _window(period: Period) -> str:
    first = period.start_s / DAY_S
    return f"{period.name}, days {first:g} to {first + period.scored_s / DAY_S:g}"


def print_summary(
    outcome: ScenarioResult, folder: Path, currency: str, power_cap: Mapping[str, Any], display: RunDisplay
) -> None:
    """Print the KPI table and what was out of the ordinary."""
    plant, period = outcome.plant, outcome.result.period
    said = verdict(outcome.result.controller, outcome.kpis, currency, period.scored_s / DAY_S)
    display.console.print(f"\n{said}\n", soft_wrap=True, markup=False)
    title = f"{plant.kind} plant, {plant.weather}\n{_window(period)}, {outcome.experiment.price} tariff"
    gates = {name: gate.in_words() for name, gate in gates_held(outcome.result, outcome.baselines).items()}
    display.kpi_table(outcome.kpis, title, currency, gates)
    if equal := outcome.equal_in_words(currency):
        display.say(equal)
    for name, figures in power_cap.items():
        display.say(f"{name}: {Capped(**figures).in_words()}")
    if outcome.experiment.own.chosen.needs_model:
        display.say(f"{outcome.result.controller}: {outcome.planning[outcome.result.controller].in_words()}")
    levels = outcome.result.fallback_levels()
    others = ("solved", "acceptable", "rule", "gate", "refused")
    fallbacks = ", ".join(f"{n} {level}" for level, n in levels.items() if n and level not in others)
    if unproved := levels["acceptable"]:
        display.say(f"Not shown to be the cheapest: {counted(unproved, 'plan')}, checked as all are")
    if fallbacks:
        display.say(f"Fallbacks: {fallbacks}; reasons in {folder / 'steps.csv'}")
    if refused := [step.refused for step in outcome.result.steps if step.refused]:
        of = f"{len(refused)} of {counted(len(outcome.result.steps), 'plan')}"
        display.say(f"{of} did not act: {refused[0]}; all in {folder / 'steps.csv'}")
    for spell in watch_spells(outcome.result):
        display.say(f"Watch: {spell.in_words()}")


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
    if model is not None:
        from thermoforce_mpc.model.thermal_model import ThermalModel

        check_kind(model, ThermalModel, "model", "identify or load_model gives one")
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
    note_given(scenario, experiment.plant.name)
    folder = create_run_folder(
        out, f"{experiment.testcase.name}-{experiment.window}-{experiment.price}-{file_stem(experiment.own.name)}"
    )
    with sole_use(folder):
        if not is_empty(folder):  # another run was quicker
            raise ConfigError(f"{folder}: exists already and is never overwritten; choose another folder")
        display.say(f"Folder: {folder}")  # what a run that is killed is resumed by, or watched
        return _carry_out(RunBook.begin(folder, experiment, command), display)


def resume_run(
    folder: Path,
    display: RunDisplay,
    since: str | None,
    given: Mapping[str, str] | None,
    code: Sequence[str],
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


def stop_test(folder: Path, given: Mapping[str, str] | None, code: Sequence[str]) -> None:
    """Stop the test that a run has at a service, which then cannot go on; arguments and errors as of `resume_run`."""
    with sole_use(folder):
        book = _reopened(folder, given, code)
        with closing(book.journal):
            if not (book.told and book.experiment.plant.outlives_us):
                raise ConfigError(f"{folder}: its plant is simulated, or was never reached: there is no test to stop")
            book.connect().close()


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

    with book.released(book.connect()) if book else closing(experiment.plant.build()) as plant:
        setting = Setting.of(plant, experiment)
        display.say(headline(plant, setting.period, experiment))
        identified: Mapping[str, IdentifiedModel] = {}
        models: dict[str, ThermalModel | str] = {}
        if model is not None:
            models |= {one.name: model for one in experiment.contestants if one.chosen.needs_model}
        elif book and isinstance(plant, JournaledPlant):
            # Probing has journals of its own: the journal of the run has the models, which are what comes of it.
            identified = kept_models(experiment.contestants, plant, display, book.folder)
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
        keeper.noted("loop", {"controller": controller.name})
    kpis = keeper.kpis_so_far if keeper else plant.kpis
    with display.loop(controller.name, setting.period, kpis, setting.experiment.testcase.currency) as progress:

        def on_step(record: StepRecord) -> None:
            progress.step(record)
            if not (keeper and keeper.catching_up):
                log_step(controller.name, record)

        return setting.run(controller, on_step, keeper, steps)
