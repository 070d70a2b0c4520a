"""One scenario from start to end: identify, run the controller and its baselines, write the run folder, report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from controllers.registry import build_controller, find_entry, has_gate
from thermoforce_mpc.data import DAY_S, Period, PlantInfo
from thermoforce_mpc.errors import ConfigError, DataError, PlantError
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.scenario.scenario import Scenario, load_scenario
from thermoforce_mpc.scenario.settings import merge, suggestion
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.checks import validate_scenario
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, gates_held, run_closed_loop
from thermoforce_mpc.simulation.composition import build_plant, controller_options, scored_period
from thermoforce_mpc.simulation.display import RunDisplay
from thermoforce_mpc.simulation.identifying import IdentificationTask, IdentifiedModel, identification_task, model_for
from thermoforce_mpc.simulation.run_folder import create_run_folder, trajectory_frame, write_partial, write_results
from thermoforce_mpc.simulation.watching import watch_spells

if TYPE_CHECKING:  # loaded only when a controller needs a model
    from thermoforce_mpc.model.thermal_model import ThermalModel
    from thermoforce_mpc.model.zone_model import ZoneModel


def _identify_all(
    scenario: Scenario, testcase: TestCase, plant: Plant, display: RunDisplay
) -> dict[str, IdentifiedModel]:
    """The model of every contestant that needs one; those that would probe and identify alike share one.

    Each is probed for on its own account: what a controller does must not depend on whom it is compared with.
    """
    found: dict[str, IdentifiedModel] = {}
    known: list[tuple[IdentificationTask | None, IdentifiedModel]] = []
    for name in dict.fromkeys((scenario.controller.name, *scenario.baselines)):
        if not find_entry(name).needs_model:
            continue
        task = None if scenario.identification.model else identification_task(scenario, testcase, name)
        same = [identified for other, identified in known if other == task]
        if not same:
            if known:
                display.say(f"For {name}, which runs the machine another way:")
            same = [_identify(scenario, testcase, plant, name, display)]
            known.append((task, same[0]))
        found[name] = same[0]
    return found


def _identify(
    scenario: Scenario, testcase: TestCase, plant: Plant, controller: str, display: RunDisplay
) -> IdentifiedModel:
    """Load the model of the scenario, or probe and identify one for `controller`, and say what came of it.

    Data that cannot be fitted do not end the run: without a model, the controller stands back. Raises `DataError` where
    it has its gate turned off.
    """
    spec = scenario.identification
    try:
        if spec.model is not None:
            model = model_for(scenario, testcase, plant, controller)
            display.say(f"Model: {spec.model} ({model.cards[0].source})")
        else:
            with display.probing(spec.days) as progress:
                model = model_for(scenario, testcase, plant, controller, progress)
            display.say(f"Identified from {model.cards[0].source}")
    except DataError as error:
        if not has_gate(controller, controller_options(scenario, controller), testcase):
            raise
        display.say(f"No model could be identified: {error}")
        return IdentifiedModel(None, {"model": None, "refused": str(error)}, str(error))
    for a, name in enumerate(model.operator.actuators):
        zone, of = model.actuator(a), "" if model.names.single else f" of {name}"
        hours = ", ".join(f"{tau:.2g} h" for tau in zone.operator.time_constants_h)
        display.say(
            f"Operator{of}: order {zone.operator.order} ({hours}), {zone.operator.parameters_in_words}, "
            f"steady gain {zone.operator.steady_gains_K.sum():.1f} K"
        )
        verdict = zone.card.competence
        if verdict is not None:
            advice = [f"  {advice}" for advice in verdict.advice]
            display.say("\n".join([f"The model{of} is {verdict.in_words()}", *advice]))
    return IdentifiedModel(model, {"model": spec.model, "source": model.cards[0].source} | _origin(model))


def _origin(model: ThermalModel) -> dict[str, Any]:
    """What the manifest says of a model; with several actuators, of each by its name."""
    found = {name: _origin_of(model.actuator(a)) for a, name in enumerate(model.operator.actuators)}
    if model.names.single:
        return found[model.operator.actuators[0]]
    return {"n_trained": model.operator.n_trained, "pairs": len(list(model.operator.each())), "actuators": found}


def _origin_of(zone: ZoneModel) -> dict[str, Any]:
    """What the manifest says of an actuator on its home zone."""
    operator, card = zone.operator, zone.card
    return {
        "order": operator.order,
        "n_trained": operator.n_trained,
        "n_effective": operator.n_effective,
        "time_constants_h": operator.time_constants_h.tolist(),
        "steady_gains_K": operator.steady_gains_K.tolist(),
        "scores": dict(card.scores),
        "competence": None if card.competence is None else asdict(card.competence),
        "data_sha256": dict(card.data),
        "config": dict(card.config),
        "notes": list(card.notes),
    }


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run: the controller's closed loop and its baselines' on the same plant and window.

    `identification` and `forecaster` are what the manifest says of the models and of the frozen weights.
    """

    scenario: Scenario
    plant: PlantInfo
    result: RunResult
    baselines: Mapping[str, RunResult]
    models: Mapping[str, ThermalModel]
    identification: Mapping[str, Any]
    forecaster: Mapping[str, Any]

    @property
    def kpis(self) -> dict[str, dict[str, float]]:
        """BOPTEST's KPIs by controller, the scenario's own first."""
        return {name: dict(result.kpis) for name, result in self._results().items()}

    def to_dataframe(self, controller: str | None = None) -> pd.DataFrame:
        """The trajectory of a controller, by default the scenario's own; one row per applied block.

        Raises:
            ConfigError: no controller of that name was run.
        """
        results = self._results()
        name = controller or self.result.controller
        if name not in results:
            raise ConfigError(f"no run of '{name}'{suggestion(name, results)}; there are {', '.join(results)}")
        return trajectory_frame(results[name].steps)

    def _results(self) -> dict[str, RunResult]:
        return {self.result.controller: self.result, **self.baselines}


