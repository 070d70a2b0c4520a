"""The choice between on/off blocks and modulation, from the identified laws."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from houses import House, record
from simple_house import SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.actuation.actuator import ActuationConfig
from controllers.actuation.actuators import Actuators
from controllers.actuation.choice import choose_actuation
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.identification import identify
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.models.identifying import identification_settings


def beginning() -> Record:
    return Record.beginning(SimpleHouse().reset(10 * DAY_S, 0.0))


def law(fixed: float, per_u: float, lowest: float = 0.2, seen: bool = True) -> MachineLoad:
    return MachineLoad((fixed, 0.0, per_u, 0.0), (-10.0, 20.0), lowest, levels_seen=seen)


def choose(power: MachineLoad, heat: MachineLoad | None = None, **options):
    heat_input = IDENTITY if heat is None else HeatInput(heat=heat)
    return choose_actuation(ActuationConfig(**options), PowerModel(power), heat_input)


@pytest.mark.parametrize(
    ("power", "heat", "modulates", "words"),
    [
        (law(1300, 1700), law(1000, 9000), False, r"on/off blocks at 1\.00: 43 % of full power and 10 % of full heat"),
        (law(600, 5000), None, False, r"11 % of full power .* 1\.11 times the power per heat"),
        (law(0, 5600), None, True, r"modulating, any level held for the step: 0 % of full power"),
        (law(200, 5400), None, True, r"modulating, any level held"),
        (law(500, 2500), law(1700, 8300), True, r"modulating, any level held"),
        (law(0, 3000), law(2500, 7500), True, r"modulating, off or at least 0\.20 held .* 0\.80 times"),
        (law(0, 3000, 1.0, seen=False), None, False, r"the data hold off and full level only"),
    ],
    ids=["heat pump", "fan", "boiler", "pump", "both fixed", "inverter", "unseen"],
)
def test_the_laws_decide(power, heat, modulates, words):
    choice = choose(power, heat)
    assert choice.actuation.modulates is modulates
    assert re.search(words, choice.why), choice.why


def test_a_named_mode_stays():
    assert choose(law(1300, 1700), mode="modulating").actuation.modulates
    assert not choose(law(0, 3000), mode="duty").actuation.modulates
    assert "as configured" in choose(law(0, 3000), mode="duty").why


def test_a_machine_without_a_fixed_part_is_a_quadratic_programme_at_any_level():
    model = simple_model()
    boiler = replace(model, power=(PowerModel(law(0.0, 4300.0)),))
    controller = ThermoForceMPC(boiler, MPCConfig(step_s=None), free_response=object())
    assert controller.solver.model.convex
    assert not controller.solver.model.structure.chosen
    assert controller.actuation_in_words.startswith("modulating, any level")
    actuators = Actuators(controller.model.layout, [choose(law(0.0, 4300.0)).actuation])
    (block,) = actuators.realise([0.07], 3600.0, actuators.now(None, beginning())).together()
    assert block.u == (0.07,)
    (block,) = actuators.realise([1e-7], 3600.0, actuators.now(None, beginning())).together()
    assert block.u == (0.0,), "what a solver leaves of zero does not run the pump"


def test_set_points_modulate_and_rules_follow_the_map():
    water = load_testcase("bestest_hydronic")
    assert controller_config("thermoforce_mpc", {}, water).actuation.mode == "auto"
    assert controller_config("pi", {}, water).actuation.mode == "modulating"
    room = load_testcase("bestest_air")
    assert controller_config("thermoforce_mpc", {}, room).actuation.mode == "room_setpoints"
    held = water.model_copy(update={"actuator": water.actuator.model_copy(update={"kind": "setpoint"})})
    assert controller_config("thermoforce_mpc", {}, held).actuation.mode == "modulating"
    pump = load_testcase("bestest_hydronic_heat_pump")
    assert controller_config("pi", {}, pump).actuation.mode == "auto"


def test_probing_sees_part_load_where_it_is_to_be_decided():
    pump = Scenario(testcase="bestest_hydronic_heat_pump")
    probing, identification = identification_settings(pump, load_testcase(pump.testcase))
    assert (probing.levels, probing.trial_levels) == ((0.0, 1.0), (0.5,))
    assert identification.lowest_level == 0.5
    named = Scenario(testcase=pump.testcase, controller={"options": {"actuation": {"mode": "duty"}}})
    probing, identification = identification_settings(named, load_testcase(pump.testcase))
    assert (probing.trial_levels, identification.lowest_level) == ((), None)
    water = Scenario(testcase="bestest_hydronic")
    probing, identification = identification_settings(water, load_testcase(water.testcase))
    assert probing.trial_levels == (), "its own levels show part load"
    assert identification.lowest_level == 0.1


@pytest.mark.slow
def test_blocks_below_full_level_are_identified_at_the_one_level_that_is_probed():
    """Before, a run ended after probing: "the data have only off and full level"."""
    blocks = {"mode": "duty", "level": 0.6}
    pump = Scenario(testcase="bestest_hydronic_heat_pump", controller={"options": {"actuation": blocks}})
    probing, identification = identification_settings(pump, load_testcase(pump.testcase))
    assert (probing.levels, identification.lowest_level) == ((0.0, 0.6), 0.6)
    levels = np.tile(np.repeat([0.0, 0.6], 16), 6)
    run = record(House(), 2.0, u=levels, noise_K=0.01)
    linear = identification.model_copy(update={"modulation": "linear"})
    model = identify([run], config=linear, floor_area_m2=190.0)
    controller = ThermoForceMPC(model, MPCConfig(actuation=blocks, free_response={"name": "linear_weather"}))
    assert "on/off blocks at 0.60" in controller.actuation_in_words
    on = levels > 0
    told = model.only.power(np.full(on.sum(), 0.6), run.T_out_C[:-1][on], run.T_return_C[0][on])
    np.testing.assert_allclose(told, run.power_W[0][on], rtol=0.1)
