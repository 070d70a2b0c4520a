"""The composition root: builds plant, model and controllers from a scenario and runs it.

The only module that knows both sides, `thermoforce_mpc` and `controllers`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from pydantic import BaseModel

from controllers.registry import build_controller, controller_config, find_entry
from thermoforce_mpc.data import DAY_S, Period, Record
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario, load_testcase
from thermoforce_mpc.scenario.settings import merge, suggestion, validate
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, run_closed_loop
from thermoforce_mpc.simulation.run_folder import create_run_folder, write_partial, write_results

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig
    from thermoforce_mpc.model.thermal_model import ThermalModel

# BOPTEST's names; the plant knows which of them it has.
_NAMED_PERIODS = ("peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day")


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


@dataclass(frozen=True)
class Learning:
    """Everything that decides an identification before a window, and nothing else: `learn_model` is given no more.

    `period` is the window that must not be probed, `days` of probing end where its warm-up begins; `step_s` is the
    model's; `seed` that of the probing and, in `plant`, of the forecast errors, which the choice of draws sees.
    """

    testcase: TestCase
    plant: PlantSpec
    period: str
    days: float
    step_s: float
    seed: int
    probing: ProbingConfig
    identification: IdentificationConfig

    def to_json(self) -> dict[str, Any]:
        """Plain values of every field, for a key or a file."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            name: value.model_dump(mode="json") if isinstance(value, BaseModel) else value
            for name, value in values.items()
        }


@dataclass(frozen=True)
class IdentifiedModel:
    """A model and where it came from, for the manifest."""

    model: ThermalModel
    origin: Mapping[str, Any]


def validate_scenario(scenario: Scenario) -> TestCase:
    """Check everything that can be checked before work starts; returns the test case. Raises `ConfigError`."""
    testcase = load_testcase(scenario.testcase)
    controller_config(scenario.controller.name, controller_options(scenario, scenario.controller.name), testcase)
    if find_entry(scenario.controller.name).needs_model:
        identification_settings(scenario, testcase)
    for name in scenario.baselines:
        if find_entry(name).needs_model:
            if not find_entry(scenario.controller.name).needs_model:
                raise ConfigError(
                    f"baselines: '{name}' needs a model, but the controller of this scenario identifies none"
                )
            identification_settings(scenario, testcase, name)
    if scenario.plant.kind == "embedded" and testcase.energyplus is not None:
        if scenario.plant.weather != "synthetic":
            raise ConfigError(f"plant.weather: test case '{testcase.name}' has EnergyPlus' own weather; leave it out")
        from thermoforce_mpc.plants.energyplus.engine import is_available

        if not is_available():
            raise ConfigError(
                f"test case '{testcase.name}' runs on EnergyPlus: pip install 'thermoforce-mpc[energyplus]'"
            )
    elif scenario.plant.kind == "embedded" and not testcase.embedded:
        raise ConfigError(
            f"plant.kind: the embedded emulator is bestest_hydronic_heat_pump, not {testcase.name}; "
            "give the address of a BOPTEST service with --url, or the test case's FMU with --fmu"
        )
    return testcase


def build_plant(spec: PlantSpec, testcase: TestCase, seed: int) -> Plant:
    """Build the plant of a scenario.

    Raises:
        ConfigError: the FMU cannot be used, or the test case does not fit the plant.
        WeatherError: the weather file cannot be used.
        PlantError: the service does not answer.
    """
    if spec.kind == "boptest":
        from thermoforce_mpc.plants.boptest.plant import BoptestPlant

        return BoptestPlant(spec.url, testcase, forecast_uncertainty=spec.forecast_uncertainty, seed=seed)
    from thermoforce_mpc.boundary.forecast_error import ForecastError

    level = spec.forecast_uncertainty
    error = None if level == "none" else ForecastError(level, seed)
    if spec.path is not None:
        from thermoforce_mpc.plants.fmu import FmuPlant

        return FmuPlant(Path(spec.path), testcase, forecast_error=error)
    from thermoforce_mpc.boundary.tariffs import tariff_from_file

    tariff = tariff_from_file(Path(spec.prices_file)) if spec.prices_file else None
    if testcase.energyplus is not None:
        from thermoforce_mpc.plants.energyplus.plant import EnergyPlusPlant

        return EnergyPlusPlant(testcase, highly_dynamic=tariff, forecast_error=error)
    from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    weather = synthetic_weather() if spec.weather == "synthetic" else load_weather(Path(spec.weather))
    return EmbeddedPlant(weather, highly_dynamic=tariff, forecast_error=error)