def run(
    testcase: str,
    *,
    controller: str = "thermoforce_mpc",
    model: ThermalModel | None = None,
    progress: bool = True,
    **settings: Any,
) -> ScenarioResult:
    """Control a building over a scored window; nothing is written (`tf-mpc run` also writes a folder and a report).

    Args:
        testcase: a test case that ships, by name, or the path of a YAML file.
        controller: name in the registry, see `tf-mpc controllers`.
        model: an identified model; by default the plant is probed and a model identified first.
        progress: say on the terminal how far the run is.
        settings: any other key of a scenario file: `days`, `period`, `price`, `plant`, `baselines`, `seed`, ….

    Raises:
        InputError: something given cannot be used; the message names the key.
        PlantError: the plant or its service failed.
    """
    named = {"testcase": testcase, "controller": {"name": controller}}
    return _execute(load_scenario(None, merge(named, settings)), RunDisplay(quiet=not progress), {}, model)


def run_scenario(scenario: Scenario, display: RunDisplay, out: Path | None, command: Sequence[str]) -> Path:
    """Run a scenario and its baselines, print the KPI table, and write the run folder.

    Returns:
        The run folder.

    Raises:
        InputError: something given cannot be used; nothing is left behind.
        PlantError: the plant or service failed; what had been recorded is in the run folder the message names.
    """
    testcase = validate_scenario(scenario)
    folder = create_run_folder(out, f"{testcase.name}-{scenario.period}-{scenario.price}-{scenario.controller.name}")
    records: dict[str, list[StepRecord]] = {}
    try:
        done = _execute(scenario, display, records)
    except PlantError as error:
        write_partial(folder, records, str(error))
        raise PlantError(f"{error}\nWhat was recorded until then is in {folder}") from error
    except BaseException:
        if records:
            write_partial(folder, records, "interrupted")
        else:
            folder.rmdir()  # nothing was done yet, and an empty folder says nothing
        raise
    kpis = write_results(
        folder,
        scenario=scenario,
        plant=done.plant,
        result=done.result,
        baselines=done.baselines,
        identification=done.identification,
        command=command,
        forecaster=done.forecaster,
    )
    with display.working("Drawing the report"):
        from thermoforce_mpc.simulation.report import write_report

        write_report(
            folder,
            currency=testcase.currency,
            kpis=kpis,
            result=done.result,
            baselines=done.baselines,
            layout=testcase.layout,
        )
    title = f"{done.plant.kind} plant, {done.plant.weather}\n{_window(done.result.period)}, {scenario.price} tariff"
    held = {name: gate.in_words() for name, gate in gates_held(done.result, done.baselines).items()}
    display.kpi_table(done.kpis, title, testcase.currency, held)
    levels = done.result.fallback_levels()
    fallbacks = {level: n for level, n in levels.items() if n and level not in ("solved", "rule", "gate")}
    if fallbacks:
        display.say(f"Fallbacks: {fallbacks}; reasons in {folder / 'steps.csv'}")
    for spell in watch_spells(done.result):
        display.say(f"Watch: {spell.in_words()}")
    return folder


