"""Rooms of a building together: one conductance, one prior, and what a room had taken for it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from thermal_networks import AREA_M2, ROOMS, KnownFit

from thermoforce_mpc.identification.network.estimate import RoomFit
from thermoforce_mpc.identification.network.joint import JointPosterior

DOORS = tuple(room.place["door_0"] for room in ROOMS)


class FlatBelow(KnownFit):
    """A room that knows its door, and not its logarithm, to a share: half as much costs little, twice much."""

    share = 0.7

    def posterior(self, theta):
        value, slope = super().posterior(theta)
        times = np.exp(theta[DOORS[0]] - self.theta[DOORS[0]])
        slope[DOORS[0]] += (times - 1.0) * times / self.share**2
        return value + 0.5 * ((times - 1.0) / self.share) ** 2, slope


def joint_of(*fits):
    return JointPosterior(fits, np.array(AREA_M2))


def doors_W_K(joint):
    """The door, W/K, by each room."""
    thetas = joint.thetas(joint.free)
    return [area * np.exp(theta[door]) for area, theta, door in zip(AREA_M2, thetas, DOORS, strict=True)]


def test_what_nothing_tells_has_one_prior_between_those_of_its_rooms():
    joint = joint_of(*(RoomFit(room, room.mean, 0.0, ()) for room in ROOMS))
    medians = [area * room.priors["door_0"].median for area, room in zip(AREA_M2, ROOMS, strict=True)]
    assert doors_W_K(joint) == pytest.approx([np.sqrt(medians[0] * medians[1])] * 2, rel=1e-3)
    for sds, room, door in zip(joint.sds, ROOMS, DOORS, strict=True):
        assert sds[door] == pytest.approx(room.sd[door], rel=1e-3)
        assert sds[room.place["C_room"]] == pytest.approx(room.sd[room.place["C_room"]], rel=1e-3)


def test_what_a_room_took_for_a_door_goes_with_it():
    """A room does not tell its door from its emitter's heat; another one knows the door."""
    heat, covariance = ROOMS[0].place["heat_0"], 1e-6 * np.eye(ROOMS[0].mean.size)
    covariance[heat, DOORS[0]] = covariance[DOORS[0], heat] = -0.9e-6
    unsure, sure = KnownFit(ROOMS[0], ROOMS[0].mean, covariance), KnownFit(ROOMS[1], ROOMS[1].mean, 1e-12)
    joint = joint_of(unsure, sure)
    there_W_K = AREA_M2[1] * ROOMS[1].priors["door_0"].median
    assert doors_W_K(joint) == pytest.approx([there_W_K] * 2, rel=1e-4)
    more = np.log(there_W_K / AREA_M2[0] / ROOMS[0].priors["door_0"].median)
    assert joint.thetas(joint.free)[0][heat] == pytest.approx(ROOMS[0].mean[heat] - 0.9 * more, rel=1e-4)
    assert joint.sds[0][heat] == pytest.approx(1e-3 * np.sqrt(1.0 - 0.9**2), rel=1e-2)


def test_it_is_the_largest_posterior_and_not_that_of_the_curvatures():
    """Where a logarithm is known far less to one side than to the other."""
    thetas = [room.mean.copy() for room in ROOMS]
    for theta, door, area, W_K in zip(thetas, DOORS, AREA_M2, (5.0, 40.0), strict=True):
        theta[door] = np.log(W_K / area)
    fits = FlatBelow(ROOMS[0], thetas[0], 1e2), KnownFit(ROOMS[1], thetas[1], 0.25)

    def value(log_W_K):
        away = [log_W_K - np.log(area) for area in AREA_M2]
        times = np.exp(away[0] - thetas[0][DOORS[0]])
        told = (times - 1.0) ** 2 / FlatBelow.share**2 + (away[0] - thetas[0][DOORS[0]]) ** 2 / 1e2
        told += (away[1] - thetas[1][DOORS[1]]) ** 2 / 0.25
        return told - 0.5 * sum((at - room.mean[door]) ** 2 for at, room, door in zip(away, ROOMS, DOORS, strict=True))

    expected = np.exp(minimize_scalar(value, bounds=(np.log(3.0), np.log(60.0)), method="bounded").x)
    assert doors_W_K(joint_of(*fits)) == pytest.approx([expected] * 2, rel=0.01)
