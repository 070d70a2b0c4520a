"""What heat costs level by level: on the card, the cheapest, and the power that goes through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.model.machine.load import MachineLoad, Quality, usable_steps
from thermoforce_mpc.model.machine.power import (
    LevelCost,
    PartLoad,
    PowerModel,
    PowerShape,
    at_its_limit,
    cheapest,
    level_costs,
)

LEVELS = np.array([0.2, 0.4, 0.7])


def costs_of(fixed: float, per_u: float, curve: float) -> list[LevelCost]:
    """Of a power with these shares whose heat is the level."""
    return [LevelCost(u, float(fixed / u + per_u + curve * u), 0.0, 1.0, 0.0) for u in LEVELS]


def test_costs_come_back_from_the_numbers_of_a_card_by_level():
    costs = [LevelCost(0.5, 0.9, 0.05, 1.2, 0.1), LevelCost(0.25, 1.3, 0.1, 1.3, 0.2)]
    numbers = {"tau_h": 3.0} | costs[0].numbers() | costs[1].numbers()
    assert level_costs(numbers) == (costs[1], costs[0])
    assert level_costs({"tau_h": 3.0}) == ()


@pytest.mark.parametrize(
    ("costs", "level"), [((), None), ((1.2, 1.1), None), ((1.2, 0.9), 0.4), ((0.8, 0.9), 0.2), ((1.2, 1.015), 0.4)]
)
def test_the_cheapest_level_is_one_below_full_unless_full_is_cheaper(costs, level):
    given = [LevelCost(u, cost, 0.1, 1.0, 0.1) for u, cost in zip(LEVELS, costs, strict=False)]
    best = cheapest(given)
    assert (best and best.level) == level


@pytest.mark.parametrize("shares", [(0.3, 0.7, 0.0), (0.0, 0.6, 0.4), (0.1, 0.5, 0.4), (0.0, 1.0, 0.0)])
def test_the_shape_of_power_is_found_from_what_heat_costs(shares):
    shape = PowerShape.through(costs_of(*shares), LEVELS)
    assert (shape.fixed, shape.per_u, shape.curve) == pytest.approx(shares, abs=1e-6)


def test_no_part_of_the_shape_is_below_zero_and_full_level_stays():
    """Heat that is cheapest in the middle of the levels, as no such shape has it."""
    costs = [LevelCost(u, cost, 0.0, 1.0, 0.0) for u, cost in zip(LEVELS, (1.5, 0.6, 1.4), strict=True)]
    shape = PowerShape.through(costs, LEVELS)
    assert min(shape.fixed, shape.per_u, shape.curve) >= 0.0
    assert shape.fixed + shape.per_u + shape.curve == pytest.approx(1.0)


def test_heat_that_is_not_the_level_is_in_the_shape():
    """At 0.4 a machine gives 0.6 of its heat: at the same cost it draws 0.6 of its power."""
    costs = [LevelCost(0.4, 1.0, 0.0, 1.5, 0.0)]
    shape = PowerShape.through(costs, [0.6])
    assert shape.fixed + 0.4 * shape.per_u + 0.16 * shape.curve == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize("T_out_C", [-5.0, 4.0, 15.0])
def test_a_machines_power_has_the_shape_and_stays_at_full_level_in_all_weather(T_out_C):
    power = PowerModel(MachineLoad((400.0, 5.0, 2600.0, -30.0), (-5.0, 15.0), 0.2))
    shape = PowerShape(0.1, 0.5, 0.4)
    shaped = shape.of(power)
    full_W = float(power(np.array(1.0), T_out_C))
    assert float(shaped(np.array(1.0), T_out_C)) == pytest.approx(full_W)
    lowest_W = min(float(power(np.array(1.0), T)) for T in (-5.0, 15.0))
    assert shaped.load.curve_W == pytest.approx(0.4 * lowest_W)
    fixed_W, per_u_W = shaped.load.parts(T_out_C)
    assert float(fixed_W / per_u_W) == pytest.approx(0.1 / 0.5)


@pytest.mark.parametrize(
    ("powers", "limit"),
    [((), False), ((0.4, 0.7), False), ((0.4, 0.97), True), ((0.75, 0.8), True), ((0.4, 0.75), False)],
)
def test_a_machine_whose_power_hardly_rises_above_a_middle_level_is_at_its_limit(powers, limit):
    """Powers at levels 0.25 and 0.6 over that of full level; a straight line has 0.4 and 0.68."""
    costs = [LevelCost(u, power / u / 1.1, 0.01, 1.1, 0.01) for u, power in zip((0.25, 0.6), powers, strict=False)]
    assert at_its_limit(costs) is limit


def test_power_per_heat_at_a_level_is_that_of_the_parts_that_do_not_go_with_it():
    machine = PartLoad(power_fixed=0.3, heat_fixed=0.1)
    assert machine.at(1.0) == 1.0
    assert machine.at_half == pytest.approx((0.3 + 0.7 * 0.5) / (0.1 + 0.9 * 0.5))
    assert machine.at(0.2) == pytest.approx((0.3 + 0.7 * 0.2) / (0.1 + 0.9 * 0.2))


def test_slopes_of_a_load_that_bends_reach_from_level_0_to_full_level():
    bent = MachineLoad((100.0, 0.0, 500.0, 10.0), (0.0, 10.0), lowest_level=0.5, curve_W=50.0)
    assert bent.slope_bounds() == (600.0, 800.0)  # 100 / 0.5 + 500 + 10 T below; 500 + 10 T + 2 · 50 at full level
    assert replace(bent, coefficients=(0.0, 0.0, 500.0, 10.0)).slope_bounds() == (500.0, 700.0)


def test_the_quality_of_a_fit_counts_errors_while_running_and_their_share_of_the_variance():
    u, load_W = np.tile([0.0, 1.0], 10), np.tile([0.0, 1000.0], 10)
    found = Quality.of(load_W + 50.0 * u, usable_steps(u, np.zeros(20), load_W, "power"))
    assert (found.rmse_W, found.n_samples, found.n_running) == (50.0, 20, 10)
    assert found.r2 == pytest.approx(1.0 - 0.5 * 50.0**2 / 500.0**2)
