"""A room's equations keep what physics says at any parameters, and their derivatives are right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from thermal_networks import random_theta, theta_of, transition

from thermoforce_mpc.identification.estimation.regression import DISTURBANCE_H
from thermoforce_mpc.identification.network.room import EMITTER, Law, RoomNetwork, neighbours_of
from thermoforce_mpc.model.free_response.rc import INPUTS

ONE = RoomNetwork()
ROOMS = (
    ONE,
    RoomNetwork((1, 1), (float("nan"), 40.0)),
    RoomNetwork(neighbours=2),
    RoomNetwork((1, -1), (50.0, 30.0), neighbours=2),
    RoomNetwork((1, -1), (float("nan"),) * 2, laws=(Law(0, "per_K", 0.01, 0.02), Law(1, "part", 0.1, 0.2))),
)
OUTDOOR, CONSTANT = INPUTS.index("outdoor"), INPUTS.index("constant")


def steady(room, theta):
    """Temperatures (n,) of the network's nodes per unit of each input (m,), without disturbances."""
    matrix, nodes = room.equations(theta).matrix, room.disturbances.start
    return -np.linalg.solve(matrix[:nodes, :nodes], matrix[:nodes, room.n_states :])


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("seed", range(5))
def test_heat_of_a_node_cools_no_other(room, seed):
    matrix = room.equations(random_theta(room, np.random.default_rng(seed), 2.0)).matrix[:, : room.n_states]
    assert (matrix - np.diag(np.diag(matrix)) >= 0.0).all()
    assert (np.diag(matrix) < 0.0).all()
    np.testing.assert_allclose(np.diag(matrix)[room.disturbances], -1.0 / np.array(DISTURBANCE_H))


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("seed", range(5))
def test_a_room_in_steady_state_is_a_mean_of_its_surroundings(room, seed):
    """Outdoors, neighbours that are measured, and those that are not, at 12 °C: their weights add up to one."""
    theta = random_theta(room, np.random.default_rng(seed))
    theta[room.place["gains"]] = -40.0
    theta[len(room.names) :] = 0.0
    gains = steady(room, theta)
    weights = [gains[0, OUTDOOR], gains[0, CONSTANT] / 12.0, *gains[0, len(INPUTS) : room.drive(0)]]
    assert min(weights) > 0.0
    assert sum(weights) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.slow
@given(
    st.sampled_from(ROOMS), st.lists(st.floats(-4.0, 4.0), min_size=50, max_size=50), st.sampled_from([0.1, 1.0, 24.0])
)
def test_more_heat_never_cools(room, away, hours):
    """Anywhere the search may go: whatever full level does, at any node, has the sign of the actuator."""
    theta = room.mean + room.sd * np.array(away)[: room.mean.size]
    B = transition(room, theta, hours)[1]
    for a, sign in enumerate(room.signs):
        effect = sign * B[: room.disturbances.start, room.drive(a)]
        assert effect.min() >= -1e-9 * effect.max()
        assert effect[EMITTER + a] > 0.0


def test_the_steady_effect_is_that_of_all_that_is_lost():
    """One actuator, all heat to the emitter: its heat over the conductance to what is not heated."""
    theta = theta_of(ONE, heat_0=50.0, heat_structure_0=1e-9, H_outdoors=1.2, H_envelope=2.0, H_structure=10.0)
    theta[ONE.place["H_envelope_outdoors"]], theta[ONE.place["H_neighbours"]] = np.log(1.0), np.log(0.3)
    lost = 1.2 + 0.3 + 1.0 / (1.0 / 10.0 + 1.0 / 2.0 + 1.0 / 1.0)
    assert steady(ONE, theta)[0, ONE.drive(0)] == pytest.approx(50.0 / lost, rel=1e-6)


@pytest.mark.parametrize("room", ROOMS)
def test_derivatives_of_the_matrix_are_those_of_differences(room):
    rng = np.random.default_rng(3)
    theta = random_theta(room, rng)
    weights = rng.normal(size=(room.n_states, room.n_states + room.n_inputs))
    found = room.slopes(theta, room.equations(theta), weights)
    for i, step in enumerate(np.eye(theta.size) * 1e-6):
        up, down = (np.vdot(weights, room.equations(theta + s * step).matrix) for s in (1.0, -1.0))
        assert found[i] == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-6)


def test_metered_heat_is_its_prior():
    room = RoomNetwork((1,), (45.0,))
    assert room.priors["heat_0"].median == 45.0
    assert room.priors["heat_0"].log_sd < 0.5 * ONE.priors["heat_0"].log_sd


def test_the_noise_keeps_the_variance_of_the_disturbances():
    theta = random_theta(ONE, np.random.default_rng(0))
    Q, stationary, _ = ONE.noise(theta, 0.25)
    A, _ = transition(ONE, theta, 0.25)
    kept = np.diag(A)[ONE.disturbances] ** 2 * stationary + Q[ONE.disturbances]
    np.testing.assert_allclose(kept, stationary, rtol=1e-12)


def test_the_neighbours_of_a_zone_are_the_others():
    assert list(neighbours_of(1, 4)) == [0, 2, 3]