def controller_options(scenario: Scenario, name: str) -> dict[str, Any]:
    """Options of the controller `name` in this scenario: its own, then the scenario's control step."""
    options = scenario.controller.options if name == scenario.controller.name else {}
    if scenario.step_s is None or not find_entry(name).needs_model:
        return dict(options)
    return merge({"step_s": scenario.step_s}, options)


def scored_period(plant: Plant, name: str, days: float) -> Period:
    """The window called `name` on this plant, `days` long; raises `ConfigError` for a name that is not one."""
    check_window(name)
    return replace(plant.period(name), scored_s=days * DAY_S)


def check_window(name: str) -> None:
    """Refuse a `name` that no plant can know as a window; raises `ConfigError` naming those there are."""
    try:
        float(name)
    except ValueError:
        if name not in _NAMED_PERIODS:
            raise ConfigError(
                f"period: '{name}' is not a window{suggestion(name, _NAMED_PERIODS)}; "
                f"use {', '.join(_NAMED_PERIODS)}, or the day of the year it starts, such as 44"
            ) from None


def identify_on(
    plant: Plant,
    *,
    before: Period,
    days: float,
    testcase: TestCase | None = None,
    step_s: float | None = None,
    seed: int = 1,
    probing: ProbingConfig | None = None,
    config: IdentificationConfig | None = None,
    on_step: Callable[[float], None] | None = None,
    on_record: Callable[[Record], None] | None = None,
) -> ThermalModel:
    """Probe `plant` for `days` that end where the warm-up of `before` begins, and identify a model from them.

    Early in the year the probing days are taken from the end of the year: a scored window is never probed.

    Args:
        testcase: mode, floor area and default step; by default those of `bestest_hydronic_heat_pump`.
        step_s: step of the model; by default the test case's.
        on_step: told the share of the probing done.
        on_record: given the record before anything is identified from it.

    Raises:
        DataError: the record cannot identify; the message has numbers and advice.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.identification.pipeline import identify
    from thermoforce_mpc.identification.probing.probe import probe

    testcase = testcase or load_testcase("bestest_hydronic_heat_pump")
    start_s = before.start_s - before.warmup_s - days * DAY_S
    if start_s < 0:
        start_s = 365 * DAY_S - days * DAY_S
    record = probe(
        plant, start_s, days, seed=seed, mode=testcase.mode, config=probing, identification=config, on_step=on_step
    )
    if on_record:
        on_record(record)
    info = plant.info
    first = start_s / DAY_S
    return identify(
        [record],
        config=config,
        mode=testcase.mode,
        floor_area_m2=testcase.floor_area_m2,
        step_s=step_s or testcase.step_s,
        source=f"{days:g} days of probing (days {first:g} to {first + days:g}) on {info.kind} {info.testcase}, "
        f"{info.weather}",
    )


def identification_settings(
    scenario: Scenario, testcase: TestCase, controller: str | None = None
) -> tuple[ProbingConfig, IdentificationConfig]:
    """How a scenario probes and identifies for `controller`, by default its own; `ConfigError` names each wrong key.

    Unless told otherwise the machine is probed the way that controller will run it, whoever it is compared with.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig

    spec, name = scenario.identification, controller or scenario.controller.name
    actuation = getattr(controller_config(name, controller_options(scenario, name), testcase), "actuation", None)
    defaults: dict[str, Any] = {}
    if actuation is not None and actuation.mode == "modulating":
        # Levels between off and full have to be seen to be planned.
        defaults["levels"] = (0.0, *np.linspace(actuation.lowest_level, 1.0, 5).round(3).tolist())
    elif actuation is not None:
        defaults["levels"] = (0.0, actuation.level)
    own = testcase.defaults
    probing = validate(ProbingConfig, merge(merge(defaults, own.probing), spec.probing), "identification.probing")
    options = merge(merge({"seed": scenario.seed}, own.identification), spec.options)
    config = validate(IdentificationConfig, options, "identification.options")
    return probing, config


