"""Identification before a scored window: settings, probing of the plant, and the identified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Period, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import merge, validate
from thermoforce_mpc.scenario.testcase import Actuator, TestCase
from thermoforce_mpc.simulation.composition import check_window, controller_options

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import Probing, ProbingConfig
    from thermoforce_mpc.model.thermal_model import ThermalModel

# Trials of part load, as shares of the highest level, and steps at each where only the temperature tells their heat.
_TRIAL_SHARES, _UNMETERED_STEPS = (0.5, 0.25), 8
# Probing does not end early before this many days: a held-out part of 9 h must show the effect.
_LEAST_DAYS = 1.5


@dataclass(frozen=True)
class ProbingProgress:
    """Where a probing stands.

    `days` probed of `planned_days`; `information_nats` of the record, and `expected_sd`: relative standard deviation of
    the effect of a day at full level that the design expects from it, see `Designer.known`; `verdict`: what was found
    when the data were last judged and after how many days that was, in words.
    """

    days: float
    planned_days: float
    information_nats: float
    expected_sd: float
    verdict: str = ""


@dataclass(frozen=True)
class IdentificationTask:
    """All inputs of an identification before a window; `run_identification` uses nothing else.

    `period`: scored window, which is not probed; `days`: days of probing, planned to end where its warm-up begins;
    `most_days`: days after which probing ends in any case, see `identify_on`; `end_early`: whether it may end before
    `days`; `step_s`: step of the model, s; `seed`: seed of the probing and of the forecast errors in `plant`, which the
    probing design uses.
    """

    testcase: TestCase
    plant: PlantSpec
    period: str
    days: float
    most_days: float
    end_early: bool
    step_s: float
    seed: int
    probing: ProbingConfig
    identification: IdentificationConfig

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values, for a hash key or a file."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            name: value.model_dump(mode="json") if isinstance(value, BaseModel) else value
            for name, value in values.items()
        }


@dataclass(frozen=True)
class IdentifiedModel:
    """A model and its origin, for the manifest; `refused` says why there is none where the data could not be fitted."""

    model: ThermalModel | None
    origin: Mapping[str, Any]
    refused: str = ""

    @property
    def acts_on(self) -> ThermalModel | str:
        """What a controller is built with: the model, or the reason why there is none."""
        return self.refused if self.model is None else self.model


def identify_on(
    plant: Plant,
    *,
    before: Period,
    days: float,
    most_days: float | None = None,
    end_early: bool = False,
    testcase: TestCase | None = None,
    step_s: float | None = None,
    seed: int = 1,
    probing: ProbingConfig | None = None,
    config: IdentificationConfig | None = None,
    on_step: Callable[[float], None] | None = None,
    on_record: Callable[[Record], None] | None = None,
    on_progress: Callable[[ProbingProgress], None] | None = None,
) -> ThermalModel:
    """Probe `plant` for `days` that end where the warm-up of `before` begins, and identify a model from them.

    If they would begin before the start of the year, the last days of the year are probed instead.

    Args:
        most_days: where the model is below the bar after `days`, or its effect known to worse than 30 %, probing goes
            on on the same run, day by day, until neither is so, this many days are over, or `before` (or a new year)
            begins; by default it does not.
        end_early: end before `days`, not before 1.5 days, once a model is competent and its effect known well.
        testcase: mode, floor area and default step; by default those of `bestest_hydronic_heat_pump`.
        step_s: step of the model; by default the test case's.
        on_step: called with the share of the asked days done.
        on_record: called with the record that the model was identified from.
        on_progress: called every hour of the probing.

    Raises:
        DataError: the record is not sufficient for identification; the message has numbers and advice.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.pipeline import identify
    from thermoforce_mpc.identification.probing.probe import Probing
    from thermoforce_mpc.identification.validation.competence import is_settled, is_well_known

    testcase, config = testcase or load_testcase("bestest_hydronic_heat_pump"), config or IdentificationConfig()
    start_s, end_s = before.start_s - before.warmup_s - days * DAY_S, before.start_s
    if start_s < 0:
        start_s, end_s = YEAR_S - days * DAY_S, YEAR_S
    run = Probing(
        plant,
        start_s,
        seed=seed,
        layout=testcase.layout,
        config=probing,
        identification=config,
    )
    progress = _Progress(run, days, on_step, on_progress)

    def identify_so_far(config: IdentificationConfig) -> tuple[ThermalModel | None, str]:
        """The model of the record so far, or None and why there is none."""
        first = start_s / DAY_S
        try:
            model = identify(
                [run.record],
                config=config,
                layout=testcase.layout,
                step_s=step_s or testcase.step_s,
                source=f"{run.days:g} days of probing (days {first:g} to {first + run.days:g}) on "
                f"{plant.info.kind} {plant.info.testcase}, {plant.info.weather}",
            )
        except DataError as error:
            progress.verdict = f"not to be fitted (after {run.days:.2g} days)"
            return None, str(error)
        progress.verdict = f"{_in_short(model)} (after {run.days:.2g} days)"
        return model, ""

    def enough(record: Record) -> bool:
        if run.days < _LEAST_DAYS:
            return False
        model, _ = identify_so_far(config.model_copy(update={"modulation": "linear"}))
        return model is not None and all(is_well_known(card.competence) for card in model.cards)

    run.go_on(days, enough=enough if end_early else None, on_step=progress)
    model, refused = identify_so_far(config)
    latest = min(most_days or days, (end_s - start_s) / DAY_S)

    def settled(model: ThermalModel | None) -> bool:
        return model is not None and all(is_settled(card.competence) for card in model.cards)

    while not settled(model) and run.days + 1.0 <= latest + 1e-9:
        progress.planned_days = run.days + 1.0
        run.go_on(1.0, on_step=progress)
        model, refused = identify_so_far(config)
    if on_record:
        on_record(run.record)
    if model is None:
        raise DataError(f"{refused} (after {run.days:g} days of probing)" if run.days > days else refused)
    if abs(run.days - days) < 1e-6:
        return model
    note = (
        f"probing went on from {days:g} to {run.days:g} days, since the model was below the bar or poor"
        if run.days > days
        else f"probing ended after {run.days:g} of {days:g} days, since the effect was known well"
    )
    return replace(model, cards=tuple(replace(card, notes=(*card.notes, note)) for card in model.cards))


