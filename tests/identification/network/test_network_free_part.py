"""The free part of a zone is that of its building's network: its weather response and what disturbs it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from thermal_networks import AREA_M2, LAYOUT, ROOMS, KnownFit, random_theta, simulated, theta_of

from thermoforce_mpc.data import Layout
from thermoforce_mpc.identification.network.building import BuildingFit
from thermoforce_mpc.identification.network.estimate import RoomFit
from thermoforce_mpc.identification.network.free_part import free_part
from thermoforce_mpc.identification.network.room import ROOM, STRUCTURE, RoomNetwork
from thermoforce_mpc.model.free_response.rc import INPUTS

STEP_H = 0.25
WALL_W_K, DOOR_W_K = 12.0, 9.0


def building(seed):
    """Two rooms, known but for their runs, with a wall and a door of which each has its share per m² of its floor."""
    rng, fits = np.random.default_rng(seed), []
    for room, area in zip(ROOMS, AREA_M2, strict=True):
        theta = random_theta(room, rng, 0.4)
        theta[[room.place["wall_0"], room.place["door_0"]]] = np.log(np.array([WALL_W_K, DOOR_W_K]) / area)
        run = simulated(room, theta, (lambda hour, T: 0.0,) * len(room.signs), 0.5, seed)
        fits.append(KnownFit(room, theta, 1e-9, [run]))
    return BuildingFit(LAYOUT, tuple(fits))


def joined(fits):
    """A (n, n) and B (n, 8) of a step of both rooms' equations, each other's air in the place of the input to their
    own, each other's structure in that of the input to their structure; and where the rooms begin.
    """
    sizes = [fit.room.n_states for fit in fits]
    begins, matrix = [0, sizes[0]], np.zeros((sum(sizes) + len(INPUTS),) * 2)
    for z, fit in enumerate(fits):
        own, here = fit.room.equations(fit.theta).matrix, slice(begins[z], begins[z] + sizes[z])
        matrix[here, here], matrix[here, -len(INPUTS) :] = own[:, : sizes[z]], own[:, sizes[z] : sizes[z] + len(INPUTS)]
        for node in (ROOM, STRUCTURE):
            matrix[begins[z] + node, begins[1 - z] + node] = own[node, sizes[z] + len(INPUTS)]
    whole, n = expm(STEP_H * matrix), sum(sizes)
    return whole[:n, :n], whole[:n, n:], begins


@pytest.mark.parametrize("zone", [0, 1])
def test_weather_and_disturbances_do_what_they_do_to_the_network(zone):
    rng = np.random.default_rng(zone)
    for seed in range(3):
        fit = building(seed)
        free, (A, B, begins) = free_part(fit, zone), joined(fit.rooms)
        x, z, P, found = np.zeros(len(A)), np.zeros(free.order), np.zeros(A.shape), free.start_K2
        Q = np.concatenate([one.room.noise(one.theta, STEP_H)[0] for one in fit.rooms])
        for one, begin in zip(fit.rooms, begins, strict=True):
            nodes, stationary = one.room.disturbances.start, one.room.noise(one.theta, STEP_H)[1]
            own = np.diag([1.0, 4.0, 25.0, *[25.0] * (nodes - 3), *stationary])
            P[begin : begin + len(own), begin : begin + len(own)] = own
        node = np.concatenate([np.arange(one.room.n_states) < one.room.disturbances.start for one in fit.rooms])
        P += 400.0 * np.outer(node, node)
        for _ in range(200):
            weather = rng.normal(size=len(INPUTS))
            np.testing.assert_allclose(found.sum(), P[begins[zone], begins[zone]], rtol=1e-4)
            x, z = A @ x + B @ weather, free.poles * z + free.weights @ weather
            np.testing.assert_allclose(z.sum(), x[begins[zone]], rtol=1e-3, atol=5e-5)
            P, found = A @ P @ A.T + np.diag(Q), np.outer(free.poles, free.poles) * found + free.process_K2
        assert free.sensor_sd_K**2 == pytest.approx(fit.rooms[zone].reading_K2(fit.thetas[zone]))


def test_a_time_constant_of_a_disturbance_may_be_one_of_the_room():
    """An emitter of an hour that heats nothing but itself has the rate of the first disturbance."""
    room = RoomNetwork()
    theta = theta_of(room, C_emitter_0=6.0, H_emitter_0=6.0, C_room=1e9)
    run = simulated(room, theta, (lambda hour, T: 0.0,), 0.5, 1)
    fit = BuildingFit(Layout.single(floor_area_m2=100.0), (RoomFit(room, theta, 0.0, [run]),))
    free = free_part(fit, 0)
    assert np.isfinite(free.process_K2).all()
    assert free.start_K2.sum() == pytest.approx(401.0, rel=1e-3)


def test_pairs_alone_say_nothing_of_it():
    fit = building(0)
    paired = [replace(run, pair=True) for run in fit.rooms[0].runs]
    bath = KnownFit(fit.rooms[0].room, fit.rooms[0].theta, 1e-9, paired)
    assert free_part(replace(fit, rooms=(bath, fit.rooms[1])), 0) is None
