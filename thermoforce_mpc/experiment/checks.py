"""Checks of a scenario before a run."""

from __future__ import annotations

from controllers.registry import build_controller, controller_config, find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.composition import check_window, controller_options
from thermoforce_mpc.experiment.identifying import (
    identification_settings,
    identification_task,
    saved_model,
    taken_probing,
)
from thermoforce_mpc.model.free_response.registry import build_free_response, needs_identified
from thermoforce_mpc.plants.registry import check_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.own_kpis import own_kpis
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase


def validate_scenario(scenario: Scenario) -> TestCase:
    """Check a scenario without running it; returns its test case. Raises `ConfigError`."""
    testcase = load_testcase(scenario.testcase)
    check_window(scenario.period)
    controller_config(scenario.controller.name, controller_options(scenario, scenario.controller.name), testcase)
    if find_entry(scenario.controller.name).needs_model:
        identification_settings(scenario, testcase)
    for name in scenario.baselines:
        controller_config(name, controller_options(scenario, name), testcase)
        if find_entry(name).needs_model:
            if not find_entry(scenario.controller.name).needs_model:
                raise ConfigError(
                    f"baselines: '{name}' needs a model, but the controller of this scenario identifies none"
                )
            identification_settings(scenario, testcase, name)
    check_plant(scenario.plant, testcase)
    own_kpis(scenario.kpis)
    return testcase


def check_contestants(scenario: Scenario, testcase: TestCase) -> None:
    """Build the contestants as far as they can be before probing: what is refused now costs nobody days of it.

    With a saved model that is all of them, without one what they forecast with. The probing that is taken is read too.

    Raises:
        ConfigError, ArtifactError, JournalError, BackboneError: options, saved model, probing of an earlier run, or the
            forecaster's weights cannot be used.
    """
    contestants = [name for name in (scenario.controller.name, *scenario.baselines) if find_entry(name).needs_model]
    model = saved_model(scenario, testcase) if contestants and scenario.identification.model is not None else None
    for name in contestants:
        if model is None:
            taken_probing(identification_task(scenario, testcase, name))
        options = controller_options(scenario, name)
        config = controller_config(name, options, testcase)
        if (terms := getattr(config, "terms", None)) is not None:
            from controllers.optimisation.statement.terms import load_terms  # loads CasADi

            load_terms(terms)
        if model is not None:
            build_controller(name, options, testcase, model)
            continue
        method = getattr(config, "free_response", None)
        if method is not None and not needs_identified(method.name):
            build_free_response(method.name, **method.options)
