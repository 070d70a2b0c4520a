"""The level at which a machine is switched, from what heat costs at part load or from the identified laws."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from houses import House, record
from simple_house import SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.actuation.actuator import ActuationConfig, choose_actuation
from controllers.actuation.actuators import Actuators
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings
from thermoforce_mpc.identification import identify
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import LevelCost, PowerModel, ReturnWater
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario


def beginning() -> Record:
    return Record.beginning(SimpleHouse().reset(10 * DAY_S, 0.0))


def law(fixed: float, per_u: float, lowest: float = 0.2, seen: bool = True) -> MachineLoad:
    return MachineLoad((fixed, 0.0, per_u, 0.0), (-10.0, 20.0), lowest, levels_seen=seen)


def cost(level: float, cost: float) -> LevelCost:
    return LevelCost(level, cost, 0.03, 1.0, 0.02)


def choose(power: MachineLoad, heat: MachineLoad | None = None, costs=(), *, shared: bool = False, **options):
    heat_input = IDENTITY if heat is None else HeatInput(heat=heat)
    return choose_actuation(ActuationConfig(**options), PowerModel(power), heat_input, costs, shared=shared)


FIXED_SPEED, INVERTER = law(1300, 1700), law(0, 3000)


@pytest.mark.parametrize(
    ("costs", "lowest", "words"),
    [
        ((), None, "on/off blocks at 1.00: 43 % of full power and 0 % of full heat are a fixed part while on"),
        (((0.25, 1.6), (0.5, 1.2)), None, "on/off blocks at 1.00: at level 0.50 heat costs 1.20 ± 0.03 times as much"),
        (((0.25, 1.1), (0.5, 0.85)), 0.5, "levels from 0.50 held for the step, on/off blocks below: at level 0.50"),
        (((0.25, 0.7), (0.5, 0.85)), 0.25, "levels from 0.25 held for the step, on/off blocks below: at level 0.25"),
        (((0.25, 1.01),), 0.25, "levels from 0.25 held"),
        (((0.25, 1.04),), None, "on/off blocks at 1.00: at level 0.25"),
    ],
    ids=["by the laws", "fixed speed", "inverter", "hot water", "the same but for noise", "dearer"],
)
def test_a_machine_is_switched_where_heat_costs_least(costs, lowest, words):
    power = FIXED_SPEED if lowest is None else INVERTER
    choice = choose(power, None, [cost(*one) for one in costs])
    assert words in choice.why
    assert choice.actuation.modulates is (lowest is not None)
    assert choice.actuation.block_level == (lowest or 1.0)
    if lowest is None:
        assert choice.power.load == FIXED_SPEED, "blocks at full level draw what was identified there"


def test_heat_that_a_meter_knows_of_blocks_is_given_in_blocks():
    """Before, 'tf-mpc plan' of a house with only a heat meter ended: "the data have only off and full level"."""
    by_meter = law(0.0, 7000.0, 1.0, seen=False)
    choice = choose(by_meter, by_meter, [cost(0.21, 1.0), cost(0.72, 1.0)])
    assert not choice.actuation.modulates
    lowest = choice.actuation.lowest_level
    assert HeatInput(heat=by_meter).at_lowest_level(lowest)(0.4, 0.0) == pytest.approx(0.4)
    assert choice.power.at_lowest_level(lowest).load == by_meter


def test_a_fixed_part_on_the_meter_counts_more_than_heat_guessed_from_temperatures():
    fan, costs = law(350, 2650), [cost(0.5, 0.87), cost(0.25, 1.03)]
    choice = choose(fan, None, costs)
    assert "on/off blocks at 1.00: 12 % of full power" in choice.why
    assert choice.power.load == fan
    assert choose(fan, law(1700, 8300), costs).actuation.modulates, "measured heat says what it costs"
    assert choose(law(200, 2800), None, costs).actuation.modulates, "a small one may be an error of the law"
    quarter = [cost(0.5, 1.0), cost(0.25, 1.0)]
    assert choose(law(150, 2850), None, quarter).actuation.modulates, "at a quarter as well"
    limited = [LevelCost(0.25, 1.0, 0.03, 1.67, 0.1), LevelCost(0.5, 1.0, 0.03, 1.67, 0.1)]
    assert choose(law(1000, 2000), None, limited).actuation.modulates, "full level gives little more than a half"


def test_a_fixed_part_needs_a_start():
    """An electric heater that its water holds back at full level: 20 kW per level below, and a law that bends down."""
    bent = law(2300, 13300)
    proportional = [LevelCost(0.25, 1.02, 0.1, 1.0, 0.1), LevelCost(0.5, 1.02, 0.1, 1.0, 0.1)]
    assert choose(bent, None, proportional).actuation.modulates
    starts = [LevelCost(0.25, 1.3, 0.1, 1.0, 0.1), LevelCost(0.5, 1.02, 0.1, 1.0, 0.1)]
    assert "15 % of full power" in choose(bent, None, starts).why


def test_the_return_water_says_what_part_load_costs_in_the_same_water():
    """Trials at part load were in cooler water, which hides a fixed loss that is on the meter."""
    costs, heat = [cost(0.5, 1.02), cost(0.25, 1.4)], HeatInput(heat=law(400, 9600))
    for water, modulates in ((ReturnWater(0.007, 40.0, (20.0, 50.0), 18.0), False), (None, True)):
        choice = choose_actuation(ActuationConfig(), PowerModel(law(400, 1700), water=water), heat, costs)
        assert choice.actuation.modulates is modulates
    inverter = PowerModel(law(100, 2000), water=ReturnWater(0.007, 40.0, (20.0, 50.0), 18.0))
    assert choose_actuation(ActuationConfig(), inverter, heat, [cost(0.25, 0.8)]).actuation.modulates


@pytest.mark.parametrize("heat", [None, law(1700, 8300)], ids=["levels", "measured heat"])
def test_plans_count_with_the_cost_of_heat_that_was_found(heat):
    costs = [cost(0.5, 0.85), cost(0.25, 0.8)]
    choice = choose(INVERTER, heat, costs)
    full_W, share = 3000.0, (lambda u: u) if heat is None else (lambda u: float(heat(u, 0.0)) / 10000.0)
    assert choice.power.at_lowest_level(0.25)(np.array(1.0), 0.0) == pytest.approx(full_W, rel=1e-3)
    for one in costs:
        planned_W = float(choice.power.at_lowest_level(0.25)(np.array(one.level), 0.0))
        assert planned_W == pytest.approx(one.cost * share(one.level) * full_W, rel=0.03)
    named = choose(INVERTER, heat, costs, mode="modulating", lowest_level=0.5)
    assert named.power.load == choice.power.load
    for stays in ({"mode": "duty"}, {"mode": "modulating", "lowest_level": 0.0}):
        assert choose(INVERTER, heat, costs, **stays).power.load == INVERTER


@pytest.mark.parametrize(
    ("power", "heat", "modulates", "words"),
    [
        (law(1300, 1700), law(1000, 9000), False, r"on/off blocks at 1\.00: 43 % of full power and 10 % of full heat"),
        (law(600, 5000), None, False, r"11 % of full power .* 1\.11 times as much power at half level"),
        (law(0, 5600), None, True, r"modulating, any level held for the step: 0 % of full power"),
        (law(500, 2500), law(1700, 8300), True, r"modulating, any level held"),
        (law(0, 3000), law(2500, 7500), True, r"modulating, any level held .* 0\.80 times"),
        (law(0, 3000, 1.0, seen=False), None, False, r"the data hold off and full level only"),
    ],
    ids=["heat pump", "fan", "boiler", "both fixed", "inverter", "unseen"],
)
def test_the_laws_decide_of_a_machine_that_feeds_several(power, heat, modulates, words):
    choice = choose(power, heat, [cost(0.5, 0.7)], shared=True)
    assert choice.actuation.modulates is modulates
    assert not (modulates and choice.actuation.switches), "it cannot hold levels of one actuator above blocks of it"
    assert re.search(words, choice.why), choice.why
    assert choice.power.load == power


def test_a_named_mode_stays():
    assert choose(law(1300, 1700), mode="modulating").actuation.modulates
    assert not choose(law(0, 3000), None, [cost(0.5, 0.7)], mode="duty").actuation.modulates
    assert "as configured" in choose(law(0, 3000), mode="duty").why


def test_the_cost_on_the_card_of_a_model_is_in_the_plan():
    model = simple_model()
    boiler = replace(model, power=(PowerModel(law(0.0, 4300.0)),))
    controller = ThermoForceMPC(boiler, MPCConfig(step_s=None), free_response=object())
    assert controller.actuation_in_words.startswith("modulating, any level held for the step: 0 % of full power")
    told = replace(model.only.card, uncertainty=model.only.card.uncertainty | cost(0.25, 0.8).numbers())
    controller = ThermoForceMPC(replace(boiler, cards=(told,)), MPCConfig(step_s=None), free_response=object())
    assert controller.actuation_in_words.startswith("modulating, levels from 0.25 held")
    assert controller.solver.model.structure.stepped == (0,)
    assert not controller.solver.model.structure.chosen


def test_what_a_solver_leaves_of_zero_does_not_run_a_pump_that_holds_any_level():
    choice = choose(law(0.0, 4300.0), mode="modulating", lowest_level=0.0)
    actuators = Actuators(simple_model().layout, [choice.actuation])
    for u, held in ((0.07, 0.07), (1e-7, 0.0)):
        (block,) = actuators.realise([u], 3600.0, actuators.now(None, beginning())).together()
        assert block.u == (held,)


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
    probing, identification = identification_settings(pump, chosen_of(pump, load_testcase(pump.testcase)))
    assert (probing.levels, probing.trial_levels) == ((0.0, 1.0), (0.5, 0.25))
    assert identification.lowest_level == 0.25
    named = Scenario(testcase=pump.testcase, controller={"options": {"actuation": {"mode": "duty"}}})
    probing, identification = identification_settings(named, chosen_of(named, load_testcase(pump.testcase)))
    assert (probing.trial_levels, identification.lowest_level) == ((), None)
    water = Scenario(testcase="bestest_hydronic")
    probing, identification = identification_settings(water, chosen_of(water, load_testcase(water.testcase)))
    assert probing.trial_levels == (), "its own levels show part load"
    assert identification.lowest_level == 0.1


@pytest.mark.slow
def test_blocks_below_full_level_are_identified_at_the_one_level_that_is_probed():
    """Before, a run ended after probing: "the data have only off and full level"."""
    blocks = {"mode": "duty", "level": 0.6}
    pump = Scenario(testcase="bestest_hydronic_heat_pump", controller={"options": {"actuation": blocks}})
    probing, identification = identification_settings(pump, chosen_of(pump, load_testcase(pump.testcase)))
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
