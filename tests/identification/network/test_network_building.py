"""Rooms joined to a building answer as their own equations do, and are less sure where their parameters are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from thermal_networks import AREA_M2, LAYOUT, ROOMS, KnownFit, effect_K, theta_of

from thermoforce_mpc.data import Layout
from thermoforce_mpc.identification.network.building import RESPONSE_H, BuildingFit
from thermoforce_mpc.identification.network.circuits import Circuit
from thermoforce_mpc.identification.network.estimate import RoomRun
from thermoforce_mpc.identification.network.room import EMITTER, ROOM, STRUCTURE, RoomNetwork
from thermoforce_mpc.model.free_response.rc import INPUTS
from thermoforce_mpc.model.machine.load import MachineLoad

# One wall of 12 W/K and one door of 9 W/K, of which each room has its share per m² of its floor.
SHARED = [{"wall_0": 12.0 / area, "door_0": 9.0 / area} for area in AREA_M2]
THETAS = (
    theta_of(ROOMS[0], **SHARED[0], heat_0=80.0, C_structure=40.0, sun=0.08),
    theta_of(ROOMS[1], **SHARED[1], heat_0=40.0, C_emitter_0=20.0, heat_structure_0=0.4, H_envelope=1.0),
)


def fit_of(thetas=THETAS, variances=(1e-9, 1e-9), rooms=ROOMS, layout=LAYOUT):
    """Rooms at θ, all of whose parameters have a variance, beside which their priors count nothing."""
    fits = zip(rooms, thetas, variances, strict=True)
    return BuildingFit(layout, tuple(KnownFit(room, t, v) for room, t, v in fits))


def unexplained():
    """Relative standard deviation at `RESPONSE_H` by what the nodes are not: 4.5 %, over 12 h as much once more."""
    return 0.045 * np.hypot(1.0, 1.0 - np.exp(-RESPONSE_H / 12.0))


def joined():
    """Both rooms' equations, (n, n) 1/h, with each other's air in the place of the input to their own, each other's
    structure in that of the input to their structure; and their inputs.
    """
    sizes = [room.disturbances.start for room in ROOMS]
    F, drives = np.zeros((sum(sizes),) * 2), np.zeros((sum(sizes), 3))
    begins = [0, sizes[0]]
    for z, (room, theta) in enumerate(zip(ROOMS, THETAS, strict=True)):
        matrix, here = room.equations(theta).matrix, slice(begins[z], begins[z] + sizes[z])
        inputs = matrix[: sizes[z], room.n_states :]
        F[here, here] = matrix[: sizes[z], : sizes[z]]
        for node in (ROOM, STRUCTURE):
            F[begins[z] + node, begins[1 - z] + node] = inputs[node, len(INPUTS)]
        for k, a in enumerate(LAYOUT.actuators_of(z)):
            drives[here, a] = inputs[:, room.drive(k)]
    return F, drives, begins


def test_responses_are_those_of_the_joined_equations():
    F, drives, begins = joined()
    responses = fit_of().responses
    whole = np.vstack([np.hstack([F, drives]), np.zeros((3, F.shape[0] + 3))])
    for t, hours in enumerate(RESPONSE_H):
        np.testing.assert_allclose(responses[..., t], expm(hours * whole)[begins, F.shape[0] :], rtol=1e-6)


def test_a_valve_gives_sooner_and_less_than_heat_that_is_held():
    """Its emitter's warmth takes heat back, as a conductance to its usual temperature would."""
    F, drives, begins = joined()
    circuit = Circuit(MachineLoad((0.0, 0.0, 1.0, 0.0), (-20.0, 20.0)), full=1.2, per_K=0.02, emitter_C=30.0)
    fit = replace(fit_of(), circuits={0: circuit})
    C, heat = (ROOMS[0].value(THETAS[0], name) for name in ("C_emitter_0", "heat_0"))
    F[EMITTER, EMITTER] -= 0.02 * heat / C
    drives[:, 0] *= 1.2
    whole = np.vstack([np.hstack([F, drives]), np.zeros((3, F.shape[0] + 3))])
    for t, hours in enumerate(RESPONSE_H):
        np.testing.assert_allclose(fit.responses[..., t], expm(hours * whole)[begins, F.shape[0] :], rtol=1e-6)
    share = fit.responses[0, 0] / fit_of().responses[0, 0]
    assert (np.diff(share) < 0.0).all()
    assert share[0] > 1.0 > share[-1]
    # Without heat the emitter is drawn to its usual temperature.
    constant = len(LAYOUT.home) + INPUTS.index("constant")
    more = fit.network.heat[EMITTER, constant] - fit_of().network.heat[EMITTER, constant]
    assert more == pytest.approx(0.02 * heat * AREA_M2[0] * 30.0)


def test_a_room_alone_answers_as_its_equations():
    room = RoomNetwork()
    (responses,) = fit_of([room.mean], (1e-4,), (room,), Layout.single()).responses
    np.testing.assert_allclose(responses[0], [effect_K(room, room.mean, h) for h in RESPONSE_H], rtol=1e-8)


