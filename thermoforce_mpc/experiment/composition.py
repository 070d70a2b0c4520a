"""The composition root: joins the plant of a scenario, its controllers, and the loop that runs them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.registry import build_controller, find_entry
from thermoforce_mpc.boundary.tariffs import tariff_from_file
from thermoforce_mpc.data import DAY_S, Layout, Period
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.loop.closed_loop import RunResult, StepKeeper, StepRecord, run_closed_loop
from thermoforce_mpc.loop.kept_steps import KeptSteps
from thermoforce_mpc.loop.unit_doubts import UnitDoubts
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.plants.registry import boptest_plant, windows_of, with_comfort
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller, Plant
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import merge, suggestion
from thermoforce_mpc.scenario.testcase import TestCase

if TYPE_CHECKING:  # loaded only when a controller needs a model
    from thermoforce_mpc.model.thermal_model import ThermalModel

# BOPTEST's names and those of plants of our own; the plant knows which of them it has.
_NAMED_PERIODS = (
    "peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day", "cold_week",
    "sunny_week",
)  # fmt: skip
# Distance of a thermostat's set-point from the bound, K: that of its defaults from BOPTEST's bounds.
_INSIDE_K = 0.3
# Distance of the instants at which prices must be known, s.
_PRICE_STEP_S = 900.0


def attached_plant(scenario: Scenario, testcase: TestCase, testid: str) -> Plant:
    """The plant of a scenario at a service that has its test `testid` already; raises `NoSuchTest`, `PlantError`."""
    plant = boptest_plant(scenario.plant, testcase, None, scenario.seed, testid)
    return with_comfort(plant, scenario.comfort, testcase)


def controller_options(scenario: Scenario, name: str) -> dict[str, Any]:
    """Options of the controller `name` in this scenario: its own, then the scenario's control step.

    A thermostat without set-points of its own keeps those of the scenario's comfort bounds, where it has any.
    """
    options = scenario.controller.options if name == scenario.controller.name else {}
    if name == "thermostat" and scenario.comfort and not options.keys() & {"setpoint_C", "setpoints_C"}:
        return merge(_set_points(scenario.comfort, load_testcase(scenario.testcase).layout), options)
    if scenario.step_s is None or not find_entry(name).needs_model:
        return dict(options)
    return merge({"step_s": scenario.step_s}, options)


def _set_points(comfort: Comfort, layout: Layout) -> dict[str, Any]:
    """Set-points inside the strictest bounds of each zone: a thermostat cannot heat ahead of a bound that rises."""
    bounds_C = comfort.strictest_C(layout.names.zones)
    heating = [round(lower + _INSIDE_K, 2) for lower, _ in bounds_C]
    cooling = [round(upper - _INSIDE_K, 2) for _, upper in bounds_C]
    acting = zip(layout.names.actuators, layout.home, layout.signs, strict=True)
    set_points = {name: (heating if sign > 0 else cooling)[home] for name, home, sign in acting}
    return {"setpoints_C": set_points, "cooling_setpoint_C": max(*heating, min(cooling))}


def scored_period(plant: Plant, name: str, days: float) -> Period:
    """The window called `name` on this plant, `days` long; raises `ConfigError` for a name that is not one."""
    check_window(name)
    return replace(plant.period(name), scored_s=days * DAY_S)


@dataclass(frozen=True)
class Setting:
    """A plant in a scenario, on which controllers are run over the window `period`."""

    plant: Plant
    scenario: Scenario
    testcase: TestCase
    period: Period

    @classmethod
    def of(cls, plant: Plant, scenario: Scenario, testcase: TestCase) -> Setting:
        """That of a scenario; raises `ConfigError` for a window that is none, or prices that end before it does."""
        period = scored_period(plant, scenario.period, scenario.days)
        check_prices(scenario, period)
        return cls(plant, scenario, testcase, period)

    def controller(self, name: str, model: ThermalModel | str | None = None) -> Controller:
        """The controller `name` of the scenario; `model`: as `build_controller` takes it."""
        return build_controller(name, controller_options(self.scenario, name), self.testcase, model)

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
        testcase, scenario, lowest = self.testcase, self.scenario, self.testcase.layout.lowest
        check_prices(scenario, self.period, max(controller.horizon_s - controller.step_s, 0.0))
        return run_closed_loop(
            self.plant,
            controller,
            self.period,
            scenario.price,
            on_step,
            limits_of(controller, testcase.area_m2, min(lowest)),
            lowest,
            keeper,
            steps,
            outage_h=scenario.plant.forecast_outage_h,
            units=UnitDoubts(testcase.layout, getattr(controller, "model", None), testcase.currency),
        )


def check_prices(scenario: Scenario, period: Period, ahead_s: float = 0.0) -> None:
    """Refuse (`ConfigError`) a file of prices that ends before the window does, or forecasts `ahead_s` beyond it do."""
    if scenario.plant.prices_file is None or scenario.price != "highly_dynamic":
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulInput)  # said when the plant was built
        tariff = tariff_from_file(Path(scenario.plant.prices_file))
    until_s = period.start_s + period.scored_s + ahead_s
    tariff(np.append(np.arange(period.start_s, until_s, _PRICE_STEP_S), until_s))


def check_window(name: str, key: str = "period") -> None:
    """Refuse a `name` that no plant can know as a window; raises `ConfigError` naming `key` and those there are."""
    try:
        if not 0.0 <= float(name) < 365.0:
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