def learning_for(scenario: Scenario, testcase: TestCase, controller: str | None = None) -> Learning:
    """What decides the model that `controller`, by default the scenario's own, gets in this scenario.

    Raises:
        ConfigError: a setting of the identification is wrong.
    """
    probing, config = identification_settings(scenario, testcase, controller)
    return Learning(
        testcase=testcase,
        plant=scenario.plant,
        period=scenario.period,
        days=scenario.identification.days,
        step_s=scenario.step_s or testcase.step_s,
        seed=scenario.seed,
        probing=probing,
        identification=config,
    )


def learn_model(learning: Learning, plant: Plant, on_record: Callable[[Record], None] | None = None) -> ThermalModel:
    """Probe `plant`, which is that of `learning`, and identify.

    Args:
        on_record: given the record before anything is identified from it.

    Raises:
        DataError: the record cannot identify.
        PlantError: the plant failed.
    """
    check_window(learning.period)
    return identify_on(
        plant,
        before=plant.period(learning.period),
        days=learning.days,
        testcase=learning.testcase,
        step_s=learning.step_s,
        seed=learning.seed,
        probing=learning.probing,
        config=learning.identification,
        on_record=on_record,
    )


def model_for(scenario: Scenario, testcase: TestCase, plant: Plant, controller: str | None = None) -> ThermalModel:
    """The model of `controller`: the saved one that the scenario names, at its step, or one identified for it.

    Raises:
        ArtifactError: the saved model cannot be used.
        DataError: the record cannot identify.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.model.model_file import load_model

    spec = scenario.identification
    if spec.model is None:
        return learn_model(learning_for(scenario, testcase, controller), plant)
    step_s = scenario.step_s or testcase.step_s
    model = load_model(Path(spec.model))
    if model.operator.step_s != step_s:
        model = replace(model, operator=model.operator.resampled(step_s))
    return model


def _learn_all(scenario: Scenario, testcase: TestCase, plant: Plant, display: Display) -> dict[str, IdentifiedModel]:
    """The model of every contestant that needs one; those that would probe and identify alike share one.

    Each is probed for on its own account: what a controller does must not depend on whom it is compared with.
    """
    found: dict[str, IdentifiedModel] = {}
    known: list[tuple[Learning | None, IdentifiedModel]] = []
    for name in dict.fromkeys((scenario.controller.name, *scenario.baselines)):
        if not find_entry(name).needs_model:
            continue
        learning = None if scenario.identification.model else learning_for(scenario, testcase, name)
        same = [learned for other, learned in known if other == learning]
        if not same:
            if known:
                display.say(f"For {name}, which runs the machine another way:")
            same = [_learn(scenario, testcase, plant, name, display)]
            known.append((learning, same[0]))
        found[name] = same[0]
    return found


def _learn(scenario: Scenario, testcase: TestCase, plant: Plant, controller: str, display: Display) -> IdentifiedModel:
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
            learned = _learn_all(scenario, testcase, plant, display)
            models = {who: found.model for who, found in learned.items()}
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
        identification=_origins(learned, name),
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


def _origins(learned: Mapping[str, IdentifiedModel], controller: str) -> dict[str, Any]:
    """Where the models came from: the controller's, and by name those of baselines that have one of their own."""
    if controller not in learned:
        return {}
    own = learned[controller]
    others = {name: dict(found.origin) for name, found in learned.items() if found is not own}
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