def may_act(model: ThermalModel) -> bool:
    """Whether a controller may act on a model: no actuator's card is below the bar, or without a verdict."""
    return not any(card.unfit for card in model.cards)


def _in_short(model: ThermalModel) -> str:
    """The verdict in a few words: the first reason of one actuator is enough while probing goes on."""
    cards = zip(model.operator.actuators, model.cards, strict=True)
    verdicts = {name: card.competence for name, card in cards if card.competence is not None}
    if not verdicts:
        return ""
    below = {name: verdict for name, verdict in verdicts.items() if not verdict.competent}
    name, verdict = next(iter((below or verdicts).items()))
    words = verdict.in_words().split("; ")[0]
    if model.names.single:
        return words
    return f"{len(verdicts) - len(below)} of {len(verdicts)} actuators competent, {name}: {words}"


class _Progress:
    """Tells the callbacks of `identify_on` how far the probing is: share of the days every step, the rest hourly."""

    def __init__(
        self,
        run: Probing,
        days: float,
        on_step: Callable[[float], None] | None,
        on_progress: Callable[[ProbingProgress], None] | None,
    ) -> None:
        self.planned_days, self.verdict = days, ""
        self._run, self._days, self._on_step, self._on_progress = run, days, on_step, on_progress

    def __call__(self, share: float) -> None:
        run = self._run
        if self._on_step:
            self._on_step(min(run.days / self._days, 1.0))
        hourly = max(1, round(HOUR_S / run.config.step_s))
        if self._on_progress and run.record.n_steps % hourly == 0:
            expected = run.designer.known(run.record)
            self._on_progress(ProbingProgress(run.days, self.planned_days, *expected, self.verdict))


