"""An experiment: a scenario that was resolved, once. Nothing below looks a name up or reads options again.

What cannot be right of windows, and of prices over them, is refused before anything is run.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from controllers.entries.entry import Chosen
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.keys import digest
from thermoforce_mpc.experiment.identifying import (
    IdentificationTask,
    SavedModel,
    chosen_of,
    identification_task,
    taken_probing,
)
from thermoforce_mpc.files import DoubtfulInput, plain_number
from thermoforce_mpc.loop.closed_loop import RunResult, StepKeeper, StepRecord, run_closed_loop
from thermoforce_mpc.loop.inputs import UnitDoubts
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.model.free_response.registry import build_free_response, needs_identified
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.plants.registry import ChosenPlant, choose_plant, tariff_of, windows_of
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.records.run_folder import OwnKpi, own_kpis
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.scenario.testcase import TestCase

if TYPE_CHECKING:
    import pandas as pd

# BOPTEST's names and those of plants of our own; the plant knows which of them it has.
_NAMED_PERIODS = (
    "peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day", "cold_week",
    "sunny_week",
)  # fmt: skip
# Distance of the instants at which prices must be known, s.
_PRICE_STEP_S = 900.0


@dataclass(frozen=True)
class Contestant:
    """A controller of an experiment, and where its model comes from: a folder, an identification, or nowhere."""

    chosen: Chosen
    model_from: SavedModel | IdentificationTask | None = None

    @property
    def name(self) -> str:
        """Name of the controller."""
        return self.chosen.name


@dataclass(frozen=True, eq=False)
class Experiment:
    """What is run: controllers on a plant over a window under a tariff.

    Two experiments are equal, and have one hash, where they are resolved from the same content; a test case counts as
    it was read, so that a changed file makes another.

    Attributes:
        testcase: the building.
        plant: what stands for it.
        window, days, price: the scored window by its name, its length, and the tariff.
        contestants: the controllers, the scenario's own first.
        kpis: KPIs of the user's.
        equal_comfort: whether a thermostat that is as comfortable is searched.
        written: the scenario as it is written into run folders, journals and records.
    """

    testcase: TestCase
    plant: ChosenPlant
    window: str
    days: float
    price: str
    contestants: tuple[Contestant, ...]
    kpis: tuple[OwnKpi, ...]
    equal_comfort: bool
    written: Scenario

    @classmethod
    def of(cls, scenario: Scenario, kpis: Sequence[str | Callable[[pd.DataFrame], float]] = ()) -> Experiment:
        """Resolve a scenario, with further `kpis`; raises `ConfigError` for whatever of it cannot be run."""
        testcase = load_testcase(scenario.testcase)
        check_window(scenario.period)
        own = _contestant(scenario, testcase, scenario.controller.name)
        contestants = [own]
        for name in dict.fromkeys(scenario.baselines):
            if name == own.name:
                continue
            contestants.append(beside := _contestant(scenario, testcase, name))
            if beside.chosen.needs_model and not own.chosen.needs_model:
                raise ConfigError(
                    f"baselines: '{name}' needs a model, but the controller of this scenario identifies none"
                )
        plant = choose_plant(scenario.plant, testcase, scenario.seed, scenario.comfort)
        return cls(
            testcase,
            plant,
            scenario.period,
            scenario.days,
            scenario.price,
            tuple(contestants),
            own_kpis((*scenario.kpis, *kpis)),
            # Further runs of an embedded plant take seconds.
            scenario.plant.kind == "embedded" if scenario.equal_comfort is None else scenario.equal_comfort,
            scenario,
        )

    @property
    def own(self) -> Contestant:
        """The scenario's own controller."""
        return self.contestants[0]

    def contestant(self, name: str) -> Contestant | None:
        """The contestant of this name, if there is one."""
        return next((one for one in self.contestants if one.name == name), None)

    @cached_property
    def key(self) -> str:
        """Hash of all that was resolved, files by their path."""
        controllers = {one.name: one.chosen.config.model_dump(mode="json") for one in self.contestants}
        resolved = {
            "scenario": self.written.model_dump(mode="json"),
            "testcase": self.testcase.model_dump(mode="json"),
            "controllers": controllers,
            "kpis": [kpi.key for kpi in self.kpis],
        }
        return digest(resolved)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Experiment) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def _contestant(scenario: Scenario, testcase: TestCase, name: str) -> Contestant:
    chosen = chosen_of(scenario, testcase, name)
    if not chosen.needs_model:
        return Contestant(chosen)
    task, saved = identification_task(scenario, chosen), scenario.identification.model
    return Contestant(chosen, task if saved is None else SavedModel(saved, task.step_s))


