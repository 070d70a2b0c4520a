"""One scenario from start to end: identify, run the controller and its baselines, write the run folder, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from controllers.registry import build_controller, find_entry
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.checks import validate_scenario
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, run_closed_loop
from thermoforce_mpc.simulation.composition import build_plant, controller_options, scored_period
from thermoforce_mpc.simulation.identifying import IdentificationTask, IdentifiedModel, identification_task, model_for
from thermoforce_mpc.simulation.run_folder import create_run_folder, write_partial, write_results

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    pass


class StepFollower(Protocol):
    """Shown the steps of one closed loop."""

    def step(self, record: StepRecord) -> None:
        """Take one control step in."""
        ...


class Display(Protocol):
    """What `run_scenario` tells its reader while it works."""

    def say(self, text: str) -> None:
        """One line."""
        ...

    def working(self, text: str) -> AbstractContextManager[object]:
        """Shown while something takes a while."""
        ...

    def loop(
        self, controller: str, period: Period, kpis: Callable[[], Mapping[str, float]], currency: str
    ) -> AbstractContextManager[StepFollower]:
        """Follows one closed loop; `kpis` are the plant's so far, asked for once a day."""
        ...

    def kpi_table(self, everyone: Mapping[str, Mapping[str, float]], title: str, currency: str) -> None:
        """KPIs side by side."""
        ...


def _identify_all(scenario: Scenario, testcase: TestCase, plant: Plant, display: Display) -> dict[str, IdentifiedModel]:
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
    scenario: Scenario, testcase: TestCase, plant: Plant, controller: str, display: Display
) -> IdentifiedModel:
    """Load the model of the scenario, or probe and identify one for `controller`, and say what came of it."""
    spec = scenario.identification
    if spec.model is not None:
        model = model_for(scenario, testcase, plant, controller)
        display.say(f"Model: {spec.model} ({model.card.source})")
    else:
        with display.working(f"Probing for {spec.days:g} days and identifying"):
            model = model_for(scenario, testcase, plant, controller)
        display.say(f"Identified from {model.card.source}")
    operator = model.operator
    hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
    display.say(
        f"Operator: order {operator.order} ({hours}), {operator.n_trained} trained parameters, "
        f"steady gain {operator.steady_gains_K.sum():.1f} K"
    )
    card = model.card
    return IdentifiedModel(
        model,
        {
            "model": spec.model,
            "source": card.source,
            "order": operator.order,
            "time_constants_h": operator.time_constants_h.tolist(),
            "steady_gains_K": operator.steady_gains_K.tolist(),
            "scores": dict(card.scores),
            "data_sha256": dict(card.data),
            "config": dict(card.config),
            "notes": list(card.notes),
        },
    )


def run_scenario(scenario: Scenario, display: Display, out: Path | None, command: Sequence[str]) -> Path:
    """Run a scenario and its baselines, print the KPI table, and write the run folder.

    Returns:
        The run folder.

    Raises:
        InputError: something given cannot be used; nothing is left behind.
        PlantError: the plant or service failed; what had been recorded is in the run folder the message names.
    """
    testcase = validate_scenario(scenario)
    name = scenario.controller.name
    stem = f"{testcase.name}-{scenario.period}-{scenario.price}-{name}"
    folder = create_run_folder(out, stem)
    records: dict[str, list[StepRecord]] = {}
    try:
        with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
            period = scored_period(plant, scenario.period, scenario.days)
            display.say(_headline(plant, period, scenario))
            identified = _identify_all(scenario, testcase, plant, display)
            models = {who: found.model for who, found in identified.items()}
            controller = build_controller(name, controller_options(scenario, name), testcase, models.get(name))
            before = _weight_hash(controller)
            result = _follow(plant, controller, period, scenario, testcase, display, records)
            forecaster = _frozen(controller, before)
            baselines = {
                other: _follow(
                    plant,
                    build_controller(other, controller_options(scenario, other), testcase, models.get(other)),
                    period,
                    scenario,
                    testcase,
                    display,
                    records,
                )
                for other in scenario.baselines
                if other != name
            }
            info = plant.info
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
        plant=info,
        result=result,
        baselines=baselines,
        identification=_origins(identified, name),
        command=command,
        forecaster=forecaster,
    )
    with display.working("Drawing the report"):
        from thermoforce_mpc.simulation.report import write_report

        write_report(folder, currency=testcase.currency, kpis=kpis, result=result, baselines=baselines)
    everyone = {name: result.kpis, **{other: b.kpis for other, b in baselines.items()}}
    title = f"{info.kind} plant, {info.weather}\n{_window(period)}, {scenario.price} tariff"
    display.kpi_table(everyone, title, testcase.currency)
    fallbacks = {level: n for level, n in result.fallback_levels().items() if n and level not in ("solved", "rule")}
    if fallbacks:
        display.say(f"Fallbacks: {fallbacks}; reasons in {folder / 'steps.csv'}")
    return folder


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
    display: Display,
    records: dict[str, list[StepRecord]],
) -> RunResult:
    """One closed loop, shown and recorded step by step so that a failure half way loses nothing."""
    kept = records.setdefault(controller.name, [])
    with display.loop(controller.name, period, plant.kpis, testcase.currency) as follower:

        def on_step(record: StepRecord) -> None:
            kept.append(record)
            follower.step(record)

        return run_closed_loop(plant, controller, period, scenario.price, on_step)


def _weight_hash(controller: Controller) -> str | None:
    """Hash of the forecaster's weights, where the controller has a forecaster with weights."""
    free = getattr(getattr(controller, "predictor", None), "free_response", None)
    weight_hash = getattr(free, "weight_hash", None)
    return weight_hash() if weight_hash else None


def _frozen(controller: Controller, before: str | None) -> dict[str, Any]:
    """Proof for the manifest that the run left the forecaster as it was."""
    if before is None:
        return {}
    after = _weight_hash(controller)
    return {"weights_before": before, "weights_after": after, "frozen": before == after}
