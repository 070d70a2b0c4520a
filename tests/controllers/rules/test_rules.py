from __future__ import annotations

import numpy as np
import pytest
from simple_house import SimpleHouse

from controllers.checks import ControllerConfigError
from controllers.mpc.acting import NoModelController
from controllers.mpc.config import MPCConfig
from controllers.rules.native import NativeController
from controllers.rules.thermostat import Setback, Thermostat, ThermostatConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Layout, Names, Observation, Record


def observation(T: float, time_s: float = 0.0) -> Observation:
    history = Record([time_s], [T], [0.0], [0.0], [], [], [])
    line = np.ones(2)
    return Observation(
        history, Boundary(time_s + np.array([0, 900.0]), 0 * line, 0 * line, line, 21 * line, 24 * line, line, line)
    )


def levels(thermostat: Thermostat, temperatures: list[float]) -> list[float | None]:
    found, state = [], None
    for T in temperatures:
        plan = thermostat.plan(observation(T), state)
        state = plan.state
        found.append(plan.blocks[0].u[0])
    return found


def test_hysteresis_keeps_its_state_inside_the_dead_band():
    assert levels(Thermostat(), [21.15, 21.3, 21.39, 21.41, 21.3, 21.21, 21.19]) == [1, 1, 1, 0, 0, 0, 1]


def test_a_machine_stays_on_and_off_for_its_shortest_times():
    thermostat, state, found = Thermostat(ThermostatConfig(step_s=300.0, min_on_s=600.0, min_off_s=900.0)), None, []
    for k, T in enumerate([21.3, 21.0, 21.5, 21.5, 21.0, 21.0, 21.0, 21.5]):
        plan = thermostat.plan(observation(T, 300.0 * k), state)
        state = plan.state
        found.append(plan.blocks[0].u[0])
        if k == 2:
            assert plan.why.endswith("off; stays on for 600 s")
    assert found == [0, 1, 1, 0, 0, 0, 1, 1], "the first switch is long after the last before"


def test_cooling_acts_on_the_other_side():
    config = ThermostatConfig(mode="cooling", setpoint_C=24.0)
    assert levels(Thermostat(config), [24.2, 24.0, 23.8, 24.05]) == [1, 1, 0, 0]


def test_loops_that_heat_and_cool_keep_both_set_points_whatever_is_measured():
    names = Names(("office", "hall"), ("office_unit", "hall_unit"), ("a", "b"))
    layout = Layout(names, (1, 1), (0, 1), (0, 1), (-0.5, 0.0), (0.0, 0.0), (50.0, 50.0))
    thermostat = Thermostat(ThermostatConfig(setpoints_C={"office_unit": 20.0}, cooling_setpoint_C=25.0), layout)
    for T_C in (18.0, 30.0, float("nan")):
        line = np.ones(2)
        zones = np.array([[T_C], [20.0]])
        history = Record([0.0], zones, [0.0], [0.0], np.empty((2, 0)), np.empty((2, 0)), np.empty((2, 0)), names=names)
        ahead = [21 * np.ones((2, 2)), 24 * np.ones((2, 2)), np.ones((2, 2)), np.ones((2, 2))]
        seen = Observation(history, Boundary([0, 900.0], 0 * line, 0 * line, np.ones((2, 2)), *ahead, names=names))
        (block,) = thermostat.plan(seen).blocks
        assert (block.u, block.command) == ((0.0, 1.0), ((20.0, 25.0), None))


def test_options_of_an_actuator_that_there_is_not_are_refused():
    says = "there is no actuator 'livingroom'; the building has actuator"
    with pytest.raises(ControllerConfigError, match=f"setpoints_C: {says}"):
        Thermostat(ThermostatConfig(setpoints_C={"livingroom": 19.0}))
    with pytest.raises(ControllerConfigError, match=f"actuations: {says}"):
        NoModelController("", MPCConfig(actuations={"livingroom": {}}), Layout.single("heating"), 900.0, name="")


def test_a_silent_sensor_hands_over_to_native_control():
    plan = Thermostat().plan(observation(float("nan")))
    assert plan.blocks[0].u == (None,)
    assert "missing" in plan.why


@pytest.mark.parametrize(
    ("day", "hour", "active"), [(0, 6.4, False), (0, 6.5, True), (0, 14.9, True), (0, 15, False), (4, 10, False)]
)
def test_setback_runs_on_weekdays_only(day, hour, active):
    setback = Setback(from_hour=6.5, to_hour=15)
    assert setback.active(day * DAY_S + hour * HOUR_S) is active


def test_setback_past_midnight():
    setback = Setback(from_hour=22, to_hour=5)
    assert [setback.active(h * HOUR_S) for h in (21, 23, 4, 6)] == [False, True, True, False]


def test_setback_keeps_the_machine_off_in_a_cold_zone():
    config = ThermostatConfig(setback=Setback(from_hour=0, to_hour=24, weekend_days=()))
    assert Thermostat(config).plan(observation(10.0)).blocks[0].u == (0.0,)


def test_native_overwrites_nothing():
    house = SimpleHouse()
    house.reset(0, 0)
    plan = NativeController().plan(Observation(house.past(HOUR_S), house.forecast(HOUR_S, HOUR_S)))
    assert [b.u for b in plan.blocks] == [(None,)]