def check_contestants(experiment: Experiment) -> None:
    """Build the contestants as far as they can be before probing: what is refused now costs nobody days of it.

    With a saved model that is all of them, without one what they forecast with. The probing that is taken is read too.

    Raises:
        ConfigError, ArtifactError, JournalError, BackboneError: options, saved model, probing of an earlier run, or the
            forecaster's weights cannot be used.
    """
    sources = [one.model_from for one in experiment.contestants]
    saved = next((source for source in sources if isinstance(source, SavedModel)), None)
    model = saved.load() if saved else None
    for one in experiment.contestants:
        if one.model_from is None:
            continue
        if isinstance(one.model_from, IdentificationTask):
            taken_probing(one.model_from)
        if (terms := getattr(one.chosen.config, "terms", None)) is not None:
            from controllers.optimisation.statement.terms import load_terms  # loads CasADi

            load_terms(terms)
        if model is not None:
            one.chosen.build(model)
            continue
        method = getattr(one.chosen.config, "free_response", None)
        if method is not None and not needs_identified(method.name):
            build_free_response(method.name, **method.options)


def scored_period(plant: Plant, name: str, days: float) -> Period:
    """The window called `name` on this plant, `days` long; raises `ConfigError` for a name that is not one."""
    check_window(name)
    return replace(plant.period(name), scored_s=days * DAY_S)


def check_prices(spec: PlantSpec, price: str, period: Period, ahead_s: float = 0.0) -> None:
    """Refuse (`ConfigError`) a file of prices that ends before the window does, or forecasts `ahead_s` beyond it do."""
    if spec.prices_file is None or price != "highly_dynamic":
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulInput)  # said when the plant was built
        tariff = tariff_of(Path(spec.prices_file))
    until_s = period.start_s + period.scored_s + ahead_s
    tariff(np.append(np.arange(period.start_s, until_s, _PRICE_STEP_S), until_s))


def check_window(name: str, key: str = "period") -> None:
    """Refuse a `name` that no plant can know as a window; raises `ConfigError` naming `key` and those there are."""
    try:
        if not 0.0 <= plain_number(name) < 365.0:
            raise ConfigError(f"{key}: '{name}': a start day lies between 0 and 365")
    except ValueError:
        if name not in _NAMED_PERIODS:
            raise ConfigError(
                f"{key}: '{name}' is not a window{suggestion(name, _NAMED_PERIODS)}; "
                f"use {', '.join(_NAMED_PERIODS)}, or the day of the year it starts, such as 44"
            ) from None


def check_windows(names: Iterable[str], spec: PlantSpec, testcase: TestCase) -> None:
    """Refuse windows that the plant does not have, as far as that is known without it; raises `ConfigError`."""
    windows_of_plant = cache(partial(windows_of, spec, testcase))  # may open an FMU
    days: dict[float, str] = {}
    for name in names:
        check_window(name, "windows")
        if name not in _NAMED_PERIODS:  # a start day, which all have
            if (earlier := days.setdefault(float(name), name)) != name:
                raise ConfigError(f"windows: '{earlier}' and '{name}' are the same start day; leave one out")
            continue
        windows = windows_of_plant()
        if windows is not None and name not in windows:
            raise ConfigError(
                f"windows: {testcase.name} has no '{name}'; use {''.join(f'{window}, ' for window in windows)}or the "
                "day of the year it starts, such as 44"
            )


@dataclass(frozen=True)
class Setting:
    """An experiment and the plant that it is made on, over the window `period`."""

    plant: Plant
    experiment: Experiment
    period: Period

    @classmethod
    def of(cls, plant: Plant, experiment: Experiment) -> Setting:
        """An experiment on its plant; raises `ConfigError` for a window that is none, or prices that end before."""
        period = scored_period(plant, experiment.window, experiment.days)
        check_prices(experiment.plant.spec, experiment.price, period)
        return cls(plant, experiment, period)

    def run(
        self,
        controller: Controller,
        on_step: Callable[[StepRecord], None] | None = None,
        keeper: StepKeeper | None = None,
        steps: KeptSteps[StepRecord] | None = None,
    ) -> RunResult:
        """The closed loop of a controller, readings judged by size and layout of the building.

        Arguments and errors as of `run_closed_loop`; raises `ConfigError` too where prices end before the forecasts do.
        """
        experiment, testcase = self.experiment, self.experiment.testcase
        spec, u_min = experiment.plant.spec, testcase.layout.u_min
        check_prices(spec, experiment.price, self.period, max(controller.horizon_s - controller.step_s, 0.0))
        return run_closed_loop(
            self.plant,
            controller,
            self.period,
            experiment.price,
            on_step,
            limits_of(controller, testcase.area_m2, min(u_min)),
            u_min,
            keeper,
            steps,
            outage_h=spec.forecast_outage_h,
            units=UnitDoubts(testcase.layout, getattr(controller, "model", None), testcase.currency),
        )
