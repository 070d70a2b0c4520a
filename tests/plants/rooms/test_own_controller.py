"""A heat pump behind its own controller: hysteresis and minimum times, defrosting, hot water first, SG-Ready."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.rooms import house_of_rooms, physics
from thermoforce_mpc.plants.rooms.device import (
    BLOCKED,
    DEFROST_POWER,
    HYSTERESIS,
    MIN_OFF,
    MIN_ON,
    RECOMMENDED,
    STANDBY,
    TANK_BAND,
    draw_device,
)
from thermoforce_mpc.plants.rooms.house import full_capacity_W

_START = 20 * DAY_S


def lived(contact: int = 2, days: float = 2.0, hours_of_contact: float = 0.0, is_enabled: bool = True):
    """Rows of 30 s of a house in January, its device, and the plant; contacts are set in the last hours."""
    plant = house_of_rooms("house:3rooms:901")
    plant.device = draw_device(plant.house)
    plant.reset(_START, DAY_S)
    plant.advance(None, days * DAY_S - hours_of_contact * HOUR_S)
    if hours_of_contact:
        plant.contact, plant.is_enabled = contact, is_enabled
        plant.advance(None, hours_of_contact * HOUR_S)
    time_s, rows = plant.recorded(_START, _START + days * DAY_S)
    return time_s, rows, plant


@pytest.fixture(scope="module")
def usual():
    return lived()


def runs_of(rows) -> list[tuple[bool, int]]:
    on = rows[:, physics.POWER] > 100.0
    edges = np.flatnonzero(np.diff(on)) + 1
    return [(bool(part[0]), part.size) for part in np.split(on, edges)]


def test_it_keeps_its_minimum_times_and_the_water_near_the_curve(usual):
    _, rows, plant = usual
    parts = runs_of(rows)[1:-1]
    assert sum(on for on, _ in parts) >= 3
    least = {True: plant.device.parameters[MIN_ON], False: plant.device.parameters[MIN_OFF]}
    assert all(n * 30.0 >= least[on] - 30.0 for on, n in parts)
    # Its water swings about what an ideal machine supplies at once.
    ideal = house_of_rooms("house:3rooms:901")
    ideal.reset(_START, DAY_S)
    ideal.advance(None, 2 * DAY_S)
    _, at_once = ideal.recorded(_START, _START + 2 * DAY_S)
    assert np.mean(rows[:, physics.SUPPLY]) == pytest.approx(np.mean(at_once[:, physics.SUPPLY]), abs=3.0)


def test_the_tank_comes_first_and_stays_in_its_band(usual):
    _, rows, plant = usual
    tank = rows[:, physics.TANK]
    target = plant.device.tank_C
    assert target - plant.device.parameters[TANK_BAND] - 4.0 < tank.min()
    assert tank.max() < target + 1.0
    charging = np.diff(tank) > 0.01
    assert 0.02 < charging.mean() < 0.2
    charging_kWh = rows[1:][charging, physics.POWER].sum() * 30.0 / 3.6e6
    used_kWh = plant.house.people * 1.63 * 2
    assert 0.2 * used_kWh < charging_kWh < 0.9 * used_kWh


def test_it_defrosts_in_the_cold(usual):
    _, rows, plant = usual
    pump, h = plant.house.heat_pump, physics.network(plant.house).heat_pump
    most_W = [
        full_capacity_W(pump.capacity_W, pump.capacity_per_K, h[physics.DESIGN_OUT], T)
        for T in rows[:, physics.OUTDOOR]
    ]
    expected = plant.device.parameters[STANDBY] + pump.fixed_W + DEFROST_POWER * np.array(most_W)
    defrosts = np.abs(np.roll(expected, 1) - rows[:, physics.POWER]) < 1.0
    begins = np.flatnonzero(np.diff(defrosts.astype(int)) == 1)
    assert begins.size >= 2
    assert defrosts[begins[0] + 1 : begins[0] + 11].all()
    assert not defrosts[begins[0] + 11]
    falls = [rows[k + 5, physics.SUPPLY] < rows[k, physics.SUPPLY] for k in begins if k + 5 < len(rows)]
    assert np.mean(falls) > 0.5


def test_contacts_block_it_and_raise_the_curve():
    _, rows, _ = lived(contact=BLOCKED, hours_of_contact=2.0)
    assert (rows[-200:, physics.POWER] < 20.0).all()
    _, stopped, _ = lived(hours_of_contact=2.0, is_enabled=False)
    np.testing.assert_array_equal(stopped, rows)
    _, raised, plant = lived(contact=RECOMMENDED, hours_of_contact=3.0)
    _, normal, _ = lived()
    assert raised[-120:, physics.TANK].max() > plant.device.tank_C + 1.0
    assert raised[-360:, physics.POWER].mean() > normal[-360:, physics.POWER].mean()


@pytest.mark.slow
def test_the_same_house_has_the_same_device_and_goes_on_where_it_stood():
    one, other = (draw_device(house_of_rooms("house:3rooms:902").house) for _ in range(2))
    np.testing.assert_array_equal(one.parameters, other.parameters)
    np.testing.assert_array_equal(one.draw_W, other.draw_W)
    _, _, plant = lived(days=1.0)
    there = plant.snapshot()
    again = [plant.advance(None, HOUR_S).power_W[0]]
    plant.restore(there)
    assert plant.advance(None, HOUR_S).power_W[0] == again[0]


def test_the_tank_follows_its_target_and_is_charged_at_once_where_it_is_told():
    _, _, plant = lived(days=0.5)
    plant.tank_target_C = plant.device.tank_C + 6.0
    plant.advance(None, 3 * HOUR_S)
    _, raised = plant.tank_C(_START + 0.5 * DAY_S, _START + 0.5 * DAY_S + 3 * HOUR_S)
    assert raised.max() == pytest.approx(plant.device.tank_C + 6.0, abs=1.0)
    plant.tank_target_C, before = 30.0, float(raised[-1])
    after = plant.advance(None, 2 * HOUR_S).points["T_tank_C"]
    assert after < before
    plant.tank_target_C, plant.charges = before, True
    assert plant.advance(None, HOUR_S).points["T_tank_C"] == pytest.approx(before, abs=1.0)


def test_a_circuit_mixes_the_water_down_to_its_curve():
    """Behind an offset that was just taken back the buffer is still hot: the rooms get water of the curve."""
    plant = house_of_rooms("house:3rooms:901")
    plant.device = draw_device(plant.house)
    plant.reset(_START, DAY_S)
    for offset_K in (6.0, -6.0):
        plant.curve_offset_K = offset_K
        plant.advance(None, 6 * HOUR_S)
    times = _START + HOUR_S * np.array([5.5, 6.0, 6.25])
    before_C, after_C = plant.flow_C(times).T
    _, rows = plant.recorded(times[1], times[2])
    assert (before_C - after_C > 5.0).all()
    assert float(rows[1:, physics.SUPPLY].mean()) > after_C.max() + 1.0


def test_water_is_what_is_set_and_not_what_the_curve_asks_for():
    plant = house_of_rooms("house:3rooms:901")
    plant.device = draw_device(plant.house)
    plant.reset(_START, DAY_S)
    now_s, flow_C = _START, []
    for plant.flow_target_C in (34.0, 38.0):
        plant.advance(None, 3 * HOUR_S, (30.0,) * 3)
        now_s += 3 * HOUR_S
        flow_C.append(plant.flow_C(np.array([now_s - HOUR_S, now_s]))[:, 0])
    band_K = plant.device.parameters[HYSTERESIS]
    np.testing.assert_allclose(flow_C, [[34.0] * 3, [38.0] * 3], atol=band_K)


def test_contacts_without_a_controller_of_its_own_are_refused():
    plant = house_of_rooms("house:3rooms:901")
    plant.is_enabled = False
    with pytest.raises(InputError, match="give it a device"):
        plant.advance(None, HOUR_S)
