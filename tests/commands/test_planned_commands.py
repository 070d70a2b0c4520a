"""Plans in commands: within what a loop can bring, held as long as they must be, and cheaper in the closed loop."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from home_by_setpoint import DAY_C, RULES, START, HomeBySetpoint, price
from simple_house import simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.commands.loop import check_told, left_alone, saving_in_words
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap


def controller(measured, **options):
    off = {"enabled": False}
    base = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    return ThermoForceMPC(simple_model(), MPCConfig.model_validate(base | options), commands=learned_commands(measured))


@pytest.fixture(scope="module")
def home():
    return HomeBySetpoint()


def planned(home, rules=None, **options):
    measured = read_measurements(home.measurements(), rules or RULES, step_s=3600.0).served()
    return controller(measured, **options).plan(Observation(measured.record, read_forecast(home.forecast(), measured)))


def test_what_the_record_does_not_tell_is_left_alone(home):
    """A room whose valve was shut all the time; beside others that the record tells of it is no reason to refuse."""
    measured = read_measurements(home.measurements(), RULES, step_s=3600.0).served()
    (one,) = learned_commands(measured).values()
    shut = replace(one, untold="bedroom: the record does not tell what it does")
    check_told([one, shut])
    with pytest.raises(DataError, match="bedroom: the record does not tell"):
        check_told([shut, shut])
    of_machine = replace(one, machine="heat_pump"), replace(shut, machine="heat_pump")
    assert left_alone(dict(enumerate(of_machine))) == {}
    assert left_alone({0: one, 1: shut}) == {1: shut.untold}
    off = {"enabled": False}
    options = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off}
    mpc = ThermoForceMPC(simple_model(), MPCConfig.model_validate(options), commands={"actuator": shut})
    plan = mpc.plan(Observation(measured.record, read_forecast(home.forecast(), measured)))
    assert {block.told for block in plan.blocks} == {(None,)}
    assert shut.untold in plan.why


def with_command(**keys):
    command = RULES["actuators"]["actuator"]["command"] | keys
    return RULES | {"actuators": {"actuator": {"level": "u", "command": command}}}


@pytest.fixture(scope="module")
def plan(home):
    return planned(home)


def test_set_points_stay_near_the_comfort_band_in_steps_of_their_resolution(plan):
    values = np.array([one.value for one in plan.settings[0]])
    assert ((values >= 18.0) & (values <= 25.0)).all()
    assert np.allclose(values / 0.5, np.round(values / 0.5))
    assert {block.command for block in plan.blocks} <= {(value,) for value in values}


@pytest.mark.slow
@pytest.mark.parametrize("hold_min", [30, 180])
def test_a_set_point_is_held_for_its_least_time(home, hold_min):
    (settings,) = planned(home, with_command(hold_min=hold_min)).settings
    assert len(settings) > 2
    assert all(one.end_s == later.start_s for one, later in pairwise(settings))
    assert all(one.end_s - one.start_s >= 60.0 * hold_min for one in settings[1:-1])


def test_a_loop_answers_the_room_as_it_is_when_the_plan_begins(home):
    """Emitters have warmed the room to 21.1 °C: a set-point of 20 °C brings nothing in the first hour."""
    plan = planned(home, with_command(minimum=17.0, maximum=20.0))
    assert home.measurements()["T"].iloc[-1] > 21.0
    assert plan.u[0, 0] == 0.0
    assert plan.u[0, 1:].max() > 0.0


def test_a_plan_days_after_its_commands_were_learned_holds_none_of_then():
    """Its own control acted since: at noon the people's set-point is held, not that of the night of the start."""
    home = HomeBySetpoint(days=14)
    rules = with_command(hold_min=720)
    measured = read_measurements(home.measurements(), rules, step_s=3600.0).served()
    then = controller(measured)
    home.wait_until(START + pd.Timedelta("12h"))
    now = read_measurements(home.measurements(), rules, step_s=3600.0).served()
    (settings,) = then.plan(Observation(now.record, read_forecast(home.forecast(), now))).settings
    assert settings[0].value == DAY_C


@pytest.mark.slow
def test_the_usual_command_is_of_the_same_day_though_seconds_count_from_another_year(home):
    """A plan's clock goes on over the new year; control that is started again reads a record of this year alone."""
    measured = read_measurements(home.measurements(), RULES, step_s=3600.0).served()
    learned, record = learned_commands(measured)["actuator"], measured.record
    hours = float(record.time_s[-1]) + 3600.0 * np.arange(48)
    weather = np.zeros(hours.size)
    before = record.origin - pd.Timedelta("366D") + pd.Timedelta("5h")
    again = learned.from_origin_s(hours + (record.origin - before).total_seconds(), before)
    np.testing.assert_array_equal(learned.usual_at(again, weather), learned.usual_at(hours, weather))
    then = replace(record, time_s=record.time_s + (record.origin - before).total_seconds(), origin=before)
    ahead = read_forecast(home.forecast(), measured)
    shifted = replace(ahead, time_s=ahead.time_s + (record.origin - before).total_seconds())
    plans = [controller(measured).plan(Observation(*one)) for one in ((record, ahead), (then, shifted))]
    assert [one.value for one in plans[1].settings[0]] == [one.value for one in plans[0].settings[0]]
    assert plans[1].saving.cost_alone == pytest.approx(plans[0].saving.cost_alone)


