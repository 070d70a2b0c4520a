"""Zone sensors that are silent, stuck, out of range or moved, and those that only look so."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse, draught_K
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import TWO, TwoHouses, two_model

from controllers import ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.monitoring.zone_sensors import SensorConfig
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, Boundary, FreeForecast, Observation, PlanStatus, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop

FROM_H = 20


class Exact(OutdoorResponse):
    """The exact free response; where the last readings are not known, from the last one that is."""

    def forecast(self, free_C, history: Record, boundary: Boundary) -> FreeForecast:
        known = np.flatnonzero(np.isfinite(free_C))
        T = float(free_C[known[-1]])
        for T_out in history.T_out_C[known[-1] : -1]:
            T = 0.99 * T + 0.01 * T_out
        return super().forecast(np.array([T]), history, boundary)


def sensor(shows=None, hours: float = 6.0, opens: float = 0.0, resolution_K: float = 0.0) -> FaultyHouse:
    """A house whose sensor says `shows(T, reading before)` for some hours from hour 20 of the run.

    `opens`: a window that opens meanwhile, in shares of the distance to outdoors an hour.
    """
    last_C = [np.nan]

    def faulty(house) -> bool:
        return FROM_H < house.hours <= FROM_H + hours

    def shown(house, seen):
        T = house.T
        if resolution_K:
            T = round(T / resolution_K) * resolution_K
        last_C[0] = shows(T, last_C[0]) if shows and faulty(house) else T
        return replace(seen, T_zone_C=last_C[0])

    return FaultyHouse(shown, moves=lambda house, hours: draught_K(house, opens, hours) if faulty(house) else 0.0)


def run(house: SimpleHouse, days: float = 2.0, **options) -> RunResult:
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0, **options), free_response=Exact())
    return run_closed_loop(house, mpc, replace(house.period("x"), scored_s=days * DAY_S))


@functools.cache
def healthy_run() -> RunResult:
    return run(sensor())


def statuses(result: RunResult) -> list[PlanStatus]:
    return [step.plan.status for step in result.steps]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shows", "says"),
    [
        (lambda T, last: np.nan, "was not measured"),
        (lambda T, last: -273.15, "was not measured"),
        (lambda T, last: 0.0, "came back at 0.00 °C"),
        (lambda T, last: 850.0, "was not measured"),
        (lambda T, last: T + 2.0, "jumped to"),
        (lambda T, last: T - 2.0, "jumped to"),
    ],
    ids=["silent", "0 K", "0 °C", "850 °C", "2 K up", "2 K down"],
)
def test_for_hours_the_model_stands_in_and_nobody_feels_it(shows, says):
    healthy, result = healthy_run(), run(sensor(shows, hours=5.0))
    assert set(statuses(healthy)) == {PlanStatus.SOLVED}
    assert statuses(result)[FROM_H + 1 : FROM_H + 6] == [PlanStatus.BRIDGED] * 5
    assert set(statuses(result)[: FROM_H + 1] + statuses(result)[FROM_H + 7 :]) == {PlanStatus.SOLVED}
    assert says in result.steps[FROM_H + 2].plan.why
    assert "the model stands in" in result.steps[FROM_H + 2].plan.why
    assert any("readings are believed again" in step.plan.why for step in result.steps[FROM_H + 6 :])
    assert result.kpis["tdis_tot"] < healthy.kpis["tdis_tot"] + 0.3
    assert result.kpis["cost_tot"] == pytest.approx(healthy.kpis["cost_tot"], rel=0.03)


@pytest.mark.slow
def test_after_its_time_the_building_is_left_to_its_own_control_until_the_sensor_is_back():
    result = run(sensor(lambda T, last: np.nan, hours=12.0))
    found = statuses(result)
    assert found[FROM_H + 1 : FROM_H + 7] == [PlanStatus.BRIDGED] * 6
    assert found[FROM_H + 7 : FROM_H + 13] == [PlanStatus.NATIVE] * 6
    assert set(found[FROM_H + 14 :]) == {PlanStatus.SOLVED}
    assert "the last reading believed is 7 h old: native control" in result.steps[FROM_H + 7].plan.why
    assert all(sample.u_applied == (None,) for sample in result.steps[FROM_H + 8].samples)


@pytest.mark.slow
def test_a_rule_acts_on_the_models_temperature_where_native_control_is_not_wanted(monkeypatch):
    monkeypatch.setattr(SensorConfig, "bridge_h", 1.0)
    result = run(sensor(lambda T, last: np.nan, hours=8.0), fallback={"stand_back": "rule"})
    held = result.steps[FROM_H + 3 : FROM_H + 8]
    assert {step.plan.status for step in held} == {PlanStatus.THERMOSTAT}
    assert all("°C against" in step.plan.why for step in held)
    assert result.kpis["tdis_tot"] < 0.5


@pytest.mark.slow
def test_a_stuck_sensor_is_found_and_its_readings_since_are_not_believed():
    result = run(sensor(lambda T, last: last, hours=200.0), days=3.0)
    found = statuses(result)
    first = next(i for i, status in enumerate(found) if status is not PlanStatus.SOLVED)
    assert FROM_H < first <= FROM_H + 6
    assert "in which the model moved away" in result.steps[first].plan.why
    assert found[-1] is PlanStatus.NATIVE
    believed = run(sensor(lambda T, last: last, hours=200.0), days=3.0, sensor={"enabled": False})
    assert result.kpis["tdis_tot"] < 0.5 * believed.kpis["tdis_tot"]


def begun(shown, hours: int):
    """What a fresh process plans: four days of the thermostat and `hours` without heat, of which `shown` are read."""
    house = SimpleHouse()
    house.reset(10 * DAY_S, 4 * DAY_S)
    before = house.past(3600.0)
    history = before.extended(*(house.advance(0.0, 3600.0) for _ in range(hours)))
    read = replace(history, T_zone_C=shown(history.T_zone_C, before.T_zone_C[0, -1]))
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=Exact())
    return mpc.plan(Observation(read, house.forecast(24 * 3600.0, 3600.0)))


@pytest.mark.parametrize(("hours", "status"), [(4, PlanStatus.BRIDGED), (20, PlanStatus.NATIVE)])
def test_a_run_that_begins_with_a_stuck_sensor_finds_it_in_the_record(hours, status):
    plan = begun(lambda T, last: np.append(T[:, :-hours], np.full((1, hours), last), axis=1), hours)
    assert plan.status is status
    assert f"for {hours} h, in which the model moved away" in plan.why


def test_a_run_that_begins_with_a_sensor_that_repeats_itself_believes_it():
    """A coarse one that moves, and one that stays as the thermostat keeps the room, up to an hour of it."""
    for shown in (lambda T, last: np.round(2.0 * T) / 2.0, lambda T, last: np.append(T[:, :-1], T[:, -2:-1], axis=1)):
        assert begun(shown, 4).status is PlanStatus.SOLVED


@pytest.mark.slow
@pytest.mark.parametrize("resolution_K", [0.1, 0.5])
def test_a_coarse_sensor_that_repeats_itself_is_not_stuck(resolution_K):
    result = run(sensor(resolution_K=resolution_K), days=3.0)
    assert set(statuses(result)) <= {PlanStatus.SOLVED, PlanStatus.WATCH}
    assert not any("has been" in step.plan.why for step in result.steps)


def test_a_window_that_is_opened_is_the_zone_and_not_the_sensor():
    result = run(sensor(hours=8.0, opens=0.25), watch={"enabled": False})
    told = statuses(result)[FROM_H + 1 : FROM_H + 9]
    assert told.count(PlanStatus.BRIDGED) <= 2
    assert PlanStatus.NATIVE not in told
    levels = [step.plan.u[0, 0] for step in result.steps[FROM_H + 4 : FROM_H + 8]]
    assert min(levels) > 0.9, "it is heated against"


def test_a_sensor_that_was_moved_for_good_is_believed_again_after_a_day():
    result = run(sensor(lambda T, last: T + 2.0, hours=200.0), days=2.5, watch={"enabled": False})
    found = statuses(result)
    assert found[FROM_H + 1 : FROM_H + 24].count(PlanStatus.SOLVED) == 0
    assert set(found[FROM_H + 27 :]) == {PlanStatus.SOLVED}


@pytest.mark.slow
@pytest.mark.parametrize("silent", [True, False])
def test_a_sensor_is_the_business_of_its_own_zone_and_its_options_are_its_own(silent):
    fault = (lambda T, last: np.nan) if silent else (lambda T, last: 40.0)
    houses = TwoHouses(first=sensor(fault, hours=10.0))
    options = {} if silent else {"sensor": {"enabled": False}, "sensors": {TWO.zones[0]: {}}}
    config = MPCConfig(step_s=None, horizon_h=24.0, **options)
    mpc = ThermoForceMPC(two_model(), config, free_response=Exact())
    result = run_closed_loop(houses, mpc, SimpleHouse().period("x"))
    acting = [step.plan.acting for step in result.steps]
    assert [one[0] for one in acting[FROM_H + 7 : FROM_H + 11]] == [PlanStatus.NATIVE] * 4
    assert {one[1] for one in acting} <= {PlanStatus.SOLVED, PlanStatus.BRIDGED}
    hall = [step.T_zone_C[1] - step.lower_C[1] for step in result.samples[24:]]
    assert min(hall) > -0.3


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"sensors": {"attic": {}}}, "there is no zone 'attic'; the building has zone"),
        ({"actuations": {"boilr": {}}}, "actuations: there is no actuator 'boilr'; the building has actuator"),
        ({"sensor": {"lowest_C": 10.0}}, "lowest_C is no option any more"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, says):
    with pytest.raises((ControllerConfigError, ConfigError, ValueError), match=says):
        run(SimpleHouse(), **options)
