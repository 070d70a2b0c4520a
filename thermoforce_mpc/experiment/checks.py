"""Checks of a scenario before a run."""

from __future__ import annotations

from collections.abc import Collection

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
from thermoforce_mpc.scenario.own_code import code_file
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase


def validate_scenario(scenario: Scenario, unread: Collection[str] = ()) -> TestCase:
    """Check a scenario without running it; returns its test case. Raises `ConfigError`.

    `unread`: files of code that are not run, and for what they hold not checked (`looked_at` does what can be).
    """
    testcase = load_testcase(scenario.testcase)
    check_window(scenario.period)
    own = scenario.controller.name
    for name in (own, *scenario.baselines):
        if code_file(name) in unread:
            continue
        controller_config(name, controller_options(scenario, name), testcase)
        if find_entry(name).needs_model:
            if code_file(own) not in unread and not find_entry(own).needs_model:
                raise ConfigError(
                    f"baselines: '{name}' needs a model, but the controller of this scenario identifies none"
                )
            identification_settings(scenario, testcase, name)
    check_plant(scenario.plant, testcase)
    own_kpis(kpi for kpi in scenario.kpis if code_file(kpi) not in unread)
    return testcase


def check_contestants(scenario: Scenario, testcase: TestCase, unread: Collection[str] = ()) -> None:
    """Build the contestants as far as they can be before probing: what is refused now costs nobody days of it.

    With a saved model that is all of them, without one what they forecast with. The probing that is taken is read too.
    `unread`: files of code that are not run, and names of forecasters that are not fetched.

    Raises:
        ConfigError, ArtifactError, JournalError, BackboneError: options, saved model, probing of an earlier run, or the
            forecaster's weights cannot be used.
    """
    everyone = (scenario.controller.name, *scenario.baselines)
    contestants = [name for name in everyone if code_file(name) not in unread and find_entry(name).needs_model]
    model = saved_model(scenario, testcase) if contestants and scenario.identification.model is not None else None
    for name in contestants:
        if model is None:
            taken_probing(identification_task(scenario, testcase, name))
        options = controller_options(scenario, name)
        config = controller_config(name, options, testcase)
        terms, method = getattr(config, "terms", None), getattr(config, "free_response", None)
        if method is not None and method.options.get("backbone") in unread:
            continue
        if terms is not None and code_file(terms) not in unread:
            from controllers.optimisation.statement.terms import load_terms  # loads CasADi

            load_terms(terms)
        if model is not None and (terms is None or code_file(terms) not in unread):
            build_controller(name, options, testcase, model)
            continue
        if method is not None and not needs_identified(method.name):
            build_free_response(method.name, **method.options)
