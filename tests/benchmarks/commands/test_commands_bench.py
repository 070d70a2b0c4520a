"""`bench commands`: what days saved against the house left alone."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.commands.bench import ROOMS, Home, Lived, came_true, priced
from thermoforce_mpc.data import DAY_S, HOUR_S, HeldCommand, Plan, PlanStatus


def test_heat_that_is_missing_in_the_house_counts_at_its_mean_cost():
    own = Lived(cost=10.0, energy_kWh=40.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=100.0, stored_kWh=50.0)
    warmer = Lived(cost=11.0, energy_kWh=44.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=110.0, stored_kWh=60.0)
    colder = Lived(cost=9.0, energy_kWh=36.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=90.0, stored_kWh=45.0)
    assert own.saved_by(warmer) == pytest.approx(-0.1)
    assert own.saved_by(colder) == pytest.approx(0.05)


def test_what_a_plan_saves_is_lived_through_without_moving_the_house():
    home = Home(17, "set-points")
    home.plant.reset(36 * DAY_S, DAY_S)
    ahead = priced(home.plant.forecast(24 * HOUR_S, HOUR_S))
    begin_s, end_s = float(ahead.time_s[0]), float(ahead.time_s[-1])

    def by(value):
        return Plan((), PlanStatus.SOLVED, "", settings=((HeldCommand(begin_s, end_s, value),),) * ROOMS)

    saved, cost = came_true(home, by(None), ahead)
    assert saved == 0.0
    assert cost > 0.0
    cooler, again = came_true(home, by(float(home.usual(np.array([begin_s])).min() - 2.0)), ahead)
    assert again == cost
    assert 0.02 * cost < cooler < cost