def test_a_plan_asks_for_no_more_than_its_set_points_bring(home):
    # The room may be 21 °C: at the highest set-point the valve is then half open.
    narrow = planned(home, with_command(beyond_K=0, maximum=21.0))
    warm = narrow.T_zone_C[0, :-1] >= 21.0
    assert narrow.u.max() <= 1.0
    assert (narrow.u[0, 1:][warm] <= 0.6).all()


def test_what_is_saved_has_a_band_and_what_it_is_compared_with(plan):
    saving = plan.saving
    assert saving.low < saving.saved < saving.high
    assert saving.saved > 0.0
    assert saving.cost_alone > 0.0
    assert saving.outside_Kh <= saving.outside_alone_Kh + 0.5
    # Costs and what is stored add up to what is saved.
    stored = float(re.search(r"stored at the end \((-?[\d.]+)\)", saving_in_words(saving))[1])
    assert saving.cost_alone - saving.cost + stored == pytest.approx(saving.saved, abs=0.006)
    # Of what costs more the band has the sign of the sentence.
    dearer = saving_in_words(replace(saving, saved=-0.06, low=-0.11, high=-0.02))
    assert dearer.startswith("Costs 0.06 more than leaving it alone (90 % band 0.02 to 0.11 more): ")


def test_the_house_left_alone_costs_what_the_model_says(plan, home):
    alone = HomeBySetpoint()
    alone.wait_until(START + pd.Timedelta(days=1))
    cost = sum(price(row["time"]) * row["P"] / 1000.0 / 12.0 for row in alone.rows[len(home.rows) :])
    assert plan.saving.cost_alone == pytest.approx(cost, rel=0.15)


def lived_under_control(days):
    """What `days` of a home cost under planned and under its own set-points, and its temperatures; by `control`."""
    home, alone = HomeBySetpoint(days=14), HomeBySetpoint(days=14)
    first = len(home.rows)
    measured = read_measurements(home.measurements(), RULES, step_s=3600.0).served()
    building = LiveBuilding(home, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, controller(measured, horizon_h=12.0), clock=home, steps=24 * days, delay_s=0.0)
    alone.wait_until(home.at)

    def cost(one):
        return sum(price(row["time"]) * row["P"] / 1000.0 / 12.0 for row in one.rows[first:])

    return cost(home), cost(alone), np.array([row["T"] for row in home.rows[first:]]), home.written


@pytest.mark.slow
def test_a_home_that_only_takes_set_points_is_heated_more_cheaply_and_kept_warm():
    planned_cost, own_cost, T_C, written = lived_under_control(1)
    assert planned_cost < 0.97 * own_cost
    assert T_C.min() > 19.5
    assert all(value is None or 18.0 <= value <= 25.0 for _, value in written)
    assert written[-1][1] is None
    changes = [(at, value) for at, value in written if value is not None]
    kept = [at for k, (at, value) in enumerate(changes) if k == 0 or value != changes[k - 1][1]]
    assert all(later - at >= pd.Timedelta(minutes=30) for at, later in pairwise(kept))


@pytest.mark.slow
def test_what_a_plan_is_compared_with_can_be_said(home):
    """The record is of times under planned commands: the median of its weeks is not what people would set."""
    saving = {usual: planned(home, with_command(usual=usual)).saving for usual in (19.0, 21.5)}
    assert saving[21.5].cost_alone > 1.2 * saving[19.0].cost_alone
    with_column = with_command(usual="own")
    table = home.measurements().assign(own=21.5)
    measured = read_measurements(table, with_column, step_s=3600.0).served()
    assert (learned_commands(measured)["actuator"].usual == 21.5).all()


@pytest.mark.slow
def test_the_guard_commands_the_most_where_a_room_is_far_too_cold(home):
    """Whatever the plan: at a price that nobody pays it would leave the room cold."""
    measured = read_measurements(home.measurements(), with_command(maximum=24.0), step_s=3600.0).served()
    T_zone_C = measured.record.T_zone_C.copy()
    T_zone_C[0, -3:] = [19.5, 18.5, 17.5]
    record = replace(measured.record, T_zone_C=T_zone_C)
    ahead = read_forecast(home.forecast(), measured)
    dear = ahead.at_prices(1e3 * ahead.price_per_kWh)
    plan = controller(measured, guard={"enabled": True}).plan(Observation(record, dear))
    assert {block.command for block in plan.blocks} == {(24.0,)}
    plan = controller(measured, guard={"enabled": False}).plan(Observation(record, dear))
    assert {block.command for block in plan.blocks} != {(24.0,)}
