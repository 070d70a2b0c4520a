"""The composition root: builds the plant of a scenario and the options of its controllers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from boptest_client import TransportConfig
from controllers.registry import find_entry
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import merge, suggestion
from thermoforce_mpc.scenario.testcase import TestCase

# BOPTEST's names and those of plants of our own; the plant knows which of them it has.
_NAMED_PERIODS = (
    "peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day", "cold_week",
    "sunny_week",
)  # fmt: skip


def build_plant(spec: PlantSpec, testcase: TestCase, seed: int) -> Plant:
    """Build the plant of a scenario.

    Raises:
        ConfigError: the FMU cannot be used, or the test case does not fit the plant.
        WeatherError: the weather file cannot be used.
        PlantError: the service does not answer.
    """
    if spec.kind == "boptest":
        from thermoforce_mpc.plants.boptest.plant import BoptestPlant

        return BoptestPlant(
            spec.url, testcase, forecast_uncertainty=spec.forecast_uncertainty, seed=seed, config=_patience(spec)
        )
    from thermoforce_mpc.boundary.forecast_error import ForecastError

    level = spec.forecast_uncertainty
    error = None if level == "none" else ForecastError(level, seed)
    if spec.path is not None:
        from thermoforce_mpc.plants.fmu import FmuPlant

        return FmuPlant(Path(spec.path), testcase, forecast_error=error)
    from thermoforce_mpc.boundary.tariffs import tariff_from_file

    tariff = tariff_from_file(Path(spec.prices_file)) if spec.prices_file else None
    if testcase.plant == "rooms":
        from thermoforce_mpc.plants.rooms import house_of_rooms

        if error is not None or tariff is not None:
            raise ConfigError(
                f"test case '{testcase.name}': it has neither forecast_uncertainty nor prices_file; leave them out"
            )
        return house_of_rooms(testcase.name)
    if testcase.plant == "small_office":
        from thermoforce_mpc.plants.energyplus.office_plant import SmallOfficePlant

        return SmallOfficePlant(testcase, highly_dynamic=tariff, forecast_error=error)
    if testcase.zones:
        raise ConfigError(f"test case '{testcase.name}' has several zones: run it with --url or --fmu")
    if testcase.energyplus is not None:
        from thermoforce_mpc.plants.energyplus.plant import EnergyPlusPlant

        return EnergyPlusPlant(testcase, highly_dynamic=tariff, forecast_error=error)
    from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    weather = synthetic_weather() if spec.weather == "synthetic" else load_weather(Path(spec.weather))
    return EmbeddedPlant(weather, highly_dynamic=tariff, forecast_error=error)


def attached_plant(spec: PlantSpec, testcase: TestCase, seed: int, testid: str) -> Plant:
    """The plant of a scenario at a service that has its test `testid` already.

    Raises:
        NoSuchTest: the service no longer has it.
        PlantError: the service does not answer.
    """
    from thermoforce_mpc.plants.boptest.plant import BoptestPlant

    return BoptestPlant(
        spec.url,
        testcase,
        forecast_uncertainty=spec.forecast_uncertainty,
        seed=seed,
        testid=testid,
        config=_patience(spec),
    )


def _patience(spec: PlantSpec) -> TransportConfig:
    return TransportConfig(patience_s=60.0 * spec.patience_min)


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