def identification_settings(
    scenario: Scenario, testcase: TestCase, controller: str | None = None
) -> tuple[ProbingConfig, IdentificationConfig]:
    """Probing and identification settings for `controller`, by default the scenario's; `ConfigError` names wrong keys.

    By default the machine is probed at the levels that this controller uses: those between lowest and full if it
    modulates, off and full if it switches. Where that is to be decided (actuation mode auto), a few steps at half level
    are added; where heat is not metered, more of them, and at a quarter too.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig

    spec, name = scenario.identification, controller or scenario.controller.name
    actuation = getattr(controller_config(name, controller_options(scenario, name), testcase), "actuation", None)
    defaults: dict[str, Any] = {}
    if actuation is not None and actuation.mode in ("modulating", "supply"):
        # Probe the intermediate levels that a plan can use.
        defaults["levels"] = (0.0, *np.linspace(actuation.lowest_level, 1.0, 5).round(3).tolist())
    elif actuation is not None:
        defaults["levels"] = (0.0, actuation.level)
        if actuation.mode == "auto" and "levels" not in {**testcase.defaults.probing, **spec.probing}:
            metered = all(actuator.heat.units for actuator in testcase.points.actuators)
            defaults["trial_levels"] = tuple(share * actuation.level for share in _TRIAL_SHARES)
            if not metered:
                defaults["trial_steps"] = _UNMETERED_STEPS
    shipped = testcase.defaults
    probing = validate(ProbingConfig, merge(merge(defaults, shipped.probing), spec.probing), "identification.probing")
    derived: dict[str, Any] = {"seed": scenario.seed}
    between = [level for level in (*probing.levels, *probing.trial_levels) if 0.0 < level < max(probing.levels)]
    if actuation is not None and actuation.mode == "auto" and between:
        derived["lowest_level"] = min(between)  # these levels are held, not made by cycling
    elif actuation is not None and actuation.mode == "duty" and max(probing.levels) <= actuation.level < 1.0:
        derived["lowest_level"] = actuation.level  # blocks at part load, the only level that there is
    if probing.trial_levels and not all(actuator.heat.units for actuator in testcase.points.actuators):
        derived["part_load"] = True
    if any(machine.supply is not None for machine in testcase.machines.values()):
        derived["power_curve"] = True
    if isinstance(testcase.actuator, Actuator) and testcase.actuator.map == "radiator":
        derived["radiator_exponent"] = testcase.actuator.exponent
    options = merge(merge(derived, shipped.identification), spec.options)
    config = validate(IdentificationConfig, options, "identification.options")
    return probing, config


def identification_task(scenario: Scenario, testcase: TestCase, controller: str | None = None) -> IdentificationTask:
    """Identification task of `controller`, by default the scenario's own.

    Raises:
        ConfigError: a setting of the identification is wrong.
    """
    probing, config = identification_settings(scenario, testcase, controller)
    return IdentificationTask(
        testcase=testcase,
        plant=scenario.plant,
        period=scenario.period,
        days=scenario.identification.days,
        most_days=max(scenario.identification.days, scenario.identification.most_days),
        end_early=scenario.identification.end_early,
        step_s=scenario.step_s or testcase.step_s,
        seed=scenario.seed,
        probing=probing,
        identification=config,
    )


def run_identification(
    task: IdentificationTask,
    plant: Plant,
    on_record: Callable[[Record], None] | None = None,
    on_progress: Callable[[ProbingProgress], None] | None = None,
) -> ThermalModel:
    """Probe `plant`, which must be that of `task`, and identify a model.

    Args:
        on_record: called with the record that the model was identified from.
        on_progress: called every hour of the probing.

    Raises:
        DataError: the record is not sufficient for identification.
        PlantError: the plant failed.
    """
    check_window(task.period)
    return identify_on(
        plant,
        before=plant.period(task.period),
        days=task.days,
        most_days=task.most_days,
        end_early=task.end_early,
        testcase=task.testcase,
        step_s=task.step_s,
        seed=task.seed,
        probing=task.probing,
        config=task.identification,
        on_record=on_record,
        on_progress=on_progress,
    )


def model_for(
    scenario: Scenario,
    testcase: TestCase,
    plant: Plant,
    controller: str | None = None,
    on_progress: Callable[[ProbingProgress], None] | None = None,
) -> ThermalModel:
    """Model of `controller`: the saved one named in the scenario, resampled to its step, or a newly identified one.

    Raises:
        ArtifactError: the saved model cannot be used.
        DataError: the record is not sufficient for identification.
        PlantError: the plant failed.
    """
    if scenario.identification.model is not None:
        return saved_model(scenario, testcase)
    return run_identification(identification_task(scenario, testcase, controller), plant, on_progress=on_progress)


def saved_model(scenario: Scenario, testcase: TestCase) -> ThermalModel:
    """The model that the scenario names, resampled to its step; raises `ArtifactError`."""
    from thermoforce_mpc.model.thermal_model import load_model

    step_s = scenario.step_s or testcase.step_s
    model = load_model(Path(str(scenario.identification.model)))
    if model.operator.step_s != step_s:
        model = replace(model, operator=model.operator.resampled(step_s))
    return model
