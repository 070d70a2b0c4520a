"""One offset of the heating curve for two rooms: its effect on each is learned, and planned for both."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from home_by_curve import EMITTER_W_K, ROOMS, RULES, SETPOINT_C, HomeByCurve, cop, curve_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.cli import cli
from thermoforce_mpc.commands.meter import MeterEffect
from thermoforce_mpc.data import Observation, PlanStatus
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.effects.meters import power_of_machine
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.card import TOGETHER_SD, Competence, HorizonScore, ModelCard
from thermoforce_mpc.scenario.settings import validate


@pytest.fixture(scope="module")
def home():
    return HomeByCurve()


@pytest.fixture(scope="module")
def measured(home):
    return read_measurements(home.measurements(), RULES, step_s=3600.0).served()


def controller(home, measured, model=None, gate=False):
    options = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}}
    options |= {"gate": {"enabled": gate}, "watch": {"enabled": False}}
    model = model or curve_model(home)
    return ThermoForceMPC(model, MPCConfig.model_validate(options), commands=learned_commands(measured))


@pytest.fixture(scope="module")
def plan(home, measured):
    ahead = read_forecast(home.forecast(), measured)
    return controller(home, measured).plan(Observation(measured.record, ahead))


def test_what_an_offset_does_is_learned_for_each_room_from_one_record(measured):
    learned = learned_commands(measured)
    assert set(learned) == set(ROOMS)
    assert {one.machine for one in learned.values()} == {"heat_pump"}
    for name, one in learned.items():
        room = SETPOINT_C[name], 3.0, 0.3
        more = one.loop.level(3.0, *room) - one.loop.level(-3.0, *room)
        assert more > 0.05
        assert (one.usual == 0.0).all()


def test_both_rooms_have_the_one_offset_that_is_good_for_both(plan):
    living, bedroom = plan.settings
    assert living == bedroom
    assert {one.value for one in living} <= set(np.arange(-3.0, 4.0))
    assert all(one.end_s - one.start_s >= 1800.0 for one in living[1:-1])
    assert plan.saving.gain > 0.0
    assert plan.saving.outside_Kh <= plan.saving.outside_alone_Kh + 0.5


@pytest.mark.slow
def test_a_small_room_is_kept_as_warm_as_a_large_one(home, measured):
    """Weights go by floor area: a kelvin in 3 m² would count less than an hour of the heat that avoids it."""
    ahead = read_forecast(home.forecast(), measured)
    more_K = np.array([[0.0], [1.5]])
    asked = Observation(measured.record, replace(ahead, lower_C=ahead.lower_C + more_K, upper_C=ahead.upper_C + 2.0))
    outside_Kh = []
    for area_m2 in ((30.0, 30.0), (57.0, 3.0)):
        model = replace(curve_model(home), floor_area_m2=area_m2)
        outside_Kh.append(controller(home, measured, model).plan(asked).saving.outside_Kh)
    assert outside_Kh[1] <= outside_Kh[0] + 0.1


def judged_plan(home, measured, **reasons):
    """The plan where models of the rooms in `reasons` may not act, of these, ± 60 % by themselves, ± 20 % together."""
    cards = []
    for name in ROOMS:
        why = reasons.get(name, ())
        verdict = Competence(not why, why, effect_K=2.0, effect_sd_K=1.2 if why else 0.2)
        cards.append(ModelCard("a record", uncertainty={TOGETHER_SD: 0.2}, competence=verdict))
    return plan_by(home, measured, cards)


def plan_by(home, measured, cards):
    model = replace(curve_model(home), cards=tuple(cards))
    ahead = read_forecast(home.forecast(), measured)
    return controller(home, measured, model, gate=True).plan(Observation(measured.record, ahead))


@pytest.mark.slow
def test_one_command_acts_where_its_joint_effect_is_known(home, measured, plan):
    """A bedroom whose model may not act closed the offset of the whole house."""
    found = judged_plan(home, measured, bedroom=("a lead time misses", "another one too"))
    assert found.saving.gain > 0.0
    assert found.blocks[0].told == (found.blocks[0].told[0],) * 2 != (None, None)
    assert "bedroom: acts with the others" in found.why
    assert "its room is held away from its bounds" in found.why
    living = judged_plan(home, measured, living=("a lead time misses", "another one too"))
    assert living.status == PlanStatus.GATE
    assert {block.told for block in living.blocks} == {(None, None)}


def test_what_is_known_together_is_enough_for_one_command(home, measured, plan):
    apart = "the effect of 8 h at full level is known to ± 60 % only, need 40 %"
    found = judged_plan(home, measured, living=(apart,), bedroom=(apart,))
    assert [one.value for one in found.settings[0]] == [one.value for one in plan.settings[0]]
    assert "known to ± 15 % together" in found.why


@pytest.mark.slow
def test_a_room_that_is_not_known_is_not_brought_nearer_to_its_bounds(home, measured, plan):
    """Predictions err there, and what is done may do more than is said: a plan for the living room took no notice."""
    found = judged_plan(home, measured, bedroom=("a lead time misses", "another one too"))
    middle_C = SETPOINT_C["bedroom"]
    assert np.abs(found.T_zone_C[1] - middle_C).max() < np.abs(plan.T_zone_C[1] - middle_C).max() - 0.02
    assert 0.0 < found.saving.gain <= found.saving.saved


@pytest.mark.slow
def test_errors_of_the_free_part_are_in_the_band(home, measured):
    """What a day's weather, sun and people do moves what is needed, left alone and planned."""
    widths = []
    for error_K in (0.02, 0.9):
        scores = tuple(HorizonScore(hours, error_K, 2.0, 2.0, 9.0, 9) for hours in (1.0, 6.0))
        verdict = Competence(True, horizons=scores, effect_K=2.0, effect_sd_K=0.2)
        found = plan_by(home, measured, [ModelCard("a record", competence=verdict)] * len(ROOMS)).saving
        widths.append(found.high - found.low)
    # Most of the band is what plans save at all, and that of levels, which do not go by it.
    assert widths[1] > 1.01 * widths[0]


