"""Checks of a scenario before a run."""

from __future__ import annotations

from controllers.registry import controller_config, find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.free_response.registry import build_free_response, needs_identified
from thermoforce_mpc.plants.registry import check_plant
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
    check_plant(scenario.plant, testcase)
    return testcase


def check_forecasters(scenario: Scenario, testcase: TestCase) -> None:
    """Load what the contestants forecast with, which says whether it can be: better now than after days of probing.

    Raises `ConfigError`, `BackboneError`.
    """
    for name in (scenario.controller.name, *scenario.baselines):
        config = controller_config(name, controller_options(scenario, name), testcase)
        method = getattr(config, "free_response", None)
        if method is not None and not needs_identified(method.name):
            build_free_response(method.name, **method.options)