def _execute(
    scenario: Scenario,
    display: RunDisplay,
    records: dict[str, list[StepRecord]],
    model: ThermalModel | None = None,
) -> ScenarioResult:
    """Build, identify unless there is a `model`, run everyone; `records` keeps the steps if the plant fails."""
    testcase = validate_scenario(scenario)
    name = scenario.controller.name
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        period = scored_period(plant, scenario.period, scenario.days)
        display.say(_headline(plant, period, scenario))
        if model is None:
            identified = _identify_all(scenario, testcase, plant, display)
            models: dict[str, ThermalModel | str] = {who: found.acts_on for who, found in identified.items()}
        else:
            identified = {}
            models = {who: model for who in (name, *scenario.baselines) if find_entry(who).needs_model}

        def follow(controller: Controller) -> RunResult:
            return _follow(plant, controller, period, scenario, testcase, display, records)

        def built(who: str) -> Controller:
            return build_controller(who, controller_options(scenario, who), testcase, models.get(who))

        controller = built(name)
        actuation = getattr(controller, "actuation_in_words", None)
        if actuation:
            display.say(f"Actuation: {actuation}")
        before = _weight_hash(controller)
        result = follow(controller)
        forecaster = _frozen(controller, before)
        baselines = {other: follow(built(other)) for other in scenario.baselines if other != name}
        usable = {who: model for who, model in models.items() if not isinstance(model, str)}
        origins = _origins(identified, name)
        if actuation and origins:
            origins["actuation"] = actuation
        return ScenarioResult(scenario, plant.info, result, baselines, usable, origins, forecaster)


def _origins(identified: Mapping[str, IdentifiedModel], controller: str) -> dict[str, Any]:
    """Where the models came from: the controller's, and by name those of baselines that have one of their own."""
    if controller not in identified:
        return {}
    own = identified[controller]
    others = {name: dict(found.origin) for name, found in identified.items() if found is not own}
    return dict(own.origin) | ({"baselines": others} if others else {})


def _headline(plant: Plant, period: Period, scenario: Scenario) -> str:
    info = plant.info
    return (
        f"Plant: {info.kind} {info.testcase} ({info.description})\n"
        f"Weather: {info.weather}\n"
        f"Window: {_window(period)}, {scenario.price} tariff; controller {scenario.controller.name}"
    )


def _window(period: Period) -> str:
    first = period.start_s / DAY_S
    return f"{period.name}, days {first:g} to {first + period.scored_s / DAY_S:g}"


def _follow(
    plant: Plant,
    controller: Controller,
    period: Period,
    scenario: Scenario,
    testcase: TestCase,
    display: RunDisplay,
    records: dict[str, list[StepRecord]],
) -> RunResult:
    """One closed loop, shown and recorded step by step so that a failure half way loses nothing."""
    kept = records.setdefault(controller.name, [])
    with display.loop(controller.name, period, plant.kpis, testcase.currency) as follower:

        def on_step(record: StepRecord) -> None:
            kept.append(record)
            follower.step(record)

        allowed = limits_of(controller, testcase.area_m2, min(testcase.layout.lowest))
        return run_closed_loop(plant, controller, period, scenario.price, on_step, allowed, testcase.layout.lowest)


def _weight_hash(controller: Controller) -> str | None:
    """Hash of the forecasters' weights, where the controller has any with weights; each different one once."""
    methods = getattr(getattr(controller, "predictor", None), "free_responses", ())
    different = {id(method): method for method in methods}.values()
    hashes = [method.weight_hash() for method in different if hasattr(method, "weight_hash")]
    return " ".join(dict.fromkeys(hashes)) or None


def _frozen(controller: Controller, before: str | None) -> dict[str, Any]:
    """Proof for the manifest that the run left the forecaster as it was."""
    if before is None:
        return {}
    after = _weight_hash(controller)
    return {"weights_before": before, "weights_after": after, "frozen": before == after}
