"""Checks of a scenario before a run."""

from __future__ import annotations

from controllers.registry import controller_config, find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.scenario import Scenario, load_testcase
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.composition import controller_options
from thermoforce_mpc.simulation.identifying import identification_settings


def validate_scenario(scenario: Scenario) -> TestCase:
    """Check a scenario without running it; returns its test case. Raises `ConfigError`."""
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
    on_engine = testcase.energyplus is not None or testcase.plant == "small_office"
    own_weather = scenario.plant.kind == "embedded" and (on_engine or testcase.plant is not None)
    if own_weather and scenario.plant.weather != "synthetic":
        raise ConfigError(f"plant.weather: test case '{testcase.name}' has its own weather; leave it out")
    if scenario.plant.kind == "embedded" and on_engine:
        from thermoforce_mpc.plants.energyplus.engine import is_available

        if not is_available():
            raise ConfigError(
                f"test case '{testcase.name}' runs on EnergyPlus: pip install 'thermoforce-mpc[energyplus]'"
            )
    elif scenario.plant.kind == "embedded" and not testcase.embedded and testcase.plant is None:
        raise ConfigError(
            f"plant.kind: the embedded emulator is bestest_hydronic_heat_pump, not {testcase.name}; "
            "give the address of a BOPTEST service with --url, or the test case's FMU with --fmu"
        )
    return testcase
