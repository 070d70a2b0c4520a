"""The paper's configuration: its operator, any level in [0, 1], and Ipopt over the exported operator."""

from __future__ import annotations

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.actuation.actuator import ActuationConfig
from controllers.registry import controller_config
from thermoforce_mpc.data import HOUR_S, Observation
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.scenario.settings import find_config


def test_the_scenario_says_what_the_paper_prints():
    scenario = load_scenario(find_config("scenarios", "paper_closed_loop"), {})
    testcase = load_testcase(scenario.testcase)
    c = controller_config(scenario.controller.name, scenario.controller.options, testcase)
    identification = identification_settings(scenario, chosen_of(scenario, testcase))[1]
    assert (c.solver, c.horizon_h, c.step_s, scenario.step_s) == ("ipopt", 24.0, None, HOUR_S)
    assert (c.free_response.name, c.backoff_level, c.comfort_margin_K, c.corrections) == ("chronos", 0.5, 0.0, False)
    assert (identification.method, identification.order, identification.heat_input) == ("two_stage", 1, "identity")
    assert (identification.gamma, identification.hidden, identification.optimiser) == (0.75, 32, "adam")
    assert 300 <= identification.epochs <= 400


def test_a_machine_with_a_fixed_part_is_planned_at_any_level_without_a_choice():
    options = {"mode": "modulating", "lowest_level": 0.0}
    testcase = load_testcase("bestest_hydronic_heat_pump")
    config = controller_config("thermoforce_paper", {}, testcase)
    assert config.actuation == ActuationConfig(**options)
    mpc = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    plan = mpc.plan(Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S)))
    assert mpc.solver.model.structure.chosen == ()
    assert mpc.solver.model.convex
    assert plan.solver_status == "ipopt:Solve_Succeeded"
    assert np.any((plan.u > 0.01) & (plan.u < 0.29)), "also levels below 0.3"
    assert [block.duration_s for block in plan.blocks] == [HOUR_S]
    assert plan.blocks[0].u[0] == pytest.approx(plan.u[0, 0], abs=1e-3)


def test_another_free_response_is_not_given_the_options_of_the_forecaster():
    testcase = load_testcase("bestest_hydronic_heat_pump")
    chosen = controller_config("thermoforce_paper", {"free_response": {"name": "rc"}}, testcase).free_response
    assert (chosen.name, dict(chosen.options)) == ("rc", {})
    small = {"free_response": {"name": "chronos", "options": {"backbone": "fracast"}}}
    kept = controller_config("thermoforce_paper", small, testcase).free_response
    assert dict(kept.options) == {"resolutions": "one", "backbone": "fracast"}