@pytest.mark.slow
def test_what_else_is_on_the_meter_is_no_cost_of_heat(home, measured, monkeypatch):
    """Heat that is stored was counted at what hot water and standby cost too: a plan kept more of it."""
    found = []
    for base_W in (0.0, 800.0):
        unmoved = MeterEffect(
            np.empty(0), 0.0, 3.0, np.full(1, np.nan), np.zeros(4), np.zeros((4, 4)), base_W, np.full(24, base_W),
            np.empty((0, 24)),
        )  # fmt: skip
        monkeypatch.setattr("controllers.mpc.commands.costs.learn_meter", lambda command, seen, one=unmoved: one)
        ahead = read_forecast(home.forecast(), measured)
        found.append(controller(home, measured).plan(Observation(measured.record, ahead)))
    assert found[1].saving.cost_alone > found[0].saving.cost_alone + 1.0
    assert found[1].settings == found[0].settings
    assert found[1].saving.saved == pytest.approx(found[0].saving.saved, abs=1e-9)


@pytest.mark.slow
def test_the_machine_is_set_once(home, measured):
    building = copy.deepcopy(home)
    live = LiveBuilding(building, validate(MeasurementMap, RULES, "rules"), 3600.0)
    control(live, controller(home, measured), clock=building, steps=2, delay_s=0.0)
    assert building.written[-1][1] is None
    assert any(value is not None for _, value in building.written)


@pytest.mark.slow
def test_no_offset_is_planned_of_which_the_record_does_not_tell(home, measured):
    """A plan took −3 K where 2 K had been tried, and counted on what −2 K does."""
    table = home.measurements()
    table["offset"] = table["offset"].clip(-2.0, 2.0)
    tried = read_measurements(table, RULES, step_s=3600.0).served()
    plan = controller(home, tried).plan(Observation(tried.record, read_forecast(home.forecast(), tried)))
    assert {one.value for one in plan.settings[0]} <= {-2.0, -1.0, 0.0, 1.0, 2.0}


def test_a_record_of_one_offset_does_not_tell_what_another_does():
    home = HomeByCurve(days=8, trials=0)
    measured = read_measurements(home.measurements(), RULES, step_s=3600.0).served()
    with pytest.raises(DataError, match=r"machines\.heat_pump\.command .* for living: it was 0 all the time"):
        learned_commands(measured)


def test_a_room_with_a_command_of_its_own_is_refused_beside_that_of_its_machine():
    rules = copy.deepcopy(RULES)
    rules["actuators"]["living"]["command"] = {"kind": "setpoint", "column": "set"}
    with pytest.raises(ConfigError, match="living, which it feeds, has a command of its own"):
        validate(MeasurementMap, rules, "map.yaml")


def test_power_knows_what_a_kelvin_of_flow_costs(home, measured):
    """Half of Carnot: heat of both rooms, valves as usual, from water of 36 and of 40 °C."""
    valve = {name: float(np.mean([row[f"valve_{name}"] for row in home.rows])) for name in ROOMS}
    config = IdentificationConfig(power_curve=True)
    power = power_of_machine([measured.record], config, measured.layout, 0)
    full_K = {
        name: float(note.split(" 1 at ")[1].split(" K")[0])
        for name in ROOMS
        for note in measured.understood.assumed
        if f"level of {name}" in note
    }

    def by_law_and_truth_W(flow_C):
        over_K = {name: valve[name] * (flow_C - SETPOINT_C[name]) for name in ROOMS}
        u = np.array([[over_K[name] / full_K[name]] for name in ROOMS])
        heat_W = sum(0.8 * EMITTER_W_K[name] * over_K[name] for name in ROOMS)
        law_W = power.of_actuators(u, measured.layout.weights, np.array([2.0]))
        return float(law_W.item()), heat_W / cop(flow_C, 2.0)

    (cool, cool_true), (warm, warm_true) = by_law_and_truth_W(36.0), by_law_and_truth_W(40.0)
    assert cool == pytest.approx(cool_true, rel=0.1)
    assert (warm - cool) == pytest.approx(warm_true - cool_true, rel=0.2)


@pytest.mark.slow
def test_it_is_told_once_under_the_name_of_the_machine(home, tmp_path):
    curve_model(home).save(tmp_path / "model")
    home.measurements().to_csv(tmp_path / "house.csv", index=False)
    home.forecast().to_csv(tmp_path / "tomorrow.csv")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(RULES, sort_keys=False))
    words = ["plan", "--model", tmp_path / "model", "--map", tmp_path / "map.yaml", "--data", tmp_path / "house.csv"]
    words += ["--forecast", tmp_path / "tomorrow.csv", "--hours", "12", "--commands", tmp_path / "told.csv"]
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    told = pd.read_csv(tmp_path / "told.csv")
    assert set(told["actuator"]) == {"heat_pump"}
    assert set(told["unit"]) == {"K"}
    assert told["from"].is_unique
