"""Power that rises with the warmth of the water, which follows the level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machine_history import machine_history

from thermoforce_mpc.identification.effects.level_laws import part_load_costs
from thermoforce_mpc.model.machine.power import PowerModel, PowerShape, fit_power, warmth
from thermoforce_mpc.model.operator.heat_input import IDENTITY

HOUR = 3600.0


def held_levels(n: int = 500) -> np.ndarray:
    """Off, full or a part level for one to eight steps of 15 min."""
    rng = np.random.default_rng(3)
    return np.repeat(rng.choice([0.0, 0.0, 0.25, 0.5, 1.0, 1.0], n), rng.integers(1, 9, n))[:n]


def heat_pump(fixed_W: float, water_s: float, noise_W: float = 5.0, water_W: float = 700.0) -> PowerModel:
    """What is fitted to a pump that takes `fixed_W` while on, 1500 W per level and `water_W` more in warm water."""
    return fit_power([record_of(fixed_W, water_s, noise_W, water_W)])


def record_of(fixed_W, water_s, noise_W=5.0, water_W=700.0):
    rng, u = np.random.default_rng(4), held_levels()
    T = rng.uniform(-5.0, 8.0, u.size)
    power = (u > 0) * fixed_W + u * (1500.0 + water_W * warmth(u, 900.0, water_s)) + noise_W * rng.normal(size=u.size)
    return machine_history(u, T, power_W=power)


def test_warmth_follows_the_level():
    np.testing.assert_allclose(warmth(np.full(8, 0.4), 900.0, HOUR), 0.4)
    u = np.r_[np.zeros(400), np.ones(8)]
    after = warmth(u, 900.0, HOUR)[400:]
    ends = 1.0 - np.exp(-np.arange(9) / 4.0)
    np.testing.assert_allclose(after, 0.5 * (ends[:-1] + ends[1:]), atol=1e-9)


@pytest.mark.parametrize("fixed_W", [0.0, 400.0])
def test_a_fixed_loss_and_warm_water_are_told_apart(fixed_W):
    power = heat_pump(fixed_W, HOUR)
    assert power.water_s == HOUR
    assert power.load.curve_W == pytest.approx(700.0, rel=0.03)
    assert float(power.parts(2.0)[0]) == pytest.approx(fixed_W, abs=15.0)
    # A share of time that stays has water of that warmth.
    assert float(power(np.array(0.5), 2.0)) == pytest.approx(fixed_W + 0.5 * 1500.0 + 0.25 * 700.0, rel=0.02)


@pytest.mark.parametrize(
    ("water_s", "noise_W", "water_W"), [(8 * HOUR, 5.0, 700.0), (HOUR, 300.0, 700.0), (HOUR, 5.0, 0.0)]
)
def test_what_a_floor_or_noise_does_is_not_taken_for_it(water_s, noise_W, water_W):
    power = heat_pump(400.0, water_s, noise_W, water_W)
    assert power.water_s is None
    assert power.load.curve_W == 0.0


@pytest.mark.parametrize(("fixed_W", "cost"), [(0.0, 1.0), (400.0, (800.0 + 1850.0) / (400.0 + 1850.0))])
def test_levels_are_compared_in_the_same_water(fixed_W, cost):
    """A trial at half level has cooler water than one at full level; in operation both give the same heat."""
    record = record_of(fixed_W, HOUR)
    power = fit_power([record])
    found = {"heat_at_middle_level": (0.0, 0.01)}
    (half,) = part_load_costs(found, [record], power, IDENTITY)
    assert half.cost == pytest.approx(cost, rel=0.02)
    (unseen,) = part_load_costs(found, [record], replace(power, water_s=None), IDENTITY)
    assert unseen.cost < cost - 0.03


@pytest.mark.parametrize("shares", [(0.0, 1.0, 0.0), (0.2, 0.6, 0.2)])
def test_warm_water_is_added_to_the_shape_of_the_levels(shares):
    power = heat_pump(200.0, HOUR)
    shaped, u = PowerShape(*shares).of(power), np.array([0.3, 0.5, 1.0])
    same_water_W = 2050.0 * (shares[0] + shares[1] * u + shares[2] * u**2)
    np.testing.assert_allclose(shaped(u, 2.0), same_water_W + 700.0 * u * (u - 0.5), rtol=0.02)
