"""Rooms that others keep warm are excited too, and what a shared machine can."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.rooms import house_of_rooms

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def record():
    plant = house_of_rooms("house:5rooms")
    return probe(plant, plant.period("cold_week").start_s, 2.0, seed=1, layout=plant.layout)


def test_every_valve_is_opened_often_enough_to_be_told(record):
    opened = (record.u > 0.0).mean(axis=1)
    assert (opened > 0.1).all(), dict(zip(record.names.actuators, opened.round(3), strict=True))


def test_warm_rooms_are_not_overheated_by_it(record):
    upper = house_of_rooms("house:5rooms").forecast(DAY_S, 900.0).upper_C.max()
    assert record.T_zone_C.max() < upper + 0.5


def test_a_machines_capacity_and_power_are_those_of_the_record(record):
    layout = house_of_rooms("house:5rooms").layout
    config = IdentificationConfig(modulation="linear", order=3, sun_on_sensor=False, cross_effects=False)
    model = identify([record], layout=layout, config=config)
    most_W = record.heat_W.sum(axis=0).max()
    heat = [model.operator.of_actuator(a).heat_input for a in range(5)]
    full_W = sum(float(h(np.asarray(1.0), np.asarray(record.T_out_C.mean()))) * h.reference_W for h in heat)
    assert sum(model.shares) == pytest.approx(full_W / most_W, rel=0.05)
    assert sum(model.shares) > 1.1, "all valves together ask for more than the heat pump has"
    (power,) = model.power
    # It cycles below its lowest level; the rooms differ in how much warmer water they make it give.
    lowest = house_of_rooms("house:5rooms").house.heat_pump.lowest_level
    assert power.load.lowest_level == pytest.approx(lowest, abs=0.1)
    assert power.r2 > 0.98
