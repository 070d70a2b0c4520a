"""A long run: controllers are told the latest days of the record, and go on as if they had been told all of it."""

from __future__ import annotations

import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.run_folder import trajectory_frame

OPTIONS = {"step_s": 3600, "horizon_h": 12, "gate": {"enabled": False}}


class Watched(ThermoForceMPC):
    """Remembers how much of the record it was told."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.told_days: list[float] = []

    def plan(self, observation, state=None):
        self.told_days.append((observation.history.time_s[-1] - observation.history.time_s[0]) / DAY_S)
        return super().plan(observation, state)


def ran(record_days: float, free=None, **options):
    config = controller_config("thermoforce_mpc", OPTIONS | options, load_testcase("bestest_hydronic_heat_pump"))
    controller = Watched(simple_model(), config, free_response=free)
    period = Period("long", 10 * DAY_S, 4 * DAY_S, 2 * DAY_S)
    return controller, run_closed_loop(SimpleHouse(), controller, period, record_days=record_days)


@pytest.mark.slow
def test_forgetting_the_oldest_days_changes_nothing_that_does_not_depend_on_them():
    (_, whole), (controller, short) = (ran(days, OutdoorResponse()) for days in (99.0, 3.0))
    assert max(controller.told_days) == pytest.approx(4.0)
    assert min(controller.told_days[60:]) == pytest.approx(3.0, abs=0.05)
    assert trajectory_frame(short.steps).equals(trajectory_frame(whole.steps))
    assert [step.plan.why for step in short.steps] == [step.plan.why for step in whole.steps]
    assert short.kpis["ener_tot"] == whole.kpis["ener_tot"]


@pytest.mark.slow
def test_a_forecaster_that_learns_from_the_record_learns_from_the_latest_days():
    (_, whole), (_, short) = (ran(days, free_response={"name": "linear_weather"}) for days in (99.0, 3.0))
    assert short.fallback_levels()["solved"] == whole.fallback_levels()["solved"] == len(short.steps)
    assert short.kpis["ener_tot"] == pytest.approx(whole.kpis["ener_tot"], rel=0.1)