def test_heat_of_one_room_reaches_the_other_later_and_less():
    responses = fit_of().responses
    own, across = responses[0][0], responses[1][0]
    assert (across > 0.0).all()
    assert (across < own).all()
    assert across[0] / across[-1] < 0.1 * own[0] / own[-1]
    assert (responses[0][2] < 0.0).all(), "cooling"


@pytest.mark.parametrize("name", ["wall_0", "door_0"])
def test_a_wall_is_the_one_that_the_surer_room_saw(name):
    """Both rooms saw it: where they differ, between the two, nearer to the surer one."""
    other = (THETAS[0].copy(), THETAS[1])
    other[0][ROOMS[0].place[name]] += np.log(4.0)

    def across(thetas, variances):
        return float(fit_of(thetas, variances).responses[1][0, -1])

    low, high = across(THETAS, (1e-4, 1e-4)), across(other, (1e-6, 1.0))
    middle = across(other, (1e-4, 1e-4))
    assert low < middle < high
    assert across(other, (1.0, 1e-6)) == pytest.approx(low, rel=1e-3)
    both = [theta.copy() for theta in THETAS]
    for theta, room in zip(both, ROOMS, strict=True):
        theta[room.place[name]] += np.log(2.0)
    assert middle == pytest.approx(across(both, (1e-4, 1e-4)), rel=1e-6)


@pytest.mark.slow
def test_bands_are_those_of_the_parameters():
    """Against responses at parameters drawn from their covariance; what the nodes are not adds to them."""
    rng, sd = np.random.default_rng(0), 0.1
    building = fit_of(variances=(sd**2, sd**2))
    found, covariance = building.responses, building.covariance
    drawn = [fit_of([t + sd * rng.normal(size=t.size) for t in THETAS]) for _ in range(150)]
    for z in (0, 1):
        sample = np.array([one.responses[z] for one in drawn])
        for a in range(3):
            expected = np.hypot(sample[:, a].std(axis=0), unexplained() * np.abs(found[z][a]))
            np.testing.assert_allclose(np.sqrt(np.diag(covariance[z, a])), expected, rtol=0.25)


def test_less_certain_parameters_make_wider_bands():
    sds = [np.sqrt(np.diag(fit_of(variances=(v, v)).covariance[0, 0])) for v in (0.0025, 0.01, 0.04)]
    assert (sds[0] < sds[1]).all()
    assert (sds[1] < sds[2]).all()
    least = np.abs(fit_of(variances=(1e-12, 1e-12)).responses[0][0]) * unexplained()
    np.testing.assert_allclose(np.sqrt(np.diag(fit_of(variances=(1e-12,) * 2).covariance[0, 0])), least, rtol=1e-3)


def test_what_levels_alone_tell_of_other_rooms_is_known_to_a_quarter():
    """However sure parameters are; the own room is known as they are, and the sum of all better than each apart."""

    def relative_sds(weight: float) -> np.ndarray:
        runs = [RoomRun(np.zeros((1, 1)), np.zeros(1), 1.0, weight=weight)]
        fits = zip(ROOMS, THETAS, strict=True)
        building = BuildingFit(LAYOUT, tuple(KnownFit(room, theta, 1e-9, runs) for room, theta in fits))
        together_K, covariance = building.together
        apart = np.sqrt(np.diagonal(building.covariance, axis1=-2, axis2=-1)) / np.abs(building.responses)
        sums = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)) / np.abs(together_K)
        return np.concatenate([apart, sums[:, None]], axis=1)

    whole, part = relative_sds(1.0), relative_sds(0.2)
    own, across = ([0, 1, 1], [0, 1, 2]), ([0, 0, 1], [1, 2, 0])
    np.testing.assert_allclose(whole[:, :3], np.broadcast_to(unexplained(), (2, 3, RESPONSE_H.size)), rtol=1e-3)
    np.testing.assert_allclose(part[own], whole[own])
    np.testing.assert_allclose(part[across], np.hypot(whole[across], 0.25))
    assert (part[:, 3] > whole[:, 3]).all()
    assert (part[:, 3] < 0.2).all()


def test_rooms_that_were_not_joined_do_nothing_to_each_other():
    """Without cross effects their networks know no neighbours."""
    rooms = (RoomNetwork(), RoomNetwork((1, -1), (float("nan"),) * 2))
    responses = fit_of([room.mean for room in rooms], rooms=rooms).responses
    assert not np.any(responses[0][1:])
    assert not np.any(responses[1][0])
    np.testing.assert_allclose(responses[0][0], [effect_K(rooms[0], rooms[0].mean, h) for h in RESPONSE_H])


def test_a_building_without_floor_areas_answers_the_same():
    """Everything is per m² of a room: with one room its area does not matter."""
    room = RoomNetwork()
    found = [
        fit_of([room.mean], (0.01,), (room,), Layout.single(floor_area_m2=area)).responses[0] for area in (None, 80.0)
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)
