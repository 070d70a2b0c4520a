"""What heat costs level by level: on the card, the cheapest, and the power that goes through it."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import LevelCost, PowerModel, PowerShape, cheapest, level_costs

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
