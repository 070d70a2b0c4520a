"""Air that comes in through a window explains nothing but itself: no door to a neighbour that is aired as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import random_levels
from thermal_networks import effect_K, simulated, theta_of, transition

from thermoforce_mpc.data import Layout
from thermoforce_mpc.identification.network.airing import without_air
from thermoforce_mpc.identification.network.building import BuildingFit, NetworkInputs, building_fit
from thermoforce_mpc.identification.network.estimate import RoomFit, estimate_room
from thermoforce_mpc.identification.network.free_part import free_part
from thermoforce_mpc.identification.network.room import ROOM, RoomNetwork
from thermoforce_mpc.model.free_response.rc import INPUTS
from thermoforce_mpc.model.operator.heat_input import HeatInput

DAYS, STEP_H, NEIGHBOUR = 5.0, 0.5, len(INPUTS)
METERED = RoomNetwork((1,), (50.0,), neighbours=1)
QUIET = {"disturbance_1h": 0.3, "disturbance_6h": 0.3, "disturbance_48h": 0.3, "room_noise": 0.03, "reading": 0.02}
TRUTH = theta_of(METERED, heat_0=50.0, door_0=0.1, wall_0=0.1, **QUIET)


def lived(jump_K, until_h=9.5):
    """A run of a room whose temperature jumps at 7:30, up to an hour after that of its neighbour fell by 1 to 3 K, and
    in which steps. It is heated for four hours in the morning, at random else.
    """
    levels = random_levels(1000, 3, hold=8)

    def heated(hour, T_C):
        return float(hour % 24 < until_h) if -4.0 <= hour % 24 - until_h < 4.0 else levels[int(hour / STEP_H) % 1000]

    run = simulated(METERED, TRUTH, (heated,), DAYS, 4, STEP_H)
    steps = np.arange(round(7.5 / STEP_H), run.readings.size - 1, round(24.0 / STEP_H))
    theirs, fell_K = steps - np.array([0, 1, 2, 0, 1]), np.array([1.0, 3.0, 2.0, 1.0, 3.0])
    A, _ = transition(METERED, TRUTH, STEP_H)
    readings, inputs, x = run.readings.copy(), run.inputs.copy(), np.zeros(METERED.n_states)
    for k in range(readings.size):
        readings[k] += x[ROOM]
        x = A @ x
        x[ROOM] += jump_K * (k in steps)
        fallen = theirs <= k
        inputs[k, NEIGHBOUR] -= fell_K[fallen] @ np.exp(-(k - theirs[fallen]) * STEP_H)
    return replace(run, inputs=inputs, readings=readings), steps


def test_a_room_that_is_aired_when_its_neighbour_is_has_no_door_to_it():
    run, steps = lived(-1.5)
    taken_for_heat = estimate_room(METERED, [run], most_starts=1)
    fit = without_air(taken_for_heat)
    door = [METERED.value(theta, "door_0") for theta in (taken_for_heat.theta, fit.theta)]
    assert door[0] > 1.5
    assert door[1] < 0.4
    found = set(np.flatnonzero(fit.runs[0].aired_K2))
    assert set(steps) <= found
    assert len(found) <= steps.size + 1
    after_8_h = [effect_K(METERED, theta, 8.0) for theta in (taken_for_heat.theta, fit.theta, TRUTH)]
    assert after_8_h[1] == pytest.approx(after_8_h[2], rel=0.05)


@pytest.mark.parametrize("jump_K", [0.0, 1.5], ids=["none", "warmer"])
def test_what_is_no_outdoor_air_is_left_as_it_is(jump_K):
    fit = estimate_room(METERED, [lived(jump_K)[0]], most_starts=1)
    assert without_air(fit) is fit


def test_pairs_tell_no_direction():
    run, _ = lived(-1.5)
    fit = RoomFit(METERED, TRUTH, 0.0, [replace(run, pair=True)])
    assert without_air(fit) is fit


def test_a_building_is_fitted_without_air_and_expects_it():
    """Forecasts count on air that comes in again, as the mean of the record has it."""
    run, _ = lived(-1.5)
    run = replace(run, inputs=np.delete(run.inputs, NEIGHBOUR, axis=1))
    actuators = NetworkInputs(Layout.single(floor_area_m2=50.0), [HeatInput()], [[]])
    fit = building_fit(actuators, [[run]])
    (room,) = fit.rooms
    assert room.air_K2 == pytest.approx(DAYS * 1.5**2 / run.readings.size, rel=0.4)
    assert room.air_K2 == room.runs[0].aired_K2.mean()
    quiet = BuildingFit(fit.layout, (replace(room, runs=[replace(room.runs[0], aired_K2=None)]),))
    of_step = [free_part(one, 0).process_K2.sum() for one in (fit, quiet)]
    assert of_step[0] - of_step[1] == pytest.approx(room.air_K2)


@pytest.mark.parametrize(("u_min", "aired"), [(0.0, False), (-1.0, True)], ids=["turned off", "kept by its own loops"])
def test_air_is_not_looked_for(u_min, aired):
    run, _ = lived(-1.5)
    run = replace(run, inputs=np.delete(run.inputs, NEIGHBOUR, axis=1))
    layout = Layout.single("both" if u_min else "heating", u_min, 50.0)
    actuators = NetworkInputs(layout, [HeatInput(u_min=u_min)], [[]])
    (room,) = building_fit(actuators, [[run]], aired=aired).rooms
    assert room.runs[0].aired_K2 is None


def test_a_jump_as_an_actuator_ends_is_its_own():
    fit = RoomFit(METERED, TRUTH, 0.0, [lived(-1.5, until_h=7.5)[0]])
    assert without_air(fit) is fit
