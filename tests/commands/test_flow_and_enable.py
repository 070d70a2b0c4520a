"""A flow temperature and an enable contact: learned from an ordinary record, and planned."""

from __future__ import annotations

import copy

import numpy as np
import pandas as pd
import pytest
from home_by_curve import ENABLE_RULES, FLOW_RULES, ROOMS, HomeByCurve, curve_C, curve_model

from controllers.mpc.commands.costs import meters_of
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.data import Observation
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements

OPTIONS = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}}
CONFIG = MPCConfig.model_validate(OPTIONS | {"gate": {"enabled": False}, "watch": {"enabled": False}})
RULES_OF = {"flow_temperature": FLOW_RULES, "enable": ENABLE_RULES}


def told_by(home, kind):
    """What was measured, and the commands that it tells."""
    measured = read_measurements(home.measurements(), RULES_OF[kind], step_s=3600.0).served()
    return measured, learned_commands(measured)


@pytest.fixture(scope="module", params=RULES_OF)
def house(request):
    """Kind, home, what was measured, and the commands that it tells."""
    home = HomeByCurve(days=14, set_by=request.param, swing_K=2.0)
    return request.param, home, *told_by(home, request.param)


def test_what_it_does_is_learned_for_each_room(house):
    kind, _, _, learned = house
    assert set(learned) == set(ROOMS)
    for one in learned.values():
        assert (one.machine, one.untold) == ("heat_pump", "")
        level = {value: float(one.loop.level(value, 20.0, 3.0, 0.5)) for value in (0.0, 1.0, 34.0, 40.0)}
        if kind == "enable":
            assert level[0.0] < 0.02
            assert level[1.0] > 0.5
            assert (one.usual == 1.0).all()
        else:  # a valve that is open, and water 14 and 20 K above the room
            assert level[34.0] / level[40.0] == pytest.approx(14.0 / 20.0, abs=0.05)
            usual = one.usual_at(np.zeros(3), np.array([-5.0, 0.0, 5.0]))
            np.testing.assert_allclose(usual, [curve_C(T) for T in (-5.0, 0.0, 5.0)], atol=1.0)


def test_a_plan_saves_and_is_what_may_be_set(house):
    kind, home, measured, learned = house
    mpc = ThermoForceMPC(curve_model(home), CONFIG, commands=learned)
    plan = mpc.plan(Observation(measured.record, read_forecast(home.forecast(), measured)))
    living, bedroom = plan.settings
    assert living == bedroom
    values = {one.value for one in living}
    if kind == "enable":
        assert values == {0.0, 1.0}
        assert all(one.end_s - one.start_s >= 1800.0 for one in living[1:-1])
    else:
        out = home.out_C(home.forecast().index)
        assert min(values) >= curve_C(float(out.max())) - 6.0
        assert max(values) <= curve_C(float(out.min())) + 6.0
    assert plan.saving.saved > 0.0
    assert plan.saving.outside_Kh <= plan.saving.outside_alone_Kh + 0.5
    assert plan.saving.cost_alone == pytest.approx(_cost(home), rel=0.2)


def test_a_machine_that_is_off_for_half_an_hour_takes_what_its_heat_in_the_other_half_takes():
    """The levels of such an hour are half of others already: their power was halved again."""
    home = HomeByCurve(days=14, set_by="enable")
    measured, learned = told_by(home, "enable")
    mpc = ThermoForceMPC(curve_model(home), CONFIG, commands=learned)
    plan = mpc.plan(Observation(measured.record, read_forecast(home.forecast(), measured)))
    assert any(one.value == 0.0 for one in plan.settings[0])
    told = plan.saving.cost_alone - plan.saving.cost
    assert told == pytest.approx(_cost(home) - _cost(home, plan.settings[0]), rel=0.3)


def test_on_a_meter_of_days_that_are_alike_hours_and_weather_are_not_told_apart():
    """They were told as kilowatts that cancel, and plans counted those of the hours alone."""
    home = HomeByCurve(days=7, set_by="enable")
    _, learned = told_by(home, "enable")
    (meter,) = meters_of(curve_model(home), learned.values()).values()
    assert np.ptp(meter.base_W) < 400.0


def _cost(home, settings=()):
    """What the next day costs under commands, or left alone."""
    lived, n, begin = copy.deepcopy(home), len(home.rows), home.now()
    for one in settings:
        lived.told = one.value
        lived.wait_until(begin + pd.Timedelta(seconds=one.end_s - settings[0].start_s))
    lived.wait_until(begin + pd.Timedelta("24h"))
    return sum(row["P"] * row["price"] for row in lived.rows[n:]) / 12000.0
